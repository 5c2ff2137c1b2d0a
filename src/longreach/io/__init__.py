"""The only room that knows file formats; results are written whole or not at all."""
