"""What clients send, as values: from messages to goals and commands, each number checked on both sides.

Speeds beyond a limit are for the safety gate to cut; beyond twice the limit they are a mistake, and refused. A reason
never holds the number that was sent: a robot counts what it refuses by reasons.
"""

import math
from typing import Any

import numpy as np

from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import Command, GripperCommand
from longreach.control.safety_config import SafetyConfig
from longreach.errors import LiveError
from longreach.geometry import se3, so3
from longreach.io import messages
from longreach.live.protocol.topics import TYPES
from longreach.reference import check_rigid
from longreach.robot.mobile_manipulator import MobileManipulator

_ABSURD = 2.0  # of a limit of speed; ours
_LARGEST = 1e6  # of any number
_BEYOND = 0.01  # a joint's limit: a position that was read and is sent back is noisy [rad]; ours
_GRIPPER = SafetyConfig()


def one_line(text: str, longest: int) -> str:
    """Return a name or reason from the network as it may stand in a log: one line, without control characters."""
    line = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    return line if len(line) <= longest else f"{line[: longest - 1]}…"


def numbers(values: Any, what: str, *shapes: tuple[int, ...]) -> np.ndarray:
    """Return values as an array of finite numbers of one of the shapes.

    Raises:
        LiveError: they are none.
    """
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise LiveError(f"{what} must be of numbers.") from error
    if array.shape not in shapes:
        *expected, given = (" x ".join(map(str, shape)) or "1" for shape in (*shapes, array.shape))
        raise LiveError(f"{what} must be of {' or '.join(dict.fromkeys(expected))} numbers, not of {given}.")
    if not np.all(np.abs(array) < _LARGEST):  # NaN is not
        raise LiveError(f"{what} must be of finite numbers below {_LARGEST:g}.")
    return array


def rigid(T: Any, what: str) -> np.ndarray:
    """Return a pose (4, 4).

    Raises:
        LiveError: it is not of finite numbers. PlanningError: it is no rigid motion.
    """
    T = numbers(T, what, (4, 4))
    check_rigid(T[None], what)
    return T


def check_command(command: Command, robot: MobileManipulator) -> None:
    """Check what is sent in a stream.

    Raises:
        LiveError: the robot has no such part, a number is not finite, a position is outside its limits, a speed is more
            than twice its limit, or the gripper's number is outside its limits.
    """
    base, arm, gripper = command.base, command.arm, command.gripper
    if base is not None:
        if not robot.base.stop:
            raise LiveError(f"{robot.name} has no base that drives; command its arm.")
        _check_speeds(numbers(base, "A velocity of the base", (3,)), robot, robot.base)
    if arm is not None:
        arm = numbers(arm, "A command for the arm", (len(robot.joint_names[robot.arm]),))
        if command.arm_mode == "velocity":
            _check_speeds(arm, robot, robot.arm)
        elif command.arm_mode == "position":
            _check_positions(arm[None], robot, robot.arm)
        else:
            raise LiveError("A command for the arm is a velocity or a position.")
    if gripper is not None:
        tops = {"position": 1.0, "velocity": _GRIPPER.gripper_velocity, "force": _GRIPPER.gripper_force}
        top = tops.get(str(gripper.mode))
        if top is None:
            raise LiveError("A command for the gripper is a position, a velocity or a force.")
        low = 0.0 if gripper.mode == "position" else -top
        if not low <= float(numbers(gripper.value, f"A {gripper.mode} of the gripper", ())) <= top:
            raise LiveError(f"A {gripper.mode} of the gripper must be from {low:g} to {top:g}.")


def check_trajectory(plan: ConfigurationTrajectory, robot: MobileManipulator) -> None:
    """Check a plan of all joints.

    Raises:
        LiveError: it is of other joints, goes outside their limits, or is faster than twice what they can do.
    """
    if plan.joint_names != robot.joint_names:
        raise LiveError(f"A trajectory must be of the joints {', '.join(robot.joint_names)}.")
    if np.abs(plan.q).max() >= _LARGEST:
        raise LiveError(f"A trajectory must be of finite numbers below {_LARGEST:g}.")
    _check_positions(plan.q[:, robot.arm], robot, robot.arm)
    chords = np.abs(np.diff(plan.q, axis=0) / np.diff(plan.stamps)[:, None])
    _check_speeds(np.vstack([np.abs(plan.velocities), chords]).max(axis=0), robot, slice(0, robot.dof))


def _check_speeds(speeds: np.ndarray, robot: MobileManipulator, part: slice) -> None:
    limits = robot.limits.velocity[part]
    if len(over := np.flatnonzero(np.abs(speeds) > _ABSURD * limits)):
        i = int(over[0])
        unit = "m/s" if robot.prismatic[part][i] else "rad/s"
        raise LiveError(
            f"{robot.joint_names[part][i]} may move at {limits[i]:g} {unit}; more than twice that is refused."
        )


def _check_positions(q: np.ndarray, robot: MobileManipulator, part: slice) -> None:
    lower, upper = robot.limits.lower[part], robot.limits.upper[part]
    if len(over := np.flatnonzero(np.any((q < lower - _BEYOND) | (q > upper + _BEYOND), axis=0))):
        i = int(over[0])
        raise LiveError(f"{robot.joint_names[part][i]} must stay within its limits {lower[i]:g} to {upper[i]:g}.")


def stamp_of(message: Any) -> float:
    """Return the stamp of a message's header [s]."""
    header = getattr(message, "header", message)
    return header.stamp.sec + 1e-9 * header.stamp.nanosec


def twist(message: Any, robot: MobileManipulator) -> Command:
    """Read a geometry_msgs/TwistStamped."""
    v, w = message.twist.linear, message.twist.angular
    if not v.z == w.x == w.y == 0.0:
        raise LiveError("A base moves in the plane: linear z and angular x and y must be 0.")
    command = Command(stamp_of(message), base=np.array([v.x, v.y, w.z]))
    check_command(command, robot)
    return command


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
    command = Command(stamp_of(message), np.array([values[message.name.index(n)] for n in names]), mode)
    check_command(command, robot)
    return command


def gripper(message: Any, robot: MobileManipulator) -> GripperCommand:
    """Read a sensor_msgs/JointState of the joint gripper: a position, a velocity or an effort."""
    given = [(mode, getattr(message, mode)) for mode in ("position", "velocity", "effort")]
    given = [(mode, values) for mode, values in given if len(values)]
    if list(message.name) != ["gripper"] or len(given) != 1 or len(given[0][1]) != 1:
        raise LiveError("A command for the gripper is one number: a position, a velocity or an effort.")
    mode, values = given[0]
    command = GripperCommand("force" if mode == "effort" else mode, float(values[0]))  # type: ignore[arg-type]
    check_command(Command(stamp_of(message), gripper=command), robot)
    return command


def gripper_message(stamp: float, command: GripperCommand) -> Any:
    """Return a sensor_msgs/JointState of the joint gripper."""
    where = {"position": "position", "velocity": "velocity", "force": "effort"}[command.mode]
    return messages.joint_state(TYPES, stamp, ["gripper"], **{where: np.array([command.value])})


def tool(message: Any) -> np.ndarray:
    """Read a geometry_msgs/PoseStamped as T_map_tool (4, 4)."""
    p, q = message.pose.position, message.pose.orientation
    xyzw = numbers([q.x, q.y, q.z, q.w], "The quaternion of a pose", (4,))
    if not 0.99 < np.linalg.norm(xyzw) < 1.01:
        raise LiveError("The quaternion of a pose must be of unit length.")
    v, w = xyzw[:3], float(xyzw[3])
    sine = float(np.linalg.norm(v))
    turn = 2.0 * math.atan2(sine, w) / sine * v if sine > 0.0 else np.zeros(3)
    return se3.from_rotation_translation(so3.exp(turn), numbers([p.x, p.y, p.z], "The position of a pose", (3,)))


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
    plan = ConfigurationTrajectory(stamps, q, names, v)
    check_trajectory(plan, robot)
    return plan
