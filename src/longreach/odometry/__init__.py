"""How far the base went, from one reading of a sensor to the next."""
