"""A robot that speaks ROS 1."""
