"""What matching a scan starts from and ends with, whichever way it is matched."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.odometry import _range_flow_kernels
from longreach.odometry.range_flow import RangeFlowConfig
from longreach.odometry.scan_geometry import ScanGeometry

_FLOW = RangeFlowConfig().settings  # of guesses


@dataclass(frozen=True, eq=False)
class Points:
    """The points of a scan in the laser's frame, counter-clockwise: x, y, r (3, n) [m], r = 0 where there is none."""

    xyr: Float[np.ndarray, "3 n"]
    count: int


@dataclass(frozen=True, eq=False)
class Fit:
    """A pose (3,) of the base seen from the keyframe, with its covariance, and how well it explains the scan.

    directions (k, 3): of ξ, along which nothing was told. support: share of the points that agree but for noise.
    """

    pose: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    shared: Float[np.ndarray, "3 3"]
    rows: int
    scale: float
    support: float
    directions: Float[np.ndarray, "k 3"]


def directions_of(told: np.ndarray, V: np.ndarray, reach: float, geometry: ScanGeometry) -> np.ndarray:
    """Return the directions of the base's ξ that are not told, as rows of length 1."""
    if told[0] and told[1] and told[2]:
        return np.zeros((0, 3))
    found = V.T[told == 0.0] / np.array([1.0, 1.0, reach])
    x, y, t = geometry.pose_base_laser
    c, s = np.cos(t), np.sin(t)
    found = found @ np.array([[c, -s, y], [s, c, -x], [0.0, 0.0, 1.0]]).T
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def flow_guess(old: Points, new: Points, geometry: ScanGeometry) -> Float[np.ndarray, "3"]:
    """Return the base's motion between two scans by range flow, which needs no guess."""
    g, laser = geometry, np.zeros(3)
    _range_flow_kernels.guess_motion(old.xyr[2], new.xyr[2], g.start, g.cos, g.sin, g.increments, _FLOW, laser)
    if not np.isfinite(laser).all():
        return np.zeros(3)
    return se2.compose(se2.compose(g.pose_base_laser, laser), se2.inverse(g.pose_base_laser))
