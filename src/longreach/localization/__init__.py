"""Where the base is: wheels, LIDAR, IMU and absolute fixes as one estimate."""
