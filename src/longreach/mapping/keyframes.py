"""Keyframes of the map: scans that stand for a place, each with its surfaces and its motion since the one before.

A scan becomes one where the base has moved by 0.5 m or turned by 20° since the last. Its odometry edge is what the
localizer made of wheels, scans and IMU in between.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from statistics import median

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.odometry import local_map
from longreach.odometry.local_map import LocalMap
from longreach.odometry.matchers.scan_matcher import Features

DISTANCE, TURNED = 0.5, math.radians(20.0)  # of keyframes [m, rad]
# How local maps drift, beyond what matches to them show: a variance a metre of the path [m²/m, rad²/m].
DRIFT = np.array([0.01**2, 0.01**2, math.radians(0.2) ** 2])


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A scan at a stamp [s]: odom (3,), its pose in the frame odom, and covariance (3, 3) of the motion since the last.

    way [m]: along the path from the start. features: in the base's frame.
    """

    stamp: float
    odom: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    way: float
    features: Features

    @cached_property
    def surfaces(self) -> local_map.Keyframe:
        """The surfaces that the scan shows, in the base's frame."""
        return local_map.keyframe(self.features, np.zeros(3))


def motion_covariance(
    before: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]],
    after: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]],
    way: float,
) -> Float[np.ndarray, "3 3"]:
    """Return the covariance (3, 3) of the motion between two poses (3,) with covariances (3, 3) along one path.

    What the later covariance has more than the earlier one: odometry's errors add up. At least the drift over the way.
    """
    A = se2.adjoint(se2.between(after[0], before[0]))
    more = after[1] - A @ before[1] @ A.T
    values, vectors = np.linalg.eigh(0.5 * (more + more.T))
    return vectors * np.maximum(values, 0.0) @ vectors.T + np.diag(DRIFT * max(way, 0.01))


def local_map_of(keyframes: list[Keyframe], poses: Float[np.ndarray, "n 3"]) -> LocalMap:
    """Merge the surfaces of keyframes at poses (n, 3); the last one is the middle."""
    placed = [
        local_map.Keyframe(pose, k.surfaces.elements, k.surfaces.noise)
        for k, pose in zip(keyframes, poses, strict=True)
    ]
    return local_map.merged(placed)


def joined_scan(keyframes: list[Keyframe], poses: Float[np.ndarray, "n 3"]) -> Features:
    """Return the features of all keyframes as one scan, in the frame that their poses (n, 3) are given in."""
    parts = []
    for k, (x, y, t) in zip(keyframes, poses.tolist(), strict=True):
        values, c, s = k.features.values[:, : k.features.count].copy(), math.cos(t), math.sin(t)
        for row, dx, dy in ((0, x, y), (2, 0.0, 0.0), (5, 0.0, 0.0)):
            a, b = values[row].copy(), values[row + 1].copy()
            values[row], values[row + 1] = c * a - s * b + dx, s * a + c * b + dy
        parts.append(values)
    values = np.ascontiguousarray(np.concatenate(parts, axis=1))
    noise, reach = (median(getattr(k.features, name) for k in keyframes) for name in ("noise", "reach"))
    return Features(values, values.shape[1], noise, reach)
