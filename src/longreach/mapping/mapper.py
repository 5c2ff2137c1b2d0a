"""The mapper: scans and the localizer's path in; keyframes, loop closures and a solved pose graph out, as they come.

    keyframe   ← scan, where the base has moved enough; its edge from the localizer's path
    candidates ← old keyframes within 3.5 σ of the relative pose that the graph gives     every metre
    match      ← joined scans of now in the place of each candidate                       `loop_closure`
    closure    ← a match in a window too small for an alias, or one that others agree with `consistency`
    poses      ← robust solution of the graph; closures that it contradicts are withdrawn  `solver`

A recording is a fold of `step`, after which `refined` matches every keyframe to each other pass by it.

On a map of before, nothing is known of where a session begins. It is searched on the whole map then, and joined with it
by matches that are unique there and agree with each other; from then on the graph knows, and all is as above.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.mapping import incremental, loop_closure
from longreach.mapping.consistency import cycle_chi2, largest_clique, reversed_edge
from longreach.mapping.keyframes import (
    BETWEEN_SESSIONS,
    DISTANCE,
    DRIFT,
    MATCHER,
    TURNED,
    Keyframe,
    Place,
    motion_covariance,
    neighbours,
    odometry_between,
    place_of,
    regions_of,
    ways,
)
from longreach.mapping.loop_closure import CHI2, Match
from longreach.mapping.pose_graph import Edges, PoseGraph, adjoints, innovation_chi2, no_edges
from longreach.measurement import LaserScan
from longreach.odometry.local_map import LocalMap
from longreach.odometry.matchers.scan_matcher import Features
from longreach.odometry.scan_geometry import ScanGeometry, same_kind, scan_geometry, share_of_a_beam

_SEEK = 2.0  # [m] of path between searches on a whole map
JOIN, JOIN_WAY = 3, 6.0  # matches that agree, over so much path [m], join a session with a map
_EVERY = 1.0, math.radians(60.0)  # between keyframes that look for closures [m, rad]
_ELSEWHERE = 10.0  # [m] of path between the ends of a closure: nearer, odometry's local map has them both
_REACH = 3.0  # [m] between poses whose scans show the same surfaces
_TRIED = 3  # candidates of a keyframe,
_BETWEEN = 8.0  # [m] of path between these
_AROUND, _BEHIND = 5.0, 3.0  # [m] of path about an old keyframe that make a place, and behind the newest
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

    graph: of the keyframes, None before the first. matches: all that were tried; accepted: which of them are closures,
    of which the first are in the graph and the others wait for it to be solved. waiting: scans whose row has not come.
    last: the row of the last scan; at_keyframe: of the newest keyframe. way [m]: driven so far. looked: way [m] and
    heading [rad] of the last search; sought [m]: the way at the last one on the whole map. first: keyframe of this
    session, after those of a map; regions: that map, to be searched.
    """

    T_base_laser: Float[np.ndarray, "4 4"]
    graph: incremental.State | None = None
    keyframes: tuple[Keyframe, ...] = ()
    matches: tuple[Match, ...] = ()
    accepted: tuple[int, ...] = ()
    waiting: tuple[LaserScan, ...] = ()
    last: PathRow | None = None
    at_keyframe: PathRow | None = None
    way: float = 0.0
    looked: tuple[float, float] = (-math.inf, 0.0)
    sought: float = -math.inf
    first: int = 0
    regions: tuple[LocalMap, ...] = ()
    geometry: ScanGeometry | None = None
    places: dict[int, Place] = field(default_factory=dict)  # a cache: what is in it follows from the keyframes

    @property
    def poses(self) -> Float[np.ndarray, "n 3"]:
        """Of the keyframes, on the map."""
        return np.zeros((0, 3)) if self.graph is None else self.graph.poses

    @property
    def T_map_odom(self) -> Float[np.ndarray, "3"]:
        """Where the frame odom is on the map now: identity before the first keyframe."""
        if not self.keyframes:
            return np.zeros(3)
        return se2.compose(self.poses[-1], se2.inverse(self.keyframes[-1].odom))

    @property
    def is_joined(self) -> bool:
        """Whether anything joins this session with the map that it began on; True without one."""
        if self.graph is None or self.first == 0:
            return True
        return len(self.keyframes) > self.first and incremental.is_joined(self.graph, 0, self.first)

    @property
    def withdrawn(self) -> tuple[int, ...]:
        """The accepted matches that the graph as last solved gives no weight."""
        weights = () if self.graph is None else self.graph.weights
        return tuple(a for a, weight in zip(self.accepted, weights, strict=False) if weight < 0.5)


def init(
    T_base_laser: Float[np.ndarray, "4 4"], keyframes: tuple[Keyframe, ...] = (), graph: PoseGraph | None = None
) -> MapperState:
    """Start before the first scan, or on a map: its keyframes, and its graph with all that is sure as odometry."""
    if graph is None:
        return MapperState(T_base_laser)
    return MapperState(
        T_base_laser,
        incremental.init(graph),
        keyframes,
        way=keyframes[-1].way + BETWEEN_SESSIONS,
        first=len(keyframes),
        regions=regions_of(keyframes, graph.poses, loop_closure.REGION),
    )


def step(state: MapperState, scans: Iterable[LaserScan], rows: Iterable[PathRow]) -> MapperState:
    """Take scans, and rows of the localizer's path in the order of their stamps; a scan waits for its row."""
    waiting = [*state.waiting, *scans]
    by_stamp = {scan.stamp: scan for scan in waiting}
    for stamp, pose, covariance in rows:
        if stamp in by_stamp:
            state = _taken(state, by_stamp[stamp], PathRow(stamp, pose, covariance))
    newest = -math.inf if state.last is None else state.last.stamp
    return replace(state, waiting=tuple(scan for scan in waiting if scan.stamp > newest))


def _taken(state: MapperState, scan: LaserScan, row: PathRow) -> MapperState:
    """Take a scan with its row: a keyframe where the base has moved enough, and a search where that is due."""
    twist, period, way, geometry = np.zeros(3), math.inf, state.way, state.geometry
    if geometry is None or not same_kind(scan, geometry):
        geometry = scan_geometry(scan, state.T_base_laser, 5)
    if state.last is not None:
        moved, period = se2.between(state.last.pose, row.pose), row.stamp - state.last.stamp
        way += math.hypot(moved[0], moved[1])
        twist = se2.log(moved) / period
    state = replace(state, last=row, way=way, geometry=geometry)
    if state.at_keyframe is not None:
        moved = se2.between(state.at_keyframe.pose, row.pose)
        if math.hypot(moved[0], moved[1]) < DISTANCE and abs(moved[2]) < TURNED:
            return state
    share = share_of_a_beam(scan, period) if math.isfinite(period) else 0.0
    twist = twist if share > 0.0 else np.zeros(3)
    motion = se2.adjoint(se2.inverse(geometry.pose_base_laser)) @ twist * (period if share > 0.0 else 0.0)
    state = _with_keyframe(state, row, scan, twist, MATCHER.features(scan, geometry, motion, share))
    turned = abs(math.remainder(row.pose[2] - state.looked[1], 2 * math.pi))
    if way - state.looked[0] < _EVERY[0] and turned < _EVERY[1]:
        return state
    return _looked(replace(state, looked=(way, float(row.pose[2]))), len(state.keyframes) - 1)


def _with_keyframe(
    state: MapperState, row: PathRow, scan: LaserScan, twist: np.ndarray, features: Features
) -> MapperState:
    before = state.at_keyframe
    if state.graph is None:
        first = PoseGraph(row.pose[None], no_edges(), no_edges())
        graph, covariances = incremental.init(first), (np.zeros((3, 3)), np.zeros((3, 3)))
    elif before is None:
        graph, covariances = incremental.begin(state.graph, row.pose), (np.zeros((3, 3)), np.zeros((3, 3)))
    else:
        covariances = motion_covariance(before[1:], row[1:], state.way - state.keyframes[-1].way)
        n, moved = len(state.keyframes), se2.between(before.pose, row.pose)
        edge = Edges(np.array([n - 1]), np.array([n]), moved[None], covariances[0][None])
        graph = incremental.step(state.graph, edge)
    keyframe = Keyframe(scan, row.pose, twist, *covariances, state.way, features)
    return replace(state, graph=graph, keyframes=(*state.keyframes, keyframe), at_keyframe=row)


def closure_edges(matches: Sequence[Match]) -> Edges:
    """Return matches as edges."""
    if not matches:
        return no_edges()
    return Edges(*(np.array([getattr(m, name) for m in matches]) for name in ("i", "j", "pose", "covariance")))


def _solved(state: MapperState) -> MapperState:
    """Add the accepted matches that wait to the graph, and solve it."""
    assert state.graph is not None
    new = state.accepted[len(state.graph.weights) :]
    edges = closure_edges([state.matches[a] for a in new])
    return replace(state, graph=incremental.step(state.graph, None, edges))


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


def _candidates(state: MapperState, j: int) -> list[_Candidate]:
    """Return old keyframes near which the base may have been at keyframe j, best known first, apart from each other."""
    assert state.graph is not None
    way, newest = ways(state.keyframes), state.poses[j]
    old = np.flatnonzero(way < way[j] - _ELSEWHERE)
    S = incremental.relative_covariances(state.graph, old, np.full(len(old), j))
    old, S = old[np.isfinite(S[:, 0, 0])], S[np.isfinite(S[:, 0, 0])]
    if len(old) == 0:
        return []
    near = np.hypot(*(state.poses[old, :2] - newest[:2]).T)
    back = se2.between(np.broadcast_to(newest, (len(old), 3)), state.poses[old])
    u = back[:, :2] / np.maximum(near, 1e-6)[:, None]
    variance = np.einsum("ka,kab,kb->k", u, S[:, :2, :2], u)
    in_reach = near - loop_closure.WINDOW * np.sqrt(variance) < _REACH
    cost = near**2 / (variance + (0.5 * _REACH) ** 2) + back[:, 2] ** 2 / (
        S[:, 2, 2] + 1.0
    )  # another heading shares less
    found: list[_Candidate] = []
    for a in np.argsort(cost).tolist():
        if in_reach[a] and all(abs(way[old[a]] - way[c.row]) > _BETWEEN for c in found):
            found.append(_Candidate(int(old[a]), se2.between(state.poses[old[a]], newest), S[a]))
            if len(found) == _TRIED:
                break
    return found


def _looked(state: MapperState, j: int) -> MapperState:
    """Look for keyframe j in the places of its candidates; in a session that is not joined, on the whole map, too."""
    way = ways(state.keyframes)
    rows = neighbours(way, j, _BEHIND, 0.0)
    now = place_of(state.keyframes, rows, np.array([state.keyframes[q].odom for q in rows]))
    if not state.is_joined and way[j] - state.sought >= _SEEK:
        state = _sought(replace(state, sought=float(way[j])), now)
    matches = list[Match]()
    for c in _candidates(state, j):
        nearest = partial(_nearest, state, j, c.row)
        match = loop_closure.compared(_place(state, c.row), now, c.mean, c.covariance, nearest)
        if match is not None:
            matches.append(match)
    for match in _only_one(state, matches):
        state = _judged(replace(state, matches=(*state.matches, match)))
    return state


def _only_one(state: MapperState, matches: list[Match]) -> list[Match]:
    """Return matches of one keyframe, refused where another one puts it elsewhere: places look the same."""
    passed = [m for m in matches if not m.gate]
    at = np.array([se2.compose(state.poses[m.i], m.pose) for m in passed]).reshape(-1, 3)
    spread = np.hypot(*(at[:, None, :2] - at[None, :, :2]).transpose(2, 0, 1)).max(initial=0.0)
    if spread < loop_closure.APART:
        return matches
    second = min(m.evidence.agreement for m in passed)
    return [
        m if m.gate else replace(m, gate="uniqueness", evidence=m.evidence._replace(second=second)) for m in matches
    ]


def _nearest(state: MapperState, j: int, c: int, pose: np.ndarray) -> tuple[Place, np.ndarray]:
    """Return the place of before keyframe j near row c that is nearest to a pose (3,) seen from there, and its pose."""
    way = ways(state.keyframes)
    near = [q for q in neighbours(way, c, _BETWEEN, _BETWEEN).tolist() if way[j] - way[q] > _ELSEWHERE]
    seen = se2.between(state.keyframes[c].odom, np.array([state.keyframes[q].odom for q in near]))
    best = int(np.argmin(np.hypot(seen[:, 0] - pose[0], seen[:, 1] - pose[1])))
    return _place(state, near[best]), seen[best]


def _judged(state: MapperState) -> MapperState:
    """Take the newest match as a closure where its window holds no alias, or with others that agree with it."""
    new, match = len(state.matches) - 1, state.matches[-1]
    if match.gate:
        return state
    assert state.graph is not None
    way, solved = ways(state.keyframes), len(state.graph.solved.poses)
    if match.evidence.window < _SURE:
        state = replace(state, accepted=(*state.accepted, new))
        due = way[-1] - way[solved - 1] > _RECENT or match.evidence.chi2 > _NEWS
        return _solved(state) if due else state
    near = [a for a in range(new) if not state.matches[a].gate and _beside(way, state.matches[a], match)][-_OTHERS:]
    near.append(new)
    agree = np.zeros((len(near), len(near)), dtype=bool)
    for a in range(len(near)):
        for b in range(a):
            agree[a, b] = agree[b, a] = _agree(state, way, state.matches[near[a]], state.matches[near[b]])
    clique = largest_clique(agree, [len(near) - 1])
    closed = max((way[state.matches[a].j] for a in state.accepted), default=0.0)
    ends = [way[state.matches[near[a]].j] for a in clique]
    if len(clique) < (3 if way[-1] - closed > _LONG else 2) or max(ends) - min(ends) < _apart(match):
        return state
    taken = [near[a] for a in clique if near[a] not in state.accepted]
    more = _solved(replace(state, accepted=(*state.accepted, *taken)))
    return state if _is_looked_through(more) else more


def _sought(state: MapperState, now: Place) -> MapperState:
    """Look for now on the whole map; where matches agree on where the session is, join it, and look back along it."""
    match = loop_closure.found_anywhere(state.regions, now, partial(_nearest_on_map, state))
    if match is None:
        return state
    state = replace(state, matches=(*state.matches, match))
    agreed = [] if match.gate else _agreed_on_map(state)
    if not agreed:
        return state
    assert state.graph is not None
    motion = se2.compose(se2.compose(state.poses[match.i], match.pose), se2.inverse(state.poses[match.j]))
    moved = replace(state, graph=incremental.moved(state.graph, state.first, motion))
    joined = _solved(replace(moved, accepted=(*state.accepted, *agreed)))
    if not joined.is_joined or _is_looked_through(joined):
        return state
    way, last, known = ways(state.keyframes), -math.inf, {state.matches[a].j for a in agreed}
    for j in range(state.first, match.j):
        if way[j] - last >= _EVERY[0] and j not in known:
            joined, last = _looked(joined, j), float(way[j])
    return _solved(joined)


def _nearest_on_map(state: MapperState, pose: np.ndarray) -> tuple[Place, np.ndarray]:
    """Return the place of the map that is nearest to a pose (3,) on it, and the pose of its middle."""
    off = se2.between(np.broadcast_to(pose, (state.first, 3)), state.poses[: state.first])
    c = int(np.argmin(np.hypot(off[:, 0], off[:, 1]) + np.abs(off[:, 2])))  # another heading shares less
    return _place(state, c), state.poses[c]


def _agreed_on_map(state: MapperState) -> list[int]:
    """Return the matches to the map, the newest one among them, that agree on where this session is; [] if too few.

    They are from several places, and more than those that say otherwise.
    """
    assert state.graph is not None
    graph, way, new = state.graph, ways(state.keyframes), len(state.matches) - 1
    here = way[state.matches[new].j] - _NEIGHBOURS
    near = [
        a for a, m in enumerate(state.matches) if not m.gate and m.i < state.first <= m.j and way[m.j] > here
    ]  # fmt: skip
    agree = np.zeros((len(near), len(near)), dtype=bool)
    for a, one in enumerate(near):
        for b, other in enumerate(near[:a]):
            p, q = state.matches[one], state.matches[other]
            ends = np.array([q.i]), np.array([p.i])
            S = incremental.relative_covariances(graph, *ends)[0] if q.i != p.i else np.zeros((3, 3))
            old = se2.between(state.poses[q.i], state.poses[p.i]), S
            now = odometry_between(state.keyframes, p.j, q.j)
            chi2 = cycle_chi2((p.pose, p.covariance), now, reversed_edge((q.pose, q.covariance)), old)
            agree[a, b] = agree[b, a] = chi2 < CHI2
    clique = [near[a] for a in largest_clique(agree, [len(near) - 1])]
    span = way[[state.matches[a].j for a in clique]]
    enough = len(clique) >= JOIN and 2 * len(clique) > len(near) and np.ptp(span) >= JOIN_WAY
    return clique if enough else []


def _apart(match: Match) -> float:
    """Return over how much path closures that confirm each other spread [m]: as far as the place may be off."""
    return min(match.evidence.window, 0.5 * _NEIGHBOURS)


def settled(state: MapperState) -> MapperState:
    """Solve at the end, and take the matches that waited where the graph now leaves no room for another place."""
    if state.graph is None:
        return state
    state = _solved(state)
    assert state.graph is not None
    waiting = [a for a, m in enumerate(state.matches) if m.gate in ("", "uniqueness") and a not in state.accepted]
    edges = closure_edges([state.matches[a] for a in waiting])
    S = incremental.relative_covariances(state.graph, edges.i, edges.j)
    known = np.isfinite(S[:, 0, 0])
    window = loop_closure.WINDOW * np.sqrt(np.linalg.eigvalsh(np.where(known[:, None, None], S, 0.0)[:, :2, :2])[:, -1])
    good = known & (innovation_chi2(state.poses, edges, S) < CHI2) & (window < _SURE)
    more = tuple(a for a, is_good in zip(waiting, good, strict=True) if is_good)
    return _solved(replace(state, accepted=(*state.accepted, *more))) if more else state


def _beside(way: np.ndarray, a: Match, b: Match) -> bool:
    return bool(abs(way[a.j] - way[b.j]) < _NEIGHBOURS and abs(way[a.i] - way[b.i]) < _NEIGHBOURS)


def _agree(state: MapperState, way: np.ndarray, a: Match, b: Match) -> bool:
    """Whether two matches from different places agree, by the odometry between their ends."""
    turned = math.remainder(state.keyframes[a.j].odom[2] - state.keyframes[b.j].odom[2], 2 * math.pi)
    if abs(way[a.j] - way[b.j]) < 0.9 * _EVERY[0] and abs(turned) < 0.9 * _EVERY[1]:
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
            through.append(loop_closure.looked_through(state.keyframes[k].features, place, pose))
    return bool(through) and float(np.mean(through)) > loop_closure.THROUGH


def on_map(
    keyframes: Sequence[Keyframe],
    poses: Float[np.ndarray, "n 3"],
    covariances: Float[np.ndarray, "n 3 3"],
    rows: Sequence[PathRow],
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3 3"]]:
    """Return the poses (k, 3) of rows of the localizer's path on the map, and the covariance of their ξ.

    How far a keyframe's pose (n, 3) is from odom goes over into that of the next one with time. The covariances
    (n, 3, 3) of the keyframes grow with the way until the next.
    """
    stamps, odom = np.array([row.stamp for row in rows]), np.array([row.pose for row in rows])
    at, before = np.array([k.stamp for k in keyframes]), np.array([k.odom for k in keyframes])
    a = np.clip(np.searchsorted(at, stamps, side="right") - 1, 0, len(at) - 1)
    b = np.minimum(a + 1, len(at) - 1)
    moved = se2.between(before[a], odom)
    part = np.clip((stamps - at[a]) / np.where(b > a, at[b] - at[a], 1.0), 0.0, 1.0)
    found = se2.interpolate(se2.compose(poses[a], moved), se2.compose(poses[b], se2.between(before[b], odom)), part)
    A = adjoints(se2.between(moved, np.zeros_like(moved)))
    since = np.hypot(moved[:, 0], moved[:, 1])[:, None, None] * np.diag(DRIFT)
    return found, A @ covariances[a] @ A.transpose(0, 2, 1) + since
