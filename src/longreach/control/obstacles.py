"""The base minds what the laser sees: its speed is what it can brake from before it meets something.

Points that the laser has seen are remembered, in the odometry's frame, until it sees through their place: so the base
minds what is behind it, too. From a speed s u along a twist u, braking within a part of the accelerations a, the base
goes on for s t_r + s² T / 2 of the way that u makes in a second, where T = max |u_k| / a_k and t_r is the time to
react. The largest s that ends before the nearest point is what is left of the commanded speed.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory
from longreach.control import _obstacle_kernels as kernels
from longreach.control.interpolation import sample
from longreach.geometry import se2
from longreach.measurement import LaserScan
from longreach.robot.description import Mount
from longreach.robot.footprint import Footprint, footprint_of
from longreach.robot.mobile_manipulator import MobileManipulator

_MARGIN = 0.05  # that stays between the outline and what is seen [m]; five times a range's noise
_REACTION = 0.1  # from a sweep's middle to the first braking [s]; a sweep, a tick and the driver's
_BRAKES = 0.8  # part of the accelerations that is counted on; ours
_FAR = 5.0  # from the base points are remembered [m]: several times what braking takes
_MOST = 4000  # points that are remembered
_MOVED = 0.02  # of a joint [rad], for which the arm's outline is computed anew
_LOOK, _LOOKS = 0.04, 10_000  # between two looks at a plan [s]: 5 cm at most; and how many there are at most


@dataclass(frozen=True, slots=True, eq=False)
class ObstacleState:
    """What is known of the surroundings: points (n, 2), `count` of them, in the frame of the pose (3,) [m, m, rad].

    laser (3,): T_base_laser; sense: 1, or -1 for one that hangs upside down and counts its beams the other way.
    arm (m,): where the joints were when `capsules` (k, 5) was computed. part: how much of the commanded speed was left;
    nearest (2,): what holds the base back, in its axes [m], None where nothing does.
    """

    footprint: Footprint
    laser: Float[np.ndarray, "3"]
    sense: float
    points: Float[np.ndarray, "n 2"]
    arm: Float[np.ndarray, " m"]
    capsules: Float[np.ndarray, "k 5"]
    pose: Float[np.ndarray, "3"]
    count: int = 0
    part: float = 1.0
    nearest: Float[np.ndarray, "2"] | None = None

    @property
    def reason(self) -> str:
        """What holds the base back, as a sentence; empty where nothing does."""
        if self.nearest is None:
            return ""
        x, y = self.nearest
        side = "ahead" if abs(x) >= abs(y) and x > 0 else "behind" if abs(x) >= abs(y) else "left" if y > 0 else "right"
        return f"Something is {side} of the base, at ({x:.2f}, {y:.2f}) m from its centre."


def init(robot: MobileManipulator, arm: Float[np.ndarray, " m"] | None) -> ObstacleState | None:
    """Return what is minded before the first scan; None where there is no base to drive, or no laser."""
    lidar = robot.description.lidar
    if lidar is None or robot.description.bolted:
        return None
    footprint = footprint_of(robot)
    joints = robot.home[robot.arm] if arm is None else np.array(arm)
    T = (lidar.mount or Mount()).matrix()
    laser = np.array([T[0, 3], T[1, 3], math.atan2(T[1, 0], T[0, 0])])
    sense = math.copysign(1.0, T[2, 2])
    return ObstacleState(footprint, laser, sense, np.zeros((_MOST, 2)), joints, footprint.capsules(joints), np.zeros(3))


def step(
    state: ObstacleState,
    scans: tuple[LaserScan, ...],
    arm: Float[np.ndarray, " m"] | None,
    pose: Float[np.ndarray, "3"],
    twist: Float[np.ndarray, "3"],
    now: float,
) -> ObstacleState:
    """Take the newest scan, and where base (3,) and arm (m,) are now [s]; twist (3,): the base's, as commanded."""
    if arm is not None and np.abs(arm - state.arm).max(initial=0.0) > _MOVED:
        state = replace(state, arm=np.array(arm), capsules=state.footprint.capsules(arm))
    points, count = state.points, state.count
    for scan in [scan for scan in scans if math.isfinite(now - scan.stamp)][-1:]:
        age = min(max(now - scan.stamp - 0.5 * len(scan.ranges) * scan.time_increment, 0.0), 1.0)
        then = se2.compose(pose, se2.exp(-age * twist))
        known, points = points, np.empty_like(points)
        count = kernels.remember(
            known, count, se2.compose(then, state.laser), then, scan.returns,
            state.sense * scan.angle_min, state.sense * scan.angle_increment, scan.range_max, _FAR,
            state.footprint.rectangle, state.capsules, points,
        )  # fmt: skip
    return replace(state, points=points, count=count, pose=np.array(pose), part=1.0, nearest=None)


def limited(
    state: ObstacleState, twist: Float[np.ndarray, "3"], acceleration: Float[np.ndarray, "3"]
) -> tuple[float, Float[np.ndarray, "2"] | None]:
    """Return which part of a twist (3,) can be braked from in time, and what is met else (2,) in the base's axes [m].

    acceleration (3,): how hard the base brakes.
    """
    braking = float(np.max(np.abs(twist) / (_BRAKES * acceleration)))
    if braking == 0.0 or state.count == 0:
        return 1.0, None
    horizon = _REACTION + 0.5 * braking
    free, which = kernels.free_way(
        state.points, state.count, state.pose, state.footprint.rectangle, state.capsules, twist, horizon, _MARGIN
    )
    if which < 0:
        return 1.0, None
    part = (math.sqrt(_REACTION * _REACTION + 2.0 * braking * free) - _REACTION) / braking
    return min(part, 1.0), se2.transform(se2.inverse(state.pose), state.points[which][None])[0]


def met_by(state: ObstacleState, plan: ConfigurationTrajectory) -> str:
    """Return why a plan of all joints, in the frame of the state's pose, meets what was seen; empty: it does not."""
    robot = state.footprint.robot
    looks = min(math.ceil(plan.duration / _LOOK), _LOOKS) + 1
    t = np.linspace(plan.stamps[0], plan.stamps[-1], looks)
    q, _, _ = sample(plan, t)
    row, which = kernels.first_contact(
        state.points, state.count, np.ascontiguousarray(q[:, robot.base]), state.footprint.rectangle,
        state.footprint.capsules(q[:, robot.arm]),
    )  # fmt: skip
    if row < 0:
        return ""
    x, y = state.points[which]
    at = t[row] - t[0]
    return f"The plan meets something that the laser has seen at ({x:.2f}, {y:.2f}) m, {at:.1f} s after its begin."
