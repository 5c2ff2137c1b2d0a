"""From a trajectory to commands that are safe to send: interpolation, controllers, the last gate, the robot's face."""
