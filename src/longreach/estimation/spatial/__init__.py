"""The 15-state filter in space, extended or unscented, with the states, masks and settings of robot_localization.

State: x y z, roll pitch yaw in the world, then velocity, rates and acceleration of the base in its own axes; constant
acceleration. Source: Moore & Stouch 2014, "A generalized extended Kalman filter implementation for the Robot Operating
System". Ours differs where docs/robot_localization.md says so.
"""
