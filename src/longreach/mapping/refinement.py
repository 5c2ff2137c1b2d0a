"""Refinement after the last closure: every keyframe is matched to each other pass by it, and the graph solved again.

It is what improves a map once its loops are closed: closures are a metre apart, and tie joined scans to places that
odometry laid out; here each scan is tied to places as the solved graph lays them out, and the surfaces move with it.
So many edges tell by their residuals how far odometry drifts, and whether matches are as good as they say.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.mapping import loop_closure, solver
from longreach.mapping.keyframes import LOCAL, Keyframe, Place, neighbours, odometry_edges, place_of, ways
from longreach.mapping.pose_graph import Edges, PoseGraph, adjoints, joined, no_edges
from longreach.mapping.solver import Solved

_ROUNDS = 10  # of scaling covariances at most,
_FOUND = 2.0  # until drift's variance changes by less than this factor: deviations then by less than 1.4
_STATED = 30.0  # residuals that say that covariances are as stated; ours, as many as ten edges have
_REACH = 2.5  # [m] from a keyframe to another pass,
_PASSES = 4  # the nearest ones of which are taken
_ELSEWHERE = 10.0  # [m] of path to another pass,
_GAP = 5.0  # [m] of path between two passes
_AROUND = 5.0  # [m] of path that make a place
_SIGMA = np.array([0.15, 0.15, 0.05])  # [m, m, rad] deviations of a fit's prior about the solved pose
_OVERLAP, _AGREES = 0.3, 0.6  # share of a scan's returns that see the place, and of these that agree, at least


class Refined(NamedTuple):
    """A refined graph; noise (n, 3, 3): covariance of what the noise of a keyframe's own scan does to its pose.

    All edges of a keyframe have its scan's noise in common: they agree on a pose that is off by as much.
    """

    solved: Solved
    noise: Float[np.ndarray, "n 3 3"]

    @property
    def marginals(self) -> Float[np.ndarray, "n 3 3"]:
        """Return the covariance of each keyframe's pose, as seen from the first; 0 of that."""
        A = adjoints(se2.between(self.solved.poses, self.solved.poses[0]))
        P = solver.marginals(self.solved) + self.noise + A @ self.noise[0] @ A.transpose(0, 2, 1)
        P[0] = 0.0
        return P


def refined(
    keyframes: tuple[Keyframe, ...],
    poses: Float[np.ndarray, "n 3"],
    closures: Edges,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Refined:
    """Match every keyframe to other passes as poses (n, 3), whose loops are closed, lay them out; then solve, robustly.

    Closures stay in the graph, before the edges to other passes. Once: what a second time changes is within what
    relations show of four real logs. Drift and matches' covariances are scaled by what their residuals say; the latter
    never down, for matches agree in errors that they have in common.
    """
    fits, noise = _passes(keyframes, poses, progress)
    edges, drift, more = joined(closures, fits), LOCAL, 1.0
    solved = solver.optimize_robust(PoseGraph(poses, odometry_edges(keyframes, drift), edges))
    for _ in range(_ROUNDS):
        of_drift, of_matches = solver.variance_factors(solved, _STATED)
        drift, more = drift * of_drift, max(more * of_matches, 1.0)
        scaled = Edges(edges.i, edges.j, edges.z, more * edges.covariance)
        solved = solver.optimize_robust(PoseGraph(solved.poses, odometry_edges(keyframes, drift), scaled))
        if 1.0 / _FOUND < of_drift < _FOUND:
            break
    return Refined(solved, more * noise)


def _passes(
    keyframes: tuple[Keyframe, ...], poses: Float[np.ndarray, "n 3"], progress: Callable[[float], None]
) -> tuple[Edges, Float[np.ndarray, "n 3 3"]]:
    """Return edges from other passes to every keyframe, and the covariance of what its scan's own noise does to each.

    The latter is that of a match to one place: where there is none that shows all directions, the mean of the others.
    """
    way, places, found = ways(keyframes), dict[int, Place](), []
    noise = np.full((len(keyframes), 3, 3), np.nan)
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
                found.append((c, k, fit.pose, fit.covariance))
                if len(fit.directions) == 0 and np.isnan(noise[k, 0, 0]):
                    prior = np.full(3, 100.0)
                    noise[k] = loop_closure.fitted(
                        keyframe.features, places[c].local_map, at, prior, _SIGMA, 0
                    ).covariance
    known = ~np.isnan(noise[:, 0, 0])
    noise[~known] = noise[known].mean(axis=0) if np.any(known) else 0.0
    return Edges(*(np.array(column) for column in zip(*found, strict=True))) if found else no_edges(), noise


def _middles(way: Float[np.ndarray, " n"], poses: Float[np.ndarray, "n 3"], k: int) -> list[int]:
    """Return the keyframe of each other pass that is nearest to keyframe k; of two neighbours the even one."""
    distance = np.hypot(poses[:, 0] - poses[k, 0], poses[:, 1] - poses[k, 1])
    near = np.flatnonzero((distance < _REACH) & (np.abs(way - way[k]) > _ELSEWHERE))
    if len(near) == 0:
        return []
    passes = np.split(near, np.flatnonzero(np.diff(way[near]) > _GAP) + 1)
    nearest = sorted((float(distance[p].min()), int(p[np.argmin(distance[p])])) for p in passes)[:_PASSES]
    return [c - 1 if c % 2 and way[c] - way[c - 1] < _GAP else c for _, c in nearest]
