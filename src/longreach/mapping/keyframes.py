"""Keyframes of the map: scans that stand for a place, each with its surfaces and its motion since the one before.

A scan becomes one where the base has moved by 0.5 m or turned by 20° since the last. Its odometry edge is what the
localizer made of wheels, scans and IMU in between.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from statistics import median

import numpy as np
from jaxtyping import Float, Int

from longreach.geometry import se2
from longreach.mapping import _loop_closure_kernels as kernels
from longreach.mapping.consistency import Edge, reversed_edge
from longreach.mapping.pose_graph import Edges, adjoints
from longreach.measurement import LaserScan
from longreach.odometry import local_map
from longreach.odometry.lidar import LidarConfig
from longreach.odometry.local_map import LocalMap
from longreach.odometry.matchers.point_to_line import PointToLine
from longreach.odometry.matchers.scan_matcher import Features

DISTANCE, TURNED = 0.5, math.radians(20.0)  # between keyframes [m, rad]
# How a local map drifts, beyond what matches to it show: a variance a metre of the path [m²/m, rad²/m]. Over 100 m of
# four real logs the heading's NEES is then 0.1 to 1.7, the position's 0.1 to 1.3 (1 is ideal; benchmarks/mapping.py).
DRIFT = np.array([0.01**2, 0.01**2, math.radians(0.2) ** 2])
_SHORTEST = 0.01  # [m] of way that drift is taken for at least
# The part of it that shows from one keyframe to the next: drift is what errors that last over many keyframes add up to.
LOCAL = 0.1
BETWEEN_SESSIONS = 1000.0  # [m] of way, so that none of one is taken for a neighbour of another
_MOST = 20  # keyframes on either side in a place
_BEAMS = 200  # that are followed through a local map
_DEFAULTS = LidarConfig()
# A place shows a part of what a scan sees, so how much of it agrees says nothing of chance; the gates judge that.
MATCHER = PointToLine(_DEFAULTS.fit._replace(chance=0.0), _DEFAULTS.distance, _DEFAULTS.turned, _DEFAULTS.overlap)
# Of the residuals' scatter: an error that all beams which see one surface have in common. From another side a surface
# looks otherwise: corners are round, edges lie elsewhere. With it the variance factor of matches is 1.0 and 1.1 on two
# real logs (FR079, CSAIL), and the NEES of closures, without `bending`, 1 to 5 in simulation.
_SURFACE = 0.4


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A scan that was taken at the pose `odom` (3,) in the frame odom.

    twist (3,): of the base during the sweep [m/s, m/s, rad/s]. covariance (3, 3): of ξ of the motion since the last
    keyframe, with all drift, 0 of the first one of a session, which odometry does not join with the one before;
    local_covariance: with what shows of it between neighbours. way [m]: along the path from the start; a session begins
    far from the last one's end. features: of the scan, in the base's frame.
    """

    scan: LaserScan
    odom: Float[np.ndarray, "3"]
    twist: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    local_covariance: Float[np.ndarray, "3 3"]
    way: float
    features: Features

    @property
    def stamp(self) -> float:
        """Of the scan [s]."""
        return self.scan.stamp

    @cached_property
    def surfaces(self) -> local_map.Keyframe:
        """The surfaces that the scan shows, in the base's frame."""
        return local_map.keyframe(self.features, np.zeros(3))


@dataclass(frozen=True, eq=False)
class Place:
    """What neighbouring keyframes see together, in the frame of one of them.

    keyframes: the middle one last. poses (k, 3): where they are in its frame. rows (k,): their numbers.
    """

    keyframes: Sequence[Keyframe]
    poses: Float[np.ndarray, "k 3"]
    rows: Int[np.ndarray, " k"]

    @property
    def middle(self) -> int:
        """The number of the middle keyframe."""
        return int(self.rows[-1])

    @property
    def bending(self) -> Float[np.ndarray, "3 3"]:
        """Covariance (3, 3) of ξ by which all together are off, as odometry lays them out.

        The mean of a random walk from the middle over a way is off by a third of the variance at its end, and that of
        two such walks to either side by a sixth.
        """
        between = np.sum([k.local_covariance for k in self.keyframes], axis=0)
        return between / (12.0 if np.any(self.rows > self.middle) else 3.0)

    @cached_property
    def local_map(self) -> LocalMap:
        """The surfaces of all, merged."""
        seen = zip(self.keyframes, self.poses, strict=True)
        return local_map.merged([local_map.Keyframe(at, k.surfaces.elements, k.surfaces.noise) for k, at in seen])

    @cached_property
    def changing(self) -> float:
        """The share of the beams of all that pass through a surface of another one, or of their own."""
        seen = zip(self.keyframes, self.poses, strict=True)
        return float(np.mean([seen_through(k.features, self.local_map, at) for k, at in seen]))

    @cached_property
    def joined(self) -> Features:
        """The returns of all, as one scan; beams keep their directions and lengths."""
        parts = []
        for k, (x, y, t) in zip(self.keyframes, self.poses.tolist(), strict=True):
            values, c, s = k.features.values[:, : k.features.count].copy(), math.cos(t), math.sin(t)
            for row, dx, dy in ((0, x, y), (2, 0.0, 0.0), (5, 0.0, 0.0)):  # points, beams, normals
                a, b = values[row].copy(), values[row + 1].copy()
                values[row], values[row + 1] = c * a - s * b + dx, s * a + c * b + dy
            parts.append(values)
        values = np.ascontiguousarray(np.concatenate(parts, axis=1))
        noise, reach = (median(getattr(k.features, name) for k in self.keyframes) for name in ("noise", "reach"))
        return Features(values, values.shape[1], noise, reach)


def seen_through(scan: Features, to: LocalMap, pose: np.ndarray) -> float:
    """Return the share of a scan's beams that pass through a surface of a local map, in which the base is at a pose."""
    stride = max(scan.count // _BEAMS, 1)
    return float(kernels.seen_through(scan.values, scan.count, stride, pose, to.surfaces))


def regions_of(keyframes: Sequence[Keyframe], poses: Float[np.ndarray, "n 3"], reach: float) -> tuple[LocalMap, ...]:
    """Return local maps in the frame of the map, where keyframes are at poses (n, 3): each has one within reach [m]."""
    seen = [k.surfaces for k in keyframes]
    on_map = [local_map.Keyframe(pose, s.elements, s.noise) for pose, s in zip(poses, seen, strict=True)]
    left, found = list(range(len(on_map))), []
    while left:
        centre = poses[left[0], :2]
        far = np.hypot(*(poses[:, :2] - centre).T)
        around = [*np.flatnonzero(far < 1.5 * reach).tolist(), left[0]]  # with what can be seen from its edge
        found.append(local_map.merged([on_map[k] for k in around], len(around), np.inf))
        left = [k for k in left if far[k] > reach - 3.0]
    return tuple(found)


def motion_covariance(
    before: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]],
    after: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]],
    way: float,
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]]:
    """Return the covariances (3, 3) of the motion between two poses (3,) with covariances (3, 3), along a way [m].

    It is what the later covariance has more than the earlier one, for errors of odometry add up, and the drift: all of
    it, and what shows of it between neighbours.
    """
    A = se2.adjoint(se2.between(after[0], before[0]))
    more = after[1] - A @ before[1] @ A.T
    values, vectors = np.linalg.eigh(0.5 * (more + more.T))
    more, drift = vectors * np.maximum(values, 0.0) @ vectors.T, np.diag(DRIFT * max(way, _SHORTEST))
    return more + drift, more + LOCAL * drift


def with_all_drift(local: Float[np.ndarray, "3 3"], way: float) -> Float[np.ndarray, "3 3"]:
    """Return the covariance of a motion over a way [m] with all drift, from one with a part of it that is not known."""
    return local + np.diag(DRIFT * max(way, _SHORTEST))


def matcher(joined: int = 1) -> PointToLine:
    """Return the matcher of so many joined scans to places of before.

    They see the same surfaces, whose errors do not average out over them.
    """
    return replace(MATCHER, settings=MATCHER.settings._replace(surface=_SURFACE * math.sqrt(joined)))


def place_of(keyframes: Sequence[Keyframe], rows: Int[np.ndarray, " k"], poses: Float[np.ndarray, "k 3"]) -> Place:
    """Return the place of some rows of keyframes, the middle one last, at poses (k, 3) in any one frame."""
    return Place([keyframes[q] for q in rows], se2.between(np.broadcast_to(poses[-1], poses.shape), poses), rows)


def ways(keyframes: Sequence[Keyframe]) -> Float[np.ndarray, " n"]:
    """Return the way [m] at each keyframe."""
    return np.array([k.way for k in keyframes])


def neighbours(way: Float[np.ndarray, " n"], c: int, before: float, after: float) -> Int[np.ndarray, " k"]:
    """Return the rows within so much of the way [m] about row c, c last."""
    low, high = np.searchsorted(way, way[c] - before), np.searchsorted(way, way[c] + after, side="right")
    low, high = max(low, c - _MOST), min(high, c + _MOST + 1)
    return np.array([*range(low, c), *range(c + 1, high), c])


def odometry_edges(keyframes: Sequence[Keyframe], drift: float = 1.0) -> Edges:
    """Return the edges from each keyframe to the next one of its session; drift: a factor of its covariance."""
    odom, way = np.array([k.odom for k in keyframes]), ways(keyframes)
    j = np.array([k for k in range(1, len(keyframes)) if keyframes[k].covariance.any()], dtype=int)
    covariance = np.array([keyframes[k].covariance for k in j]).reshape(-1, 3, 3)
    less = (1.0 - drift) * np.maximum(way[j] - way[j - 1], _SHORTEST)
    covariance = covariance - less[:, None, None] * np.diag(DRIFT)
    return Edges(j - 1, j, se2.between(odom[j - 1], odom[j]), covariance)


def odometry_between(keyframes: Sequence[Keyframe], i: int, j: int) -> Edge:
    """Return keyframe j seen from keyframe i by odometry alone, with the covariance of its ξ."""
    if i == j:
        return np.zeros(3), np.zeros((3, 3))
    if i > j:
        return reversed_edge(odometry_between(keyframes, j, i))
    odom = np.array([k.odom for k in keyframes[i + 1 : j + 1]])
    A = adjoints(se2.between(np.broadcast_to(odom[-1], odom.shape), odom))
    S = np.array([k.covariance for k in keyframes[i + 1 : j + 1]])
    return se2.between(keyframes[i].odom, odom[-1]), np.einsum("kab,kbc,kdc->ad", A, S, A)
