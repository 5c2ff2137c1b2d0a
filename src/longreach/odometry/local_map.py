"""The local map: the surfaces that the last keyframes saw, in one frame, which scans are matched against.

Its frame is that in which the first keyframe stood at the origin; keyframes are placed where they were matched, once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from longreach.odometry import _local_map_kernels as _kernels
from longreach.odometry.matchers.scan_matcher import Features

_MOST = 40  # keyframes: more do not make it better (benchmarks/recordings.py), fewer let it drift
_FARTHEST = 12.0  # [m] from the newest keyframe to the others


@dataclass(frozen=True, eq=False)
class Keyframe:
    """Where the base was in the map (3,), and the surface that its scan shows, in the base's frame (k, 6)."""

    pose: Float[np.ndarray, "3"]
    elements: Float[np.ndarray, "k 6"]
    noise: float


@dataclass(frozen=True, eq=False)
class LocalMap:
    """Keyframes, oldest first, and their surfaces merged; arrays as of `_local_map_kernels`."""

    keyframes: tuple[Keyframe, ...]
    origin: Float[np.ndarray, "2"]
    blocks: Int[np.ndarray, "b b"]
    cells: Int[np.ndarray, "n c c 2"]
    elements: Float[np.ndarray, "m 6"]
    noise: float
    poses: Float[np.ndarray, "k 3"]

    @cached_property
    def field(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The likelihood field and its maxima, for a correlative search, with its blocks; made when first asked for.

        It has the blocks next to surfaces, too: a surface at the border of its block reaches into the next one.
        """
        near = np.lib.stride_tricks.sliding_window_view(np.pad(self.blocks >= 0, 1), (3, 3)).any(axis=(2, 3))
        blocks, count = np.full_like(self.blocks, -1), np.count_nonzero(near)
        blocks[near] = np.arange(count)
        side = _kernels.FINE * _kernels.SIDE
        field = np.empty((count, side, side), np.uint8)
        _kernels.likelihood_field(self.elements, len(self.elements), self.origin, blocks, field)
        pooled = np.empty((count, side // _kernels.COARSE, side // _kernels.COARSE), np.uint8)
        _kernels.pool(field, blocks, pooled)
        return blocks, field, pooled


def keyframe(features: Features, pose: Float[np.ndarray, "3"]) -> Keyframe:
    """Make a keyframe of a scan's features at a pose in the map."""
    elements = np.empty((_kernels.PIECES * features.count + 2, _kernels.ELEMENT))
    n = _kernels.keyframe_elements(features.values, features.count, elements)
    return Keyframe(pose, elements[:n].copy(), features.noise)


def merged(keyframes: Sequence[Keyframe]) -> LocalMap:
    """Merge the surfaces of keyframes, as many and as near to the newest as a map takes."""
    pose = keyframes[-1].pose
    near = [k for k in keyframes[-_MOST:] if (k.pose[0] - pose[0]) ** 2 + (k.pose[1] - pose[1]) ** 2 <= _FARTHEST**2]
    total = sum(len(k.elements) for k in near)
    width = _kernels.SIDE * _kernels.CELL  # cells stay where they are in the map
    origin = width * (np.floor(pose[:2] / width) - _kernels.BLOCKS // 2)
    blocks = np.full((_kernels.BLOCKS, _kernels.BLOCKS), -1, np.int64)
    cells = np.empty((min(total, _kernels.BLOCKS**2), _kernels.SIDE, _kernels.SIDE, 2), np.int32)
    elements, used = np.empty((total, _kernels.ELEMENT)), np.zeros(2, np.int64)
    for k in near:
        _kernels.merge(k.elements, k.pose, origin, blocks, cells, used, elements)
    _kernels.finish(elements, used[1])
    noise = float(np.median([k.noise for k in near]))
    poses = np.array([k.pose for k in near])
    return LocalMap(tuple(near), origin, blocks, cells[: used[0]].copy(), elements[: used[1]].copy(), noise, poses)
