"""Refinement after the last closure: every keyframe is matched to each other pass by it, and the graph solved again.

It is what improves a map once its loops are closed: closures are a metre apart, and tie joined scans to places that
odometry laid out; here each scan is tied to places as the solved graph lays them out, and the surfaces move with it.
"""

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.mapping import loop_closure, solver
from longreach.mapping.keyframes import Keyframe, Place, local_edges, neighbours, place_of, ways
from longreach.mapping.pose_graph import Edges, PoseGraph, joined, no_edges
from longreach.mapping.solver import Solved

_REACH = 2.5  # [m] from a keyframe to another pass,
_PASSES = 4  # the nearest ones of which are taken
_ELSEWHERE = 10.0  # [m] of path to another pass,
_GAP = 5.0  # [m] of path between two passes
_AROUND = 5.0  # [m] of path that make a place
_SIGMA = np.array([0.15, 0.15, 0.05])  # [m, m, rad] deviations of a fit's prior about the solved pose
_OVERLAP, _AGREES = 0.3, 0.6  # share of a scan's returns that see the place, and of these that agree, at least


def refined(
    keyframes: tuple[Keyframe, ...],
    poses: Float[np.ndarray, "n 3"],
    closures: Edges,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Solved:
    """Match every keyframe to other passes as poses (n, 3), whose loops are closed, lay them out; then solve, robustly.

    Closures stay in the graph, before the edges to other passes. Once: what a second time changes is within what
    relations show of four real logs.
    """
    edges = joined(closures, _passes(keyframes, poses, progress))
    return solver.optimize_robust(PoseGraph(poses, local_edges(keyframes), edges))


def _passes(
    keyframes: tuple[Keyframe, ...], poses: Float[np.ndarray, "n 3"], progress: Callable[[float], None]
) -> Edges:
    """Return edges from other passes to every keyframe."""
    way, places, found = ways(keyframes), dict[int, Place](), []
    for k, keyframe in enumerate(keyframes):
        if k % 50 == 0:
            progress(k / len(keyframes))
        for c in _middles(way, poses, k):
            if c not in places:
                rows = neighbours(way, c, _AROUND, _AROUND)
                places[c] = place_of(keyframes, rows, poses[rows])
            at = se2.between(poses[c], poses[k])
            fit = loop_closure.fitted(keyframe.features, places[c].local_map, at, np.full(3, 100.0), _SIGMA)
            overlap = fit.rows / max(keyframe.features.count, 1)
            if overlap >= _OVERLAP and fit.inlier_ratio >= _AGREES * overlap and math.isfinite(fit.scale):
                found.append((c, k, fit.pose, loop_closure.covariance_of(fit, keyframe.features.reach)))
    return Edges(*(np.array(column) for column in zip(*found, strict=True))) if found else no_edges()


def _middles(way: Float[np.ndarray, " n"], poses: Float[np.ndarray, "n 3"], k: int) -> list[int]:
    """Return the keyframe of each other pass that is nearest to keyframe k; of two neighbours the even one."""
    distance = np.hypot(poses[:, 0] - poses[k, 0], poses[:, 1] - poses[k, 1])
    near = np.flatnonzero((distance < _REACH) & (np.abs(way - way[k]) > _ELSEWHERE))
    if len(near) == 0:
        return []
    passes = np.split(near, np.flatnonzero(np.diff(way[near]) > _GAP) + 1)
    nearest = sorted((float(distance[p].min()), int(p[np.argmin(distance[p])])) for p in passes)[:_PASSES]
    return [c - c % 2 for _, c in nearest]
