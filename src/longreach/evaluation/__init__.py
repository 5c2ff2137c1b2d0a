"""How well an estimate agrees with a reference, in numbers, figures and one page; nothing here writes a file."""
