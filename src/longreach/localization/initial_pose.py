"""Where the base is on the map, from the first absolute fixes: one with a heading, or several along a way."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.estimation.planar.ekf import CLONES, REFERENCE
from longreach.estimation.planar.state import Snapshot
from longreach.evaluation.alignment import rigid_alignment
from longreach.geometry import se2
from longreach.measurement import PoseMeasurement

_ENOUGH = 10.0  # positions this many of their deviations apart show the heading to about 10°
_WIDER = 3.0  # the fix is fused as well, so what it says of the start is taken with a larger deviation
_MOST = 500  # fixes that are remembered; a base that stands gets no further by them


class Fixed(NamedTuple):
    """An absolute fix, and where odometry had the base at its stamp (3,)."""

    pose: Float[np.ndarray, "3"]
    fix: PoseMeasurement


def is_usable(fix: PoseMeasurement) -> bool:
    """Whether a fix says where something is: what it measures is finite, and it measures a position."""
    measured = np.isfinite(np.diag(fix.covariance))
    return bool(measured[:2].all() and not np.isnan(fix.covariance).any() and np.isfinite(fix.pose[measured]).all())


def from_fixes(fixed: tuple[Fixed, ...]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]] | None:
    """Return the base's pose (3,) on the map at the last fix, and the covariance (3, 3) of its ξ; None: not yet known.

    Fixes without headings show it only after a way: once they are spread widely enough they are laid over the odometry,
    and the rigid motion between the two gives the pose.
    """
    last, fix = fixed[-1]
    if np.isfinite(fix.covariance[2, 2]):
        return fix.pose.copy(), _WIDER**2 * _in_body(fix)
    sigma = float(np.sqrt(0.5 * (fix.covariance[0, 0] + fix.covariance[1, 1])))
    target = np.array([one.fix.pose[:2] for one in fixed])
    if np.linalg.norm(target - target[0], axis=1).max() < _ENOUGH * sigma or len(fixed) < 2:
        return None
    source, center = np.array([one.pose[:2] for one in fixed]), target.mean(axis=0)
    pose = se2.compose(rigid_alignment(source, target), last)
    heading = min(_WIDER * sigma / float(np.sqrt(np.sum((target - center) ** 2))), np.pi)
    across = _WIDER * sigma + heading * float(np.linalg.norm(center - pose[:2]))
    return pose, np.diag([across**2, across**2, heading**2])


def thinned(fixed: tuple[Fixed, ...]) -> tuple[Fixed, ...]:
    """Return fixes, every second one where there are too many; the first stays."""
    return fixed if len(fixed) < _MOST else fixed[::2]


def on_map(local: Snapshot, pose: Float[np.ndarray, "3"], P: Float[np.ndarray, "3 3"]) -> Snapshot:
    """Return a filter that goes on from `local`, with the base at a pose (3,) on the map, ξ ~ N(0, P (3, 3)).

    Only the pose of its reference is another one, which is known as far as the base's pose and no better.
    """
    mean, covariance, A = local.mean.copy(), local.P.copy(), se2.adjoint(local.mean[:3])
    mean[REFERENCE:CLONES] = se2.compose(pose, se2.inverse(local.mean[:3]))
    covariance[REFERENCE:CLONES] = covariance[:, REFERENCE:CLONES] = 0.0
    covariance[REFERENCE:CLONES, REFERENCE:CLONES] = A @ P @ A.T
    mean.flags.writeable = covariance.flags.writeable = False
    return local._replace(mean=mean, P=covariance)


def _in_body(fix: PoseMeasurement) -> Float[np.ndarray, "3 3"]:
    c, s = np.cos(fix.pose[2]), np.sin(fix.pose[2])
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return R @ fix.covariance @ R.T
