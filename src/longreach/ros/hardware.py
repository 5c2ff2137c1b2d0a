"""A robot that speaks ROS 1, behind the same `Hardware` as any other: sensors by topics, arm and base by commands."""

from typing import Literal

from longreach.control.hardware import Command, Promises, Readings
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.ros import wire
from longreach.ros.sensors import Role

ArmInterface = Literal["velocity", "position", "trajectory"]
_ROLES: tuple[Role, ...] = ("wheels", "lidar", "imu", "joints", "wrench")


def connect_ros(
    robot: MobileManipulator,
    *,
    arm: ArmInterface = "velocity",
    controller: str = "/arm_controller",
    base: str = "/cmd_vel",
    timeout: float = 10.0,
) -> "RosHardware":
    """Become a node and connect to a robot, whose sensors are on the topics that its description names.

    Arguments:
        arm: what the arm takes: velocity or position, an array of numbers on CONTROLLER/command as ros_control's group
            controllers take it; or trajectory, on CONTROLLER/command as its joint trajectory controller takes it, each
            ending at rest, so that the arm stops by itself where nothing follows.
        base: topic of the base's twists. timeout: how long a master and the sensors are waited for [s].

    Raises:
        LiveError: rospy is not there, no master answers, or the robot says nothing.
    """
    wire.start_node("longreach_hardware", signals=False, wait=timeout)
    return RosHardware(robot, arm, controller, base, timeout)


class RosHardware:
    """A robot over ROS; made by `connect_ros`. See `longreach.control.hardware.Hardware`."""

    def __init__(self, robot: MobileManipulator, arm: ArmInterface, controller: str, base: str, timeout: float) -> None:
        raise NotImplementedError

    @property
    def promises(self) -> Promises:
        """What the robot can do: as its description says."""
        raise NotImplementedError

    def read(self) -> Readings:
        """Return everything that has arrived since the last call."""
        raise NotImplementedError

    def write(self, command: Command) -> None:
        """Send a command; after a stop none is sent."""
        raise NotImplementedError

    def stop(self, reason: str) -> None:
        """Cancel whatever moves the arm, and let base and arm stand."""
        raise NotImplementedError

    def wait_until(self, stamp: float) -> None:
        """Return at a time of the robot's clock [s]."""
        raise NotImplementedError

    def close(self) -> None:
        """Stop, and listen no more."""
        raise NotImplementedError
