"""Calibration by driving: wheels and sensors from a robot's own motion, and what a run cannot show."""
