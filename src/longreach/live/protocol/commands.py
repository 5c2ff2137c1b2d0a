"""What clients send, as values: from messages to goals and commands, each checked before anybody believes it."""

import math
from typing import Any

import numpy as np

from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import Command, GripperCommand
from longreach.errors import LiveError
from longreach.geometry import se3, so3
from longreach.io import messages
from longreach.live.protocol.topics import TYPES
from longreach.robot.mobile_manipulator import MobileManipulator


def stamp_of(message: Any) -> float:
    """Return the stamp of a message's header [s]."""
    header = getattr(message, "header", message)
    return header.stamp.sec + 1e-9 * header.stamp.nanosec


def twist(message: Any) -> Command:
    """Read a geometry_msgs/TwistStamped."""
    v, w = message.twist.linear, message.twist.angular
    return Command(stamp_of(message), base=_finite([v.x, v.y, w.z], "A twist"))


def twist_message(stamp: float, base: np.ndarray) -> Any:
    """Return a geometry_msgs/TwistStamped of a body twist."""
    Vector3 = TYPES["geometry_msgs/msg/Vector3"]
    vx, vy, omega = base.tolist()
    said = TYPES["geometry_msgs/msg/Twist"](Vector3(vx, vy, 0.0), Vector3(0.0, 0.0, omega))
    return TYPES["geometry_msgs/msg/TwistStamped"](messages.header(TYPES, stamp, "base_link"), said)


def arm(message: Any, robot: MobileManipulator) -> Command:
    """Read a sensor_msgs/JointState of the arm's joints: velocities, or else positions."""
    mode = "velocity" if len(message.velocity) else "position"
    values, names = getattr(message, mode), robot.joint_names[robot.arm]
    if sorted(message.name) != sorted(names) or len(values) != len(names):
        raise LiveError("A command for the arm names each of its joints, with one number each.")
    return Command(stamp_of(message), _finite([values[message.name.index(n)] for n in names], "A command"), mode)


def gripper(message: Any) -> GripperCommand:
    """Read a sensor_msgs/JointState of the joint gripper: a position, a velocity or an effort."""
    given = [(mode, getattr(message, mode)) for mode in ("position", "velocity", "effort")]
    given = [(mode, values) for mode, values in given if len(values)]
    if list(message.name) != ["gripper"] or len(given) != 1 or len(given[0][1]) != 1:
        raise LiveError("A command for the gripper is one number: a position, a velocity or an effort.")
    mode, values = given[0]
    value = float(_finite(values, "A command")[0])
    return GripperCommand("force" if mode == "effort" else mode, value)  # type: ignore[arg-type]


def gripper_message(stamp: float, command: GripperCommand) -> Any:
    """Return a sensor_msgs/JointState of the joint gripper."""
    where = {"position": "position", "velocity": "velocity", "force": "effort"}[command.mode]
    return messages.joint_state(TYPES, stamp, ["gripper"], **{where: np.array([command.value])})


def tool(message: Any) -> np.ndarray:
    """Read a geometry_msgs/PoseStamped as T_map_tool (4, 4)."""
    p, q = message.pose.position, message.pose.orientation
    xyzw = _finite([q.x, q.y, q.z, q.w], "A pose")
    if not 0.99 < np.linalg.norm(xyzw) < 1.01:
        raise LiveError("The quaternion of a pose must be of unit length.")
    v, w = xyzw[:3], float(xyzw[3])
    sine = float(np.linalg.norm(v))
    turn = 2.0 * math.atan2(sine, w) / sine * v if sine > 0.0 else np.zeros(3)
    return se3.from_rotation_translation(so3.exp(turn), _finite([p.x, p.y, p.z], "A pose"))


def trajectory(message: Any, robot: MobileManipulator) -> ConfigurationTrajectory:
    """Read a trajectory_msgs/JointTrajectory of all joints of the robot, in any order."""
    names = robot.joint_names
    if sorted(message.joint_names) != sorted(names):
        raise LiveError(f"A trajectory must be of the joints {', '.join(names)}.")
    order = [message.joint_names.index(name) for name in names]
    points = message.points
    if not points or any(len(p.positions) != len(names) or len(p.velocities) != len(names) for p in points):
        raise LiveError("Each point of a trajectory needs one position and one velocity for each joint.")
    stamps = np.array([p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points])
    q, v = (np.array([getattr(p, what) for p in points]) for what in ("positions", "velocities"))
    q, v = (np.ascontiguousarray(values[:, order]) for values in (q, v))
    return ConfigurationTrajectory(stamps, q, names, v)


def _finite(values: Any, what: str) -> np.ndarray:
    array = np.array(values, dtype=float)
    if not all(math.isfinite(value) and abs(value) < 1e6 for value in array.tolist()):
        raise LiveError(f"{what} must be of finite numbers.")
    return array
