"""A robot over a network: the robot side that serves it, and the client that watches and commands it."""
