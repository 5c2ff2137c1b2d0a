"""The planar filter (3.27)-(3.29): pose, twist, acceleration and gyro bias of the base, and past poses, on SE(2)."""
