"""A trajectory_msgs/JointTrajectory as our timed points, and what is wrong with it."""

from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory
from longreach.control.interpolation import timed_points
from longreach.control.joint_trajectory import JointInput
from longreach.errors import ControlError, LongreachError
from longreach.robot.chain import JointLimits

INVALID_GOAL, INVALID_JOINTS, OLD_HEADER_TIMESTAMP = -1, -2, -3  # control_msgs/FollowJointTrajectoryResult


class GoalError(ControlError):
    """A trajectory that cannot be followed; `code` as in control_msgs/FollowJointTrajectoryResult."""

    def __init__(self, code: int, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code


def seconds(time: Any) -> float:
    """Return a ROS time or duration [s]."""
    return (time.sec * 10**9 + time.nanosec) / 10**9


def trajectory_of(
    message: Any, names: tuple[str, ...], limits: JointLimits, here: JointInput, now: float
) -> tuple[ConfigurationTrajectory, float]:
    """Return the trajectory of a message, its joints in the order of `names`, and how long ago it began [s].

    It begins at `here`, where the joints are or should be, where its first point is due later than its start, as
    ros_control's do. Where points lack velocities they are those of a smooth spline.

    Raises:
        GoalError: it is of other joints, has no points, has times that do not grow, numbers that are not finite or
            beyond the joints' limits, or is over already.
    """
    if sorted(message.joint_names) != sorted(names):
        raise GoalError(
            INVALID_JOINTS, f"The goal is of {', '.join(message.joint_names)}; give it for {', '.join(names)}."
        )
    if not message.points:
        raise GoalError(INVALID_GOAL, "The goal has no points; give it one at least.")
    order = [list(message.joint_names).index(name) for name in names]
    stamps = np.array([seconds(point.time_from_start) for point in message.points])
    start = seconds(message.header.stamp) or now
    if start + stamps[-1] < now:
        raise GoalError(OLD_HEADER_TIMESTAMP, f"The goal ended {now - start - stamps[-1]:.2f} s ago; send it sooner.")
    q = _rows([point.positions for point in message.points], order)
    if q is None:
        raise GoalError(INVALID_GOAL, f"Each point takes {len(names)} positions; give one a joint.")
    velocities = _rows([point.velocities for point in message.points], order)
    beyond = (q < limits.lower) | (q > limits.upper)
    if beyond.any():
        row, joint = np.argwhere(beyond)[0].tolist()
        raise GoalError(
            INVALID_GOAL, f"Point {row} (from 0) takes {names[joint]} to {q[row, joint]:g}, beyond its limits."
        )
    if stamps[0] > 0.0:
        stamps, q = np.append(0.0, stamps), np.vstack([here.q, q])
        if velocities is not None:
            velocities = np.vstack([here.velocity, velocities])
    try:
        return timed_points(stamps, q, velocities, names), now - start
    except LongreachError as error:
        raise GoalError(INVALID_GOAL, str(error)) from error


def _rows(lists: list[Any], order: list[int]) -> Float[np.ndarray, "n m"] | None:
    """Return numbers a point in another order (n, m), or None where a point has not one a joint."""
    if any(len(row) != len(order) for row in lists):
        return None
    return np.array(lists, dtype=float).reshape(len(lists), len(order))[:, order]
