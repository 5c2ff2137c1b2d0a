"""The mapper: scans and the localizer's path in; keyframes, loop closures and a solved pose graph out, as they come.

    keyframe   ← scan, where the base has moved enough; its edge from the localizer's path
    candidates ← old keyframes within 3.5 σ of the relative pose that the graph gives     every metre
    match      ← joined scans of now in the place of each candidate                       `loop_closure`
    closure    ← a match in a window too small for an alias, or one that others agree with `consistency`
    poses      ← robust solution of the graph; closures that it contradicts are withdrawn  `solver`

A recording is a fold of `step`, after which `refined` matches every keyframe to each other pass by it.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from longreach.geometry import se2
from longreach.mapping import loop_closure, solver
from longreach.mapping.consistency import Edge, cycle_chi2, largest_clique, reversed_edge
from longreach.mapping.keyframes import DISTANCE, MATCHER, TURNED, Keyframe, Place, motion_covariance, place_of
from longreach.mapping.loop_closure import CHI2, Match
from longreach.mapping.pose_graph import Edges, PoseGraph, adjoints, no_edges
from longreach.mapping.solver import Solved
from longreach.measurement import LaserScan
from longreach.odometry.scan_geometry import ScanGeometry, same_kind, scan_geometry, share_of_a_beam

_EVERY = 1.0, math.radians(60.0)  # between keyframes that look for closures [m, rad]
_ELSEWHERE = 10.0  # [m] of path between the ends of a closure: nearer, odometry's local map has them both
_REACH = 3.0  # [m] between poses whose scans show the same surfaces
_TRIED = 3  # candidates of a keyframe,
_BETWEEN = 8.0  # [m] of path between these
_AROUND, _BEHIND = 5.0, 3.0  # [m] of path about an old keyframe that make a place, and behind the newest
_MOST = 20  # keyframes on either side in a place
_SURE = 0.5 * loop_closure.APART  # [m]: a smaller window has no room for two places that look the same
_NEIGHBOURS = 20.0  # [m] of path between closures that confirm each other,
_OTHERS = 20  # the last ones of them
_LONG = 100.0  # [m] of path without a closure, after which it takes three that agree, else two
_RECENT = 5.0  # [m] of path after which sure closures are solved at the latest,
_NEWS = 7.81  # or at a χ² beyond 95 %
_PLACES = 64  # kept
_SAMPLES = 8  # keyframes at which it is looked whether new closures put walls where others look through


class PathRow(NamedTuple):
    """Pose (3,) and covariance (3, 3) of ξ in the frame odom at a stamp [s], as of the localizer."""

    stamp: float
    pose: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class MapperState:
    """What a mapper knows.

    poses (n, 3): of the keyframes on the map. matches: all that were tried; accepted: which of them are closures.
    solved: the graph as last solved, of the first keyframes; since (3, 3): the covariance of the motion from the last of
    these to the newest keyframe. waiting: scans whose row has not come. last: the row of the last scan; at_keyframe: of
    the newest keyframe. way [m]: driven so far. looked: way [m] and heading [rad] of the last search.
    """

    T_base_laser: Float[np.ndarray, "4 4"]
    keyframes: tuple[Keyframe, ...] = ()
    poses: Float[np.ndarray, "n 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    matches: tuple[Match, ...] = ()
    accepted: tuple[int, ...] = ()
    solved: Solved | None = None
    since: Float[np.ndarray, "3 3"] = field(default_factory=lambda: np.zeros((3, 3)))
    waiting: tuple[LaserScan, ...] = ()
    last: PathRow | None = None
    at_keyframe: PathRow | None = None
    way: float = 0.0
    looked: tuple[float, float] = (-math.inf, 0.0)
    geometry: ScanGeometry | None = None
    places: dict[int, Place] = field(default_factory=dict)  # a cache: what is in it follows from the keyframes

    @property
    def T_map_odom(self) -> Float[np.ndarray, "3"]:
        """Where the frame odom is on the map now: identity before the first keyframe."""
        if not self.keyframes:
            return np.zeros(3)
        return se2.compose(self.poses[-1], se2.inverse(self.keyframes[-1].odom))

    @property
    def withdrawn(self) -> tuple[int, ...]:
        """The accepted matches that the graph as last solved gives no weight."""
        weights = () if self.solved is None else self.solved.weights
        return tuple(a for a, weight in zip(self.accepted, weights, strict=False) if weight < 0.5)


def init(T_base_laser: Float[np.ndarray, "4 4"]) -> MapperState:
    """Start before the first scan."""
    return MapperState(T_base_laser)


def step(state: MapperState, scans: Iterable[LaserScan], rows: Iterable[PathRow]) -> MapperState:
    """Take scans, and rows of the localizer's path in the order of their stamps; a scan is used when its row is there."""
    waiting = [*state.waiting, *scans]
    by_stamp = {scan.stamp: scan for scan in waiting}
    for stamp, pose, covariance in rows:
        if stamp in by_stamp:
            state = _taken(state, by_stamp[stamp], PathRow(stamp, pose, covariance))
    newest = -math.inf if state.last is None else state.last.stamp
    return replace(state, waiting=tuple(scan for scan in waiting if scan.stamp > newest))


def _taken(state: MapperState, scan: LaserScan, row: PathRow) -> MapperState:
    """Take a scan with its row: a keyframe where the base has moved enough, and a search where that is due."""
    share, motion, way = 0.0, np.zeros(3), state.way
    geometry = state.geometry
    if geometry is None or not same_kind(scan, geometry):
        geometry = scan_geometry(scan, state.T_base_laser, 5)
    if state.last is not None:
        moved = se2.between(state.last.pose, row.pose)
        way += math.hypot(moved[0], moved[1])
        share = share_of_a_beam(scan, row.stamp - state.last.stamp)
        motion = se2.adjoint(se2.inverse(geometry.pose_base_laser)) @ se2.log(moved)
    state = replace(state, last=row, way=way, geometry=geometry)
    if state.at_keyframe is not None:
        moved = se2.between(state.at_keyframe.pose, row.pose)
        if math.hypot(moved[0], moved[1]) < DISTANCE and abs(moved[2]) < TURNED:
            return state
    state = _with_keyframe(state, row, MATCHER.features(scan, geometry, motion, share))
    turned = abs(math.remainder(row.pose[2] - state.looked[1], 2 * math.pi))
    if way - state.looked[0] < _EVERY[0] and turned < _EVERY[1]:
        return state
    return _looked(replace(state, looked=(way, float(row.pose[2]))))


def _with_keyframe(state: MapperState, row: PathRow, features) -> MapperState:
    before = state.at_keyframe
    if before is None:
        first = Keyframe(row.stamp, row.pose, np.diag([1e-6] * 3), state.way, features)
        return _solved(replace(state, keyframes=(first,), poses=row.pose[None].copy(), at_keyframe=row))
    moved = se2.between(before.pose, row.pose)
    covariance = motion_covariance(before[1:], row[1:], state.way - state.keyframes[-1].way)
    A = se2.adjoint(se2.inverse(moved))
    return replace(
        state,
        keyframes=(*state.keyframes, Keyframe(row.stamp, row.pose, covariance, state.way, features)),
        poses=np.concatenate([state.poses, se2.compose(state.poses[-1], moved)[None]]),
        at_keyframe=row,
        since=A @ state.since @ A.T + covariance,
    )


def ways(keyframes: Sequence[Keyframe]) -> Float[np.ndarray, " n"]:
    """Return the way [m] at each keyframe."""
    return np.array([k.way for k in keyframes])


def odometry_edges(keyframes: Sequence[Keyframe]) -> Edges:
    """Return the edges from each keyframe to the next."""
    n, odom = len(keyframes), np.array([k.odom for k in keyframes])
    covariance = np.array([k.covariance for k in keyframes[1:]]).reshape(-1, 3, 3)
    return Edges(np.arange(n - 1), np.arange(1, n), se2.between(odom[:-1], odom[1:]), covariance)


def closure_edges(matches: Sequence[Match]) -> Edges:
    """Return matches as edges."""
    if not matches:
        return no_edges()
    return Edges(*(np.array([getattr(m, name) for m in matches]) for name in ("i", "j", "pose", "covariance")))


def _solved(state: MapperState) -> MapperState:
    """Solve the graph; robustly, where a closure is off by more than 99.9 %."""
    closures = closure_edges([state.matches[a] for a in state.accepted])
    graph = PoseGraph(state.poses, odometry_edges(state.keyframes), closures)
    solved = solver.optimize(graph)
    if np.any(solved.closure_chi2 > CHI2):
        solved = solver.optimize_robust(graph)
    return replace(state, solved=solved, poses=solved.poses, since=np.zeros((3, 3)))


def odometry_between(keyframes: Sequence[Keyframe], i: int, j: int) -> Edge:
    """Return keyframe j seen from keyframe i by odometry alone, with its covariance."""
    if i == j:
        return np.zeros(3), np.zeros((3, 3))
    if i > j:
        return reversed_edge(odometry_between(keyframes, j, i))
    odom = np.array([k.odom for k in keyframes[i + 1 : j + 1]])
    A = adjoints(se2.between(np.broadcast_to(odom[-1], odom.shape), odom))
    S = np.array([k.covariance for k in keyframes[i + 1 : j + 1]])
    return se2.between(keyframes[i].odom, odom[-1]), np.einsum("kab,kbc,kdc->ad", A, S, A)


def neighbours(way: Float[np.ndarray, " n"], c: int, before: float, after: float) -> Int[np.ndarray, " k"]:
    """Return the rows within so much of the way [m] about row c, c last."""
    low, high = np.searchsorted(way, way[c] - before), np.searchsorted(way, way[c] + after, side="right")
    low, high = max(low, c - _MOST), min(high, c + _MOST + 1)
    return np.array([*range(low, c), *range(c + 1, high), c])


def _place(state: MapperState, c: int) -> Place:
    """Return the place about an old keyframe, laid out by odometry."""
    if c not in state.places:
        if len(state.places) >= _PLACES:
            state.places.pop(next(iter(state.places)))
        rows = neighbours(ways(state.keyframes), c, _AROUND, _AROUND)
        state.places[c] = place_of(state.keyframes, rows, np.array([state.keyframes[q].odom for q in rows]))
    return state.places[c]


class _Candidate(NamedTuple):
    """An old keyframe, the newest one as the graph sees it from there (3,), and the covariance (3, 3) of its ξ."""

    row: int
    mean: np.ndarray
    covariance: np.ndarray


def _candidates(state: MapperState) -> list[_Candidate]:
    """Return old keyframes near which the base may be, best known first, apart from each other."""
    assert state.solved is not None
    way, newest, s = ways(state.keyframes), state.poses[-1], len(state.solved.poses) - 1
    old = np.flatnonzero(way[: s + 1] < way[-1] - _ELSEWHERE)
    if len(old) == 0:
        return []
    near = np.hypot(*(state.poses[old, :2] - newest[:2]).T)
    S = solver.relative_covariances(state.solved, old, np.full(len(old), s))
    A = se2.adjoint(se2.between(newest, state.poses[s]))
    S = A @ S @ A.T + state.since
    back = se2.between(np.broadcast_to(newest, (len(old), 3)), state.poses[old])
    u = back[:, :2] / np.maximum(near, 1e-6)[:, None]
    variance = np.einsum("ka,kab,kb->k", u, S[:, :2, :2], u)
    in_reach = near - loop_closure.WINDOW * np.sqrt(variance) < _REACH
    cost = near**2 / (variance + (0.5 * _REACH) ** 2) + back[:, 2] ** 2 / (S[:, 2, 2] + 1.0)  # another heading shares less
    found: list[_Candidate] = []
    for a in np.argsort(cost).tolist():
        if in_reach[a] and all(abs(way[old[a]] - way[c.row]) > _BETWEEN for c in found):
            found.append(_Candidate(int(old[a]), se2.between(state.poses[old[a]], newest), S[a]))
            if len(found) == _TRIED:
                break
    return found


def _looked(state: MapperState) -> MapperState:
    """Look for the newest keyframe in the places of its candidates."""
    way, j = ways(state.keyframes), len(state.keyframes) - 1
    candidates = _candidates(state)
    if not candidates:
        return state
    rows = neighbours(way, j, _BEHIND, 0.0)
    now = place_of(state.keyframes, rows, np.array([state.keyframes[q].odom for q in rows]))
    for c in candidates:

        def nearest(pose: np.ndarray, c: int = c.row) -> tuple[Place, np.ndarray]:
            near = [q for q in neighbours(way, c, _BETWEEN, _BETWEEN).tolist() if way[j] - way[q] > _ELSEWHERE]
            seen = se2.between(state.keyframes[c].odom, np.array([state.keyframes[q].odom for q in near]))
            best = int(np.argmin(np.hypot(seen[:, 0] - pose[0], seen[:, 1] - pose[1])))
            return _place(state, near[best]), seen[best]

        match = loop_closure.compared(_place(state, c.row), now, c.mean, c.covariance, nearest)
        if match is not None:
            state = _judged(replace(state, matches=(*state.matches, match)))
    return state


def _judged(state: MapperState) -> MapperState:
    """Take the newest match as a closure where its window holds no alias, or with others that agree with it."""
    new, match = len(state.matches) - 1, state.matches[-1]
    if match.gate:
        return state
    assert state.solved is not None
    way = ways(state.keyframes)
    if match.evidence.window < _SURE:
        state = replace(state, accepted=(*state.accepted, new))
        due = way[-1] - way[len(state.solved.poses) - 1] > _RECENT or match.evidence.chi2 > _NEWS
        return _solved(state) if due else state
    near = [a for a in range(new) if not state.matches[a].gate and _beside(way, state.matches[a], match)][-_OTHERS:]
    near.append(new)
    agree = np.zeros((len(near), len(near)), dtype=bool)
    for a in range(len(near)):
        for b in range(a):
            agree[a, b] = agree[b, a] = _agree(state, way, state.matches[near[a]], state.matches[near[b]])
    clique = largest_clique(agree, [len(near) - 1])
    closed = max((way[state.matches[a].j] for a in state.accepted), default=0.0)
    if len(clique) < (3 if way[-1] - closed > _LONG else 2):
        return state
    taken = tuple(sorted({*state.accepted, *(near[a] for a in clique)}))
    solved = _solved(replace(state, accepted=taken))
    return state if _is_looked_through(solved) else solved


def _beside(way: np.ndarray, a: Match, b: Match) -> bool:
    return bool(abs(way[a.j] - way[b.j]) < _NEIGHBOURS and abs(way[a.i] - way[b.i]) < _NEIGHBOURS)


def _agree(state: MapperState, way: np.ndarray, a: Match, b: Match) -> bool:
    """Whether two matches from different places agree, by the odometry between their ends."""
    if abs(way[a.j] - way[b.j]) < 0.9 * _EVERY[0] and abs(state.keyframes[a.j].odom[2] - state.keyframes[b.j].odom[2]) < 0.9 * _EVERY[1]:
        return False
    now, old = (odometry_between(state.keyframes, *ends) for ends in ((a.j, b.j), (b.i, a.i)))
    return cycle_chi2((a.pose, a.covariance), now, reversed_edge((b.pose, b.covariance)), old) < CHI2


def _is_looked_through(state: MapperState) -> bool:
    """Whether beams of the last keyframes pass through walls of other passes, as the map is now."""
    way = ways(state.keyframes)
    last = np.flatnonzero(way > way[-1] - _NEIGHBOURS)
    old = np.flatnonzero(way < way[-1] - _NEIGHBOURS - _ELSEWHERE)
    through = []
    for k in last[:: max(len(last) // _SAMPLES, 1)].tolist():
        near = np.hypot(*(state.poses[old, :2] - state.poses[k, :2]).T)
        if len(old) and near.min() < _REACH:
            place = _place(state, int(old[np.argmin(near)]))
            pose = se2.between(state.poses[place.middle], state.poses[k])
            through.append(loop_closure.seen_through(state.keyframes[k].features, place.local_map, pose))
    return bool(through) and float(np.mean(through)) > loop_closure.THROUGH
