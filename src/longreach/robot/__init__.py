"""What a robot is: wheeled bases, and descriptions of whole robots that are data."""
