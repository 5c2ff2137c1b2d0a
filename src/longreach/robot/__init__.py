"""What a robot is: wheeled bases, chains of joints from DH tables and URDF, and descriptions that are data."""
