"""Loop closure: where joined scans of now fit a local map of before, within what the pose graph leaves open.

    window     3.5 σ of the relative pose between old keyframe and now, from the graph
    search     branch and bound over the window (Hess et al. 2016), and again for a second peak
    fit        point to line from the best pose, its covariance from the residuals
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.mapping import _loop_closure_kernels as kernels
from longreach.odometry import _local_map_kernels as map_kernels
from longreach.odometry.lidar import LidarConfig, matcher_of
from longreach.odometry.local_map import LocalMap
from longreach.odometry.matchers import _correlative_kernels
from longreach.odometry.matchers.scan_matcher import Features, Fit, Prior

WINDOW = 3.5  # deviations of the relative pose: a true one is beyond with 0.7 % (χ², 3 degrees of freedom)
_CELL = map_kernels.CELL  # [m] of the search
_POINTS = 160  # of the joined scans that take part in the search
_APART = 1.0  # [m] between two peaks; aliases of corridors are a metre and more apart
_NEAR = np.array([0.3, 0.3, 0.1])  # [m, m, rad] deviations of the fit's prior about a peak: wide against a cell


@dataclass(frozen=True, eq=False)
class Peak:
    """The best pose (3,) of a search, how well it agrees, 0 to 1, and how well the best one elsewhere does."""

    pose: Float[np.ndarray, "3"]
    agreement: float


class Window:
    """The poses of now, in the frame of a local map, that the graph allows: a mean (3,) and a covariance (3, 3) of ξ."""

    def __init__(self, place: LocalMap, points: Float[np.ndarray, "2 m"], mean: np.ndarray, covariance: np.ndarray):
        """Prepare the search of points (2, m) in the frame of the base."""
        first, field, _ = place.field
        cells = field[: 2 * (field.shape[0] // 2), : 2 * (field.shape[1] // 2)]
        self.levels = np.empty((kernels.LEVELS, cells.shape[0] // 2, cells.shape[1] // 2), np.uint8)
        kernels.pyramid(cells, self.levels)
        corner = place.surfaces.origin + first * (map_kernels.CELL / map_kernels.FINE)
        R = np.eye(3)
        R[:2, :2] = [[math.cos(mean[2]), -math.sin(mean[2])], [math.sin(mean[2]), math.cos(mean[2])]]
        covariance = R @ covariance @ R.T + np.diag([_CELL**2, _CELL**2, 0.02**2])
        self.mean, self.information, half = mean, np.linalg.inv(covariance), WINDOW * np.sqrt(np.diag(covariance))
        farthest = float(np.sqrt((points**2).sum(axis=0)).max())
        turn = math.acos(1.0 - 0.5 * (_CELL / max(farthest, 1.0)) ** 2)
        half[2] = min(half[2], math.pi)
        self.steps = _CELL, turn
        self.sizes = tuple(int(math.ceil(h / s)) for h, s in zip(half, (_CELL, _CELL, turn), strict=True))
        self.cells = np.empty((2 * self.sizes[2] + 1, 2, points.shape[1]), np.int64)
        kernels.place_points(points, corner, _CELL, mean, self.sizes, turn, self.cells)
        widest = 2 * max(self.sizes[:2]) + 1
        self.top = min(kernels.LEVELS - 1, int(math.log2(widest)))
        width = 1 << self.top
        roots = np.empty((len(self.cells), *(2 * n // width + 1 for n in self.sizes[:2])))
        kernels.root_bounds(self.levels[self.top], self.cells, width, self.sizes, roots)
        self.roots = roots.ravel()
        self.order = np.argsort(-self.roots)

    def best(self, least: float, apart: float = -1.0, other: np.ndarray | None = None, along: np.ndarray | None = None):
        """Return the best peak above `least`, or None; not within `apart` [m] of another pose, but for a direction."""
        found = np.zeros(3) if other is None else other - self.mean
        along, at = np.zeros(2) if along is None else along, np.zeros(3)
        value = kernels.descend(
            self.levels, self.cells, self.top, self.sizes, self.roots, self.order, self.steps,
            self.information, WINDOW**2, apart, found, along, least, at,
        )  # fmt: skip
        return Peak(self.mean + at, value) if value > least else None


def sampled(features: Features) -> Float[np.ndarray, "2 m"]:
    """Return points of joined scans that lie evenly along their surfaces: the first one in each cell."""
    points = features.values[:2]
    cells = np.floor(points / (2 * _CELL)).astype(np.int64)
    _, at = np.unique(cells[0] * 100003 + cells[1], return_index=True)
    at = at[:: max(len(at) // _POINTS, 1)]
    return np.ascontiguousarray(points[:, np.sort(at)])


@lru_cache(1)
def _matcher():
    return matcher_of(LidarConfig())


def fitted(features: Features, place: LocalMap, pose: np.ndarray, free: np.ndarray, sigma: np.ndarray = _NEAR) -> Fit:
    """Fit joined scans to a local map about a pose (3,); free (3,): variances along what they do not show."""
    return _matcher().fit(features, place, Prior(pose, sigma, free, free), pose)


def seen_through(features: Features, place: LocalMap, pose: np.ndarray) -> float:
    """Return the share of beams that pass through a surface of the map."""
    first, field, _ = place.field
    stride = max(features.count // 200, 1)
    return float(
        _correlative_kernels._through(
            features.values, features.count, stride, *pose.tolist(), place.surfaces.origin, first, field
        )
    )
