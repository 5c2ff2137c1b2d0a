"""Where the start is on the map: where absolute fixes say the robot was."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from longreach.evaluation.alignment import rigid_alignment
from longreach.geometry import se2
from longreach.measurement import PoseMeasurement
from longreach.trajectory import PoseTrajectory

_ENOUGH = 5.0  # fixes spread over this many of their standard deviations tell the heading to about 10°
_WIDER = 3.0  # the fixes are fused as well, so what they say of the start is taken with a larger deviation


def start_pose(
    fixes: Sequence[PoseMeasurement], paths: Sequence[PoseTrajectory], stamp: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Return a pose at `stamp` [s] in the frame map and its covariance.

    Fixes without headings tell the start only after a way: as many of the first ones as are spread widely enough are
    laid over dead reckoning (the first of `paths` that has rows), and the rigid motion between the two gives the pose.
    """
    if np.isfinite(fixes[0].covariance[2, 2]):
        return fixes[0].pose.copy(), _WIDER**2 * _in_body(fixes[0])
    sigma = float(np.sqrt(0.5 * (fixes[0].covariance[0, 0] + fixes[0].covariance[1, 1])))
    path = next((path for path in paths if len(path) > 1), None)
    if path is None:
        wide = np.diag([(_WIDER * sigma) ** 2] * 2 + [np.pi**2])
        return np.array([*fixes[0].pose[:2], 0.0]), wide
    poses, known = path.at(np.array([fix.stamp for fix in fixes]))
    target = np.array([fix.pose[:2] for fix in fixes])[known]
    source = poses[known][:, :2]
    if len(source) == 0:
        source, target = poses[:1, :2], np.array([fixes[0].pose[:2]])
    count = _needed(target, _ENOUGH * sigma)
    start, _ = path.at(np.array([stamp]))
    pose = se2.compose(rigid_alignment(source[:count], target[:count]), start[0])
    spread = max(float(np.sqrt(np.sum((target[:count] - target[:count].mean(axis=0)) ** 2))), 1e-9)
    heading = min(_WIDER * sigma / spread, np.pi)
    across = _WIDER * sigma + heading * float(np.linalg.norm(target[:count].mean(axis=0) - pose[:2]))
    return pose, np.diag([across**2, across**2, heading**2])


def _needed(points: Float[np.ndarray, "n 2"], spread: float) -> int:
    """Return how many of the first points lie further apart than `spread`; all where they never do."""
    far = np.linalg.norm(points - points[:1], axis=1) > 2 * spread
    return int(np.argmax(far)) + 1 if far.any() else len(points)


def _in_body(fix: PoseMeasurement) -> Float[np.ndarray, "3 3"]:
    c, s = np.cos(fix.pose[2]), np.sin(fix.pose[2])
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return R @ fix.covariance @ R.T
