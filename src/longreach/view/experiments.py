"""The thesis' experiments as plans from where a robot is, to be looked at before they run."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.app.dual_trajectory import PACE
from longreach.configuration import ConfigurationTrajectory
from longreach.errors import PlanningError
from longreach.geometry import se2
from longreach.planning.planner import plan
from longreach.planning.reference import dual_trajectory
from longreach.planning.thesis_problem import thesis_problem
from longreach.planning.timing import eased
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.drive import Drive, make_drive, move
from longreach.view.robot_client import Method, RobotClient

_ROW = 0.1  # [s] between two rows of a drive: its fastest wave has 0.15 Hz
_PART = 0.85  # of the drive's speeds and space: the rest is for correcting; ours
_SCALES = (1.0, 0.7, 0.5, 0.35, 0.25)
_APART = 0.65  # of the base's centre from what was seen [m], half its diagonal and a little; ours
_ROOM = 1000.0  # a base has no end stops [m]


class Asked(NamedTuple):
    """What an experiment is planned with: the client, the planner's name, and what the laser has seen (m, 2) [m]."""

    client: RobotClient
    method: Method
    seen: Float[np.ndarray, "m 2"]


def _reference(client: RobotClient, length: float) -> Reference:
    """Return the thesis' second experiment from where the robot is."""
    robot, q = client.robot, client.state.q
    return dual_trajectory(robot.forward(q), q[robot.base], length, 0.2, waypoints=200, duration=length / PACE)


def _dual(length: float) -> Callable[[Asked], ConfigurationTrajectory]:
    return lambda asked: asked.client.plan(_reference(asked.client, length), asked.method)


def _optimised(asked: Asked) -> ConfigurationTrajectory:
    """Plan problem (4.34) of the thesis, the base within 1 cm of its path and the arm as nimble as may be."""
    client = asked.client
    robot, q = roomy(client.robot), client.state.q
    return eased(plan(robot, _reference(client, 2.0), q, method="sqp", problem=thesis_problem()))


def _not_optimised(asked: Asked) -> ConfigurationTrajectory:
    return asked.client.plan(_reference(asked.client, 2.0), "task-priority")


def _localization(duration: float) -> Callable[[Asked], ConfigurationTrajectory]:
    return lambda asked: erratic_drive(asked.client.robot, asked.client.state.q, asked.seen, duration)


EXPERIMENTS: Mapping[str, Callable[[Asked], ConfigurationTrajectory]] = {
    "localization, 30 s": _localization(30.0),
    "localization, 120 s": _localization(120.0),
    "dual-trajectory, 2 m": _dual(2.0),
    "dual-trajectory, 1 m": _dual(1.0),
    "manipulability, optimised": _optimised,
    "manipulability, not optimised": _not_optimised,
}


def erratic_drive(
    robot: MobileManipulator,
    q: Float[np.ndarray, " n"],
    seen: Float[np.ndarray, "m 2"],
    duration: float,
    seed: int = 0,
) -> ConfigurationTrajectory:
    """Return the thesis' first experiment from q (n,): the base drives fast and erratically, the arm stands.

    The drive is turned, and made smaller where it must be, until it keeps clear of all that the laser has seen.

    Raises:
        PlanningError: there is no room for it.
    """
    drive = make_drive(robot.description, duration, np.random.default_rng(seed))
    t = np.linspace(0.0, duration, round(duration / _ROW) + 1)
    reach = float(np.linalg.norm(robot.forward(q)[:2, 3] - q[:2])) + 0.1 if robot.dof > 3 else 0.0
    near = np.min(np.linalg.norm(seen - q[:2], axis=1), initial=np.inf)
    apart = min(max(_APART, reach), 0.95 * float(near))  # it may have to come out of a narrow place
    for scale in _SCALES:
        smaller = Drive(duration, _PART * scale * drive.amplitude, drive.frequency, drive.phase)
        motion = move(smaller, t)
        for turn in 0.5 * np.pi * np.arange(4):
            axes = np.array([q[0], q[1], q[2] + turn])
            way = se2.compose(axes, motion.poses)
            if _clearance(way[::3, :2], seen) >= apart:
                rows, rates = np.tile(q, (len(t), 1)), np.zeros((len(t), robot.dof))
                rows[:, :2], rows[:, 2] = way[:, :2], q[2] + motion.poses[:, 2]
                rates[:, :3] = _turned(motion.velocity, axes[2])
                return ConfigurationTrajectory(t, rows, robot.joint_names, rates)
    raise PlanningError("There is no room for the drive here; drive to a place with 2 m of free floor around.")


def _clearance(points: Float[np.ndarray, "k 2"], seen: Float[np.ndarray, "m 2"]) -> float:
    apart = [np.min(np.linalg.norm(seen - point, axis=1), initial=np.inf) for point in points]
    return float(np.min(apart))


def _turned(velocity: Float[np.ndarray, "n 3"], angle: float) -> Float[np.ndarray, "n 3"]:
    c, s = np.cos(angle), np.sin(angle)
    return velocity @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def roomy(robot: MobileManipulator) -> MobileManipulator:
    """Return the robot with a base that may go anywhere: its description only says where it is planned by itself."""
    lower, upper = robot.lower.copy(), robot.upper.copy()
    lower[robot.base], upper[robot.base] = -_ROOM, _ROOM
    return robot.with_limits(lower, upper)
