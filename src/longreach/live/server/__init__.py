"""The robot's side of the network."""
