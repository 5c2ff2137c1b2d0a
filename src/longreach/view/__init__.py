"""A page to watch a robot, live or recorded, and to command it."""
