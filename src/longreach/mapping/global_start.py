"""Where on a map the base is, when nothing says so: hypotheses from a search over the whole map, settled by driving.

    search     branch and bound over all turns and all cells near a keyframe; places that agree 0.75 times as well
               as the best, apart from each other
    fit        of the scan to the surfaces about each; its score: the share of beams that agree, less those that pass
               through surfaces
    weights    exp(score / 0.02), over their sum: a place where 4 % of the beams fewer agree keeps the best at 0.9
    settled    one has more than 0.9; else each is tracked while the base drives, and one that falls below 0.01 is out

Scores of the same place again are no new evidence, so they are not summed up: two halls that look the same stay two.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.estimation.planar.state import Correction
from longreach.geometry import se2
from longreach.mapping import _global_start_kernels as kernels
from longreach.mapping import _loop_closure_kernels as pyramid_kernels
from longreach.mapping import map_localizer
from longreach.mapping.known_map import KnownMap, features_of
from longreach.mapping.loop_closure import NEAR, fitted, sampled, seen_through
from longreach.mapping.map_localizer import MapLocalizerState, MapRow
from longreach.mapping.mapper import PathRow
from longreach.measurement import LaserScan
from longreach.odometry import _local_map_kernels as map_kernels
from longreach.odometry.matchers.scan_matcher import Features
from longreach.odometry.scan_geometry import scan_geometry

_CELL = map_kernels.CELL  # [m] of the search
_VISITED = 3.0  # [m] from a keyframe to where the base can be
_TOP = 4  # level of the squares that the search begins with: 16 cells
_LEVER = 10.0  # [m] at which a turn moves a point by a cell
_APART = 1.0, math.radians(20.0)  # [m, rad] between two places
_MOST, _PART, _LEAST = 24, 0.75, 0.35  # places at most; agreement of the best one's, and of all points, at least
_SCORE = 0.45  # of a place, at least; a scan of somewhere else has less
_SOFT = 0.02  # of scores: see above
_SETTLED, _OUT = 0.9, 0.01  # weights
_EVERY = 0.5, math.radians(20.0)  # [m, rad] between scans that are looked at while it is open
SIGMAS = np.diag([0.1**2, 0.1**2, math.radians(2.0) ** 2])  # of a place that is found, for the tracking that follows


class Hypothesis(NamedTuple):
    """A pose (3,) on the map, its score 0 to 1, and its weight among all, 0 to 1."""

    pose: np.ndarray
    score: float
    weight: float


@dataclass(frozen=True, eq=False)
class GlobalStartState:
    """A search that goes on until one place is left.

    hypotheses: best first, none where nothing agrees. candidates: the localizers that track them. settled: the one that
    is left; None: open. looked: the row of the last scan that was looked at.
    """

    known: KnownMap
    T_base_laser: Float[np.ndarray, "4 4"]
    hypotheses: tuple[Hypothesis, ...] = ()
    candidates: tuple[MapLocalizerState, ...] = ()
    settled: MapLocalizerState | None = None
    looked: PathRow | None = None


def init(known: KnownMap, T_base_laser: Float[np.ndarray, "4 4"]) -> GlobalStartState:
    """Start anywhere on a map."""
    return GlobalStartState(known, T_base_laser)


def step(
    state: GlobalStartState, scans: Iterable[LaserScan], rows: Iterable[PathRow]
) -> tuple[GlobalStartState, list[MapRow], list[Correction]]:
    """Take scans with their rows, as `map_localizer.step`; nothing is on the map while it is open."""
    rows, by_stamp = [PathRow(*row) for row in rows], {scan.stamp: scan for scan in scans}
    given: list[MapRow] = []
    for k, row in enumerate(rows):
        if state.settled is not None:
            settled, more, corrections = map_localizer.step(state.settled, by_stamp.values(), rows[k:])
            return replace(state, settled=settled), given + more, corrections
        state = _looked(state, by_stamp.get(row.stamp), row)
        if state.settled is not None:
            given.append(map_localizer.row_of(state.settled, row))
    return state, given, []


def _looked(state: GlobalStartState, scan: LaserScan | None, row: PathRow) -> GlobalStartState:
    """Follow all candidates to a row, and where that is due score them by its scan; search where there are none."""
    tracked = []
    for candidate in state.candidates:
        found, _, _ = map_localizer.step(candidate, [] if scan is None else [scan], [row])
        tracked.append(found)
    state = replace(state, candidates=tuple(tracked))
    if scan is None or not _is_due(state, row):
        return state
    features = features_of(scan, scan_geometry(scan, state.T_base_laser, 5), np.zeros(3))
    state = replace(state, looked=row)
    if not state.candidates:
        found = search(state.known, features)
        starts = [map_localizer.init(state.known, state.T_base_laser, h.pose, SIGMAS) for h in found]
        tracked = [map_localizer.step(start, [scan], [row])[0] for start in starts]
    else:
        scores = [score(state.known, features, pose)[1] for pose in (_now(c, row) for c in tracked)]
        weights = _weights(np.array(scores))
        order = [q for q in np.argsort(-weights).tolist() if weights[q] > _OUT and scores[q] > _SCORE]
        found = [Hypothesis(_now(tracked[q], row), scores[q], float(weights[q])) for q in order]
        tracked = [tracked[q] for q in order]
    is_settled = len(found) > 0 and found[0].weight > _SETTLED
    return replace(
        state, hypotheses=tuple(found), candidates=tuple(tracked), settled=tracked[0] if is_settled else None
    )


def _is_due(state: GlobalStartState, row: PathRow) -> bool:
    if state.looked is None:
        return True
    moved = se2.between(state.looked.pose, row.pose)
    return bool(math.hypot(moved[0], moved[1]) > _EVERY[0] or abs(moved[2]) > _EVERY[1])


def _now(state: MapLocalizerState, row: PathRow) -> np.ndarray:
    return se2.compose(state.T_map_odom, row.pose)


def search(known: KnownMap, scan: Features) -> list[Hypothesis]:
    """Return where on a map a scan may have been taken, best first; nothing where it agrees nowhere."""
    points = sampled(scan)
    levels, corner = _pyramid(known)
    turns = math.ceil(2.0 * math.pi * _LEVER / _CELL)
    cells = np.empty((turns, 2, points.shape[1]), np.int64)
    kernels.turned_cells(points, _CELL, cells)
    squares = _squares(known, corner)
    bounds = np.empty((turns, len(squares)))
    kernels.square_bounds(levels[_TOP], cells, 1 << _TOP, squares, bounds)
    found, whole = np.zeros((_MOST, 4)), 255.0 * points.shape[1]
    apart = _APART[0] / _CELL, _APART[1] * turns / (2.0 * math.pi)
    order = np.argsort(-bounds.ravel())
    count = kernels.places(levels, cells, _TOP, squares, bounds, order, *apart, _PART, _LEAST * whole, found)
    hypotheses: list[tuple[np.ndarray, float]] = []
    for i, k, a, _ in sorted(found[:count].tolist(), key=lambda place: -place[3]):
        pose = np.array([*(corner + (np.array([i, k]) + 0.5) * _CELL), 2.0 * math.pi * a / turns])
        fit, value = score(known, scan, pose)
        is_new = all(not _is_near(fit, other) for other, _ in hypotheses)
        if value > _SCORE and is_new:
            hypotheses.append((fit, value))
    weights = _weights(np.array([value for _, value in hypotheses]))
    made = [Hypothesis(pose, value, float(w)) for (pose, value), w in zip(hypotheses, weights, strict=True)]
    return sorted((h for h in made if h.weight > _OUT), key=lambda h: -h.weight)


def score(known: KnownMap, scan: Features, pose: Float[np.ndarray, "3"]) -> tuple[np.ndarray, float]:
    """Return where a scan fits best about a pose (3,), and the share of its beams that agree there less those that
    pass through surfaces.
    """
    k, _ = known.nearest(pose)
    at, free = se2.between(known.poses[k], pose), np.full(3, 1.0)
    fit = fitted(scan, known.reference(k), at, free, NEAR)
    if not (math.isfinite(fit.scale) and np.isfinite(fit.pose).all()):
        return pose, 0.0
    through = seen_through(scan, known.reference(k), fit.pose)
    return se2.compose(known.poses[k], fit.pose), float(fit.inlier_ratio - through)


def _weights(scores: np.ndarray) -> np.ndarray:
    if len(scores) == 0:
        return scores
    w = np.exp((scores - scores.max()) / _SOFT)
    return w / w.sum()


def _is_near(a: np.ndarray, b: np.ndarray) -> bool:
    off = se2.between(a, b)
    return bool(math.hypot(off[0], off[1]) < 0.5 * _APART[0] and abs(off[2]) < 0.5 * _APART[1])


def _pyramid(known: KnownMap) -> tuple[np.ndarray, np.ndarray]:
    """Return the levels of the likelihood field of the whole map, and where it begins (2,) [m]."""
    elements = np.concatenate([surface.in_map for surface in known.surfaces])
    fine = _CELL / map_kernels.FINE
    coarse = map_kernels.COARSE * fine
    corner = coarse * (np.floor(elements[:, :2].min(axis=0) / coarse) - 2)
    n, m = (np.floor((elements[:, :2].max(axis=0) - corner) / coarse) + 3).astype(int).tolist()
    pooled = np.zeros((n, m), np.uint8)
    field = np.zeros((map_kernels.COARSE * n, map_kernels.COARSE * m), np.uint8)
    map_kernels.likelihood_field(elements, corner, np.zeros(2, np.int64), field, pooled)
    levels = np.empty((_TOP + 1, map_kernels.COARSE * n // 2, map_kernels.COARSE * m // 2), np.uint8)
    pyramid_kernels.pyramid(field, levels)
    return levels, corner


def _squares(known: KnownMap, corner: np.ndarray) -> np.ndarray:
    """Return the first cells (q, 2) of the squares in which the base can be."""
    width = _CELL * (1 << _TOP)
    low = np.floor((known.poses[:, :2].min(axis=0) - _VISITED - corner) / width).astype(np.int64)
    high = np.floor((known.poses[:, :2].max(axis=0) + _VISITED - corner) / width).astype(np.int64)
    i, k = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1), indexing="ij")
    first = np.column_stack([i.ravel(), k.ravel()])
    middle = corner + (first + 0.5) * width
    distance = np.array([known.nearest(np.array([*at, 0.0]))[1] for at in middle])
    return first[distance < _VISITED + 0.7 * width] * (1 << _TOP)
