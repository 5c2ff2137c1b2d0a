"""Where on a map the base is, when nothing says so: hypotheses from a search over the whole map, settled by driving.

    search     branch and bound over all turns and all cells near a keyframe; places that agree 0.75 times as well
               as the best, apart from each other
    fit        of the scan to the surfaces about each, and what its beams say there: how many the map explains, how many
               contradict it; where they end in space that the map has not seen they say nothing
    weights    exp((a quarter of the beams explained − contradictions) / 1.5 % of the beams), over their sum and that
               of a place that the map does not show
    settled    one has more than 0.9; else each is tracked while the base drives, and one that falls below 0.01 is out

Beams of the same place again are no new evidence, so they are not summed up: two halls that look the same stay two.
A base that is lost is searched for in the same way, with odometry's place the more probable one.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.estimation.planar.state import Correction
from longreach.geometry import se2
from longreach.mapping import _global_start_kernels as kernels
from longreach.mapping import _loop_closure_kernels as pyramid_kernels
from longreach.mapping import map_localizer
from longreach.mapping.known_map import Evidence, KnownMap, features_of
from longreach.mapping.loop_closure import CHI2, NEAR, fitted, sampled
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
_SHARE = 0.5  # of the beams that the map covers, explained at least; a scan of somewhere else has less
# A place where 3.3 % of the beams more contradict the map keeps the best at 0.9. Places that are the same differ by up
# to 1.5 % in a simulated world, for the map was made from elsewhere in each. Beams that agree count a quarter of that,
# for where the map ends they would tell as little as those that it knows nothing of.
_AGREES, _SOFT = 0.25, 0.015
# Somewhere that the map does not show explains by chance so much of the beams at the best place, at most: a scan from
# beyond the map's edge had 0.66 to 0.89 in two worlds. With each further look that stays good it is the less probable.
_CHANCE, _LESS, _LEAST_CHANCE = 0.85, 0.05, 0.75
_BY_ODOMETRY = 9.0  # times as probable is a place where odometry has a base that was lost
_AT_LOSS = np.diag([0.5**2, 0.5**2, 0.26**2])  # that odometry's pose is off by more, when it is; as RViz's initial pose
_SETTLED, _OUT = 0.9, 0.01  # weights
_COVERED = 0.5  # share of the beams that the map covers, at least
_EVERY = 0.5, math.radians(20.0)  # [m, rad] between scans that are looked at while it is open
_WAIT = 2.0  # [s] between searches of a base that stands
LOST, FOUND = "the base is lost", "the base is found again"  # how reasons of corrections begin
SIGMAS = np.diag([0.1**2, 0.1**2, math.radians(2.0) ** 2])  # of a place that is found, for the tracking that follows


class Hypothesis(NamedTuple):
    """A pose (3,) on the map, the share of the beams that it explains, and its weight, 0 to 1.

    Weights add up to less than 1: the rest is that of places that the map does not show.
    """

    pose: np.ndarray
    score: float
    weight: float


@dataclass(frozen=True, eq=False)
class GlobalStartState:
    """A search that goes on until one place is left, and begins again when the base is lost.

    hypotheses: best first, none where nothing agrees. candidates: the localizers that track them. settled: the one that
    is left; None: open. looked: the row of the last scan that was looked at; looks: at the same hypotheses. lost: what
    odometry makes of the base since it was lost at a stamp `since`; None: it is not. waiting: scans without their row.
    """

    known: KnownMap
    T_base_laser: Float[np.ndarray, "4 4"]
    hypotheses: tuple[Hypothesis, ...] = ()
    candidates: tuple[MapLocalizerState, ...] = ()
    settled: MapLocalizerState | None = None
    looked: PathRow | None = None
    looks: int = 0
    lost: MapLocalizerState | None = None
    since: float = math.nan
    waiting: tuple[LaserScan, ...] = ()


def init(known: KnownMap, T_base_laser: Float[np.ndarray, "4 4"]) -> GlobalStartState:
    """Start anywhere on a map."""
    return GlobalStartState(known, T_base_laser)


def step(
    state: GlobalStartState, scans: Iterable[LaserScan], rows: Iterable[PathRow]
) -> tuple[GlobalStartState, list[MapRow], list[Correction]]:
    """Take scans with their rows, as `map_localizer.step`.

    Nothing is on the map before the base was found. While it is lost rows are odometry's, and say so.
    """
    waiting = [*state.waiting, *scans]
    by_stamp, newest = {scan.stamp: scan for scan in waiting}, -math.inf
    given: list[MapRow] = []
    corrections: list[Correction] = []
    for row in rows:
        row, newest = PathRow(*row), row[0]
        scan = by_stamp.get(row.stamp)
        if state.settled is not None:
            settled, on_map, said = map_localizer.step(state.settled, [] if scan is None else [scan], [row])
            state = replace(state, settled=settled)
            if said and settled.test.is_lost:
                state, said = _alarmed(state, row, said[0])
                assert state.lost is not None
                on_map = [map_localizer.row_of(state.lost, row)]
        else:
            if state.lost is not None:
                state = replace(state, lost=map_localizer.step(state.lost, [], [row])[0])
            state, said = _looked(state, scan, row)
            at = state.settled or state.lost
            on_map = [] if at is None else [map_localizer.row_of(at, row)]
        given += [r._replace(lost=state.lost is not None) for r in on_map]
        corrections += said
    return replace(state, waiting=tuple(scan for scan in waiting if scan.stamp > newest)), given, corrections


def _alarmed(state: GlobalStartState, row: PathRow, said: Correction) -> tuple[GlobalStartState, list[Correction]]:
    """Give up the place where the base is tracked: from there on odometry alone, which nothing now holds up."""
    assert state.settled is not None
    reason = f"{LOST}: p = {state.settled.test.p:.1g}; {said.reason or 'the fits before were not taken'}"
    P = np.array(state.settled.P)
    P[:3, :3] += _AT_LOSS
    lost = replace(state.settled, P=P, scale=1.0)
    state = replace(state, settled=None, candidates=(), hypotheses=(), looked=None, lost=lost, since=row.stamp)
    return state, [said._replace(status="refused", reason=reason)]


def _looked(state: GlobalStartState, scan: LaserScan | None, row: PathRow) -> tuple[GlobalStartState, list[Correction]]:
    """Follow all candidates to a row, and where that is due score them by its scan; search where there are none."""
    tracked = []
    for candidate in state.candidates:
        found, _, _ = map_localizer.step(candidate, [] if scan is None else [scan], [row])
        tracked.append(found)
    state = replace(state, candidates=tuple(tracked))
    if scan is None or not _is_due(state, row):
        return state, []
    features = features_of(scan, scan_geometry(scan, state.T_base_laser, 5), np.zeros(3))
    is_open = bool(tracked)
    if is_open:
        said = [_seen(state.known, features, _now(c, row))[1] for c in tracked]
        weights = _weights(said, state.looks)
        found = [
            (Hypothesis(_now(c, row), e.share, float(w)), c) for c, e, w in zip(tracked, said, weights, strict=True)
        ]
        found = [(h, c) for h, c in found if h.weight > _OUT and h.score > _SHARE]
    else:
        starts = [
            (h, map_localizer.init(state.known, state.T_base_laser, h.pose, SIGMAS))
            for h in search(state.known, features)
        ]
        found = [(h, map_localizer.step(start, [scan], [row])[0]) for h, start in starts]
    weighed = _by_odometry(state, [h for h, _ in found], row)
    order = sorted(range(len(found)), key=lambda q: -weighed[q].weight)
    hypotheses, tracked = tuple(weighed[q] for q in order), tuple(found[q][1] for q in order)
    looks = state.looks + 1 if is_open and tracked else 1
    state = replace(state, hypotheses=hypotheses, candidates=tracked, looks=looks, looked=row)
    if not tracked or hypotheses[0].weight <= _SETTLED:
        return state, []
    found_again = []
    if state.lost is not None:
        off = se2.difference(map_localizer.row_of(state.lost, row).pose, hypotheses[0].pose)
        reason = f"{FOUND} after {row.stamp - state.since:.1f} s"
        found_again = [Correction(row.stamp, map_localizer.SOURCE, "used", reason, off)]
    return replace(state, settled=tracked[0], candidates=(), lost=None, since=math.nan), found_again


def _by_odometry(state: GlobalStartState, found: list[Hypothesis], row: PathRow) -> list[Hypothesis]:
    """Weigh hypotheses by where odometry has a base that is lost: it may not be so."""
    if state.lost is None or not found:
        return found
    at = map_localizer.row_of(state.lost, row)
    xi = [se2.difference(at.pose, h.pose) for h in found]
    inside = np.array([x @ np.linalg.solve(at.covariance, x) < CHI2 for x in xi])
    weights = np.array([h.weight for h in found]) * np.where(inside, _BY_ODOMETRY, 1.0)
    rest = max(1.0 - sum(h.weight for h in found), 0.0)
    weights /= weights.sum() + rest
    return [h._replace(weight=float(w)) for h, w in zip(found, weights, strict=True)]


def _is_due(state: GlobalStartState, row: PathRow) -> bool:
    if state.looked is None:
        return True
    moved = se2.between(state.looked.pose, row.pose)
    waits = not state.candidates and row.stamp - state.looked.stamp > _WAIT
    return waits or bool(math.hypot(moved[0], moved[1]) > _EVERY[0] or abs(moved[2]) > _EVERY[1])


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
    kept: list[tuple[np.ndarray, Evidence]] = []
    for i, k, a, _ in sorted(found[:count].tolist(), key=lambda place: -place[3]):
        pose = np.array([*(corner + (np.array([i, k]) + 0.5) * _CELL), 2.0 * math.pi * a / turns])
        fit, said = _seen(known, scan, pose)
        if said.share > _SHARE and said.covered > _COVERED and all(not _is_near(fit, other) for other, _ in kept):
            kept.append((fit, said))
    weights = _weights([said for _, said in kept], 0)
    made = [Hypothesis(pose, said.share, float(w)) for (pose, said), w in zip(kept, weights, strict=True)]
    return sorted((h for h in made if h.weight > _OUT), key=lambda h: -h.weight)


def _seen(known: KnownMap, scan: Features, pose: Float[np.ndarray, "3"]) -> tuple[np.ndarray, Evidence]:
    """Return where a scan fits best about a pose (3,), and what its beams say there."""
    k, _ = known.nearest(pose)
    at, free = se2.between(known.poses[k], pose), np.full(3, 1.0)
    fit = fitted(scan, known.reference(k), at, free, NEAR)
    if fit.rows == 0 or not (math.isfinite(fit.scale) and np.isfinite(fit.pose).all()):
        return pose, Evidence(0, scan.count, scan.count)
    on_map = se2.compose(known.poses[k], fit.pose)
    return on_map, known.evidence(k, scan, on_map)


def _weights(said: Sequence[Evidence], looks: int) -> np.ndarray:
    """Return weights of places by their beams; the rest to 1 is that of a place that the map does not show."""
    if not said:
        return np.zeros(0)
    values = np.array([(_AGREES * e.explained - e.against) / max(e.beams, 1) for e in said])
    chance = max(_CHANCE - _LESS * looks, _LEAST_CHANCE)
    elsewhere = said[int(np.argmax(values))].covered * (_AGREES * chance - (1.0 - chance))
    w = np.exp((np.append(values, elsewhere) - max(values.max(), elsewhere)) / _SOFT)
    return w[:-1] / w.sum()


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
