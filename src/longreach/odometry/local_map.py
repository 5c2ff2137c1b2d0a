"""The local map: the surfaces that the last keyframes saw, in one frame, which scans are matched against.

Its frame is that in which the first keyframe stood at the origin; keyframes are placed where they were matched, once.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import compress
from statistics import median

import numpy as np
from jaxtyping import Float

from longreach.odometry import _local_map_kernels as _kernels
from longreach.odometry._local_map_kernels import Surfaces
from longreach.odometry.matchers.scan_matcher import Features

_MOST = 40  # keyframes: more do not make it better (benchmarks/recordings.py), fewer let it drift
_FARTHEST = 12.0  # [m] from the newest keyframe to the others


@dataclass(frozen=True, eq=False)
class Keyframe:
    """Where the base was in the map (3,), and the surface that its scan shows, in the base's frame (k, 6)."""

    pose: Float[np.ndarray, "3"]
    elements: Float[np.ndarray, "k 6"]
    noise: float

    @cached_property
    def in_map(self) -> Float[np.ndarray, "k 6"]:
        """The elements in the map's frame."""
        found, (x, y, t) = self.elements.copy(), self.pose.tolist()
        c, s = math.cos(t), math.sin(t)
        found[:, 0], found[:, 1] = c * found[:, 0] - s * found[:, 1] + x, s * found[:, 0] + c * found[:, 1] + y
        found[:, 2], found[:, 3] = c * found[:, 2] - s * found[:, 3], s * found[:, 2] + c * found[:, 3]
        return found


@dataclass(frozen=True, eq=False)
class LocalMap:
    """Keyframes, oldest first, with their poses and the median of their noise [m], and their surfaces merged."""

    keyframes: tuple[Keyframe, ...]
    surfaces: Surfaces
    noise: float
    poses: Float[np.ndarray, "k 3"]

    @cached_property
    def field(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the likelihood field begins, it and its maxima, for a correlative search; made when first asked for."""
        corner = self.surfaces.origin
        coarse = _kernels.CELL / _kernels.FINE * _kernels.COARSE
        elements = self.surfaces.elements
        positions = elements[:, :2] if len(elements) else corner[None]
        first = np.floor((positions.min(axis=0) - corner) / coarse).astype(np.int64) - 2  # the field ends in zeros
        shape = np.floor((positions.max(axis=0) - corner) / coarse).astype(np.int64) + 3 - first
        pooled = np.zeros(shape, np.uint8)
        field = np.zeros(_kernels.COARSE * shape, np.uint8)
        first *= _kernels.COARSE
        _kernels.likelihood_field(elements, corner, first, field, pooled)
        return first, field, pooled


def keyframe(features: Features, pose: Float[np.ndarray, "3"]) -> Keyframe:
    """Make a keyframe of a scan's features at a pose in the map."""
    elements = np.empty((_kernels.PIECES * features.count + 2, _kernels.ELEMENT))
    n = _kernels.keyframe_elements(features.values, features.count, elements)
    return Keyframe(pose, elements[:n].copy(), features.noise)


def merged(keyframes: Sequence[Keyframe], most: int = _MOST, farthest: float = _FARTHEST) -> LocalMap:
    """Merge the surfaces of the last keyframes, no further [m] from the newest; it is in the middle of the map."""
    poses = np.array([k.pose for k in keyframes[-most:]])
    pose = poses[-1]
    near = (poses[:, 0] - pose[0]) ** 2 + (poses[:, 1] - pose[1]) ** 2 <= farthest**2
    kept, poses = tuple(compress(keyframes[-most:], near)), poses[near]
    seen = np.concatenate([k.in_map for k in kept])
    width = _kernels.SIDE * _kernels.CELL  # cells stay where they are in the map
    origin = width * (np.floor(pose[:2] / width) - _kernels.BLOCKS // 2)
    blocks, at = np.full((_kernels.BLOCKS, _kernels.BLOCKS), -1), np.empty((len(seen), 2), np.int64)
    count = _kernels.find_blocks(seen, origin, blocks, at)
    cells = np.full((count, _kernels.SIDE, _kernels.SIDE, 2), -1, np.int32)
    surfaces = Surfaces(origin, blocks, cells, np.empty_like(seen))
    n = _kernels.merge(seen, at, surfaces)
    surfaces = surfaces._replace(elements=surfaces.elements[:n].copy())
    return LocalMap(kept, surfaces, median([k.noise for k in kept]), poses)
