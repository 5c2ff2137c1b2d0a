"""The mapper: scans and the localizer's path in, a pose graph with loop closures out, as they come."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.mapping import keyframes as kf
from longreach.mapping import loop_closure, solver
from longreach.mapping.consistency import Edge, chained, cycle_chi2, largest_clique, reversed_edge
from longreach.mapping.keyframes import Keyframe
from longreach.mapping.pose_graph import Edges, PoseGraph, adjoints, no_edges
from longreach.mapping.solver import Solved
from longreach.measurement import LaserScan
from longreach.odometry.scan_geometry import ScanGeometry, same_kind, scan_geometry

_EVERY = 1.0, math.radians(60.0)  # [m, rad] between keyframes that look for closures
_APART = 10.0  # [m] of path between the ends of a closure: nearer, the local map of odometry has seen it
_REACH = 3.0  # [m] between poses whose scans show the same surfaces
_TRIED = 3  # places a keyframe is compared with
_SEPARATE = 8.0  # [m] of path between these
_AROUND = 5.0  # [m] of path about a keyframe that its local map covers
_JOINED = 3.0  # [m] of path that is joined to one scan
_SURE = 0.5  # [m]: a window below this holds no second place that looks the same
_NEIGHBOURS = 20.0  # [m] of path between closures that confirm each other
_LONG = 100.0  # [m] of path without a closure, after which it takes three that agree
_CHI2 = 16.27  # 99.9 % of χ² with 3 degrees of freedom
_LEAST = 0.3  # agreement of a peak
_UNIQUE = 0.9  # a second peak above this part of the first makes a place ambiguous


class Closure(NamedTuple):
    """A place that was found again: keyframes i < j, T_i⁻¹ T_j (3,) with covariance, and what became of it."""

    i: int
    j: int
    pose: np.ndarray
    covariance: np.ndarray
    reason: str
    sure: bool
    figures: dict


@dataclass(frozen=True, eq=False)
class MapperState:
    """What a mapper knows: keyframes, closures with what became of them, and the graph as last solved."""

    T_base_laser: np.ndarray
    keyframes: tuple[Keyframe, ...] = ()
    poses: tuple[np.ndarray, ...] = ()
    closures: tuple[Closure, ...] = ()
    accepted: tuple[int, ...] = ()
    solved: Solved | None = None
    last_row: tuple | None = None
    way: float = 0.0
    sought: float = -math.inf
    sought_heading: float = 0.0
    geometry: ScanGeometry | None = None
    covariance_since: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    places: dict = field(default_factory=dict)


def init(T_base_laser) -> MapperState:
    return MapperState(T_base_laser)


def step(state: MapperState, scan: LaserScan, row) -> MapperState:
    stamp, pose, P = row
    last = state.keyframes[-1] if state.keyframes else None
    way = state.way
    if state.last_row is not None:
        moved = se2.between(state.last_row[1], pose)
        way += math.hypot(moved[0], moved[1])
    state = replace(state, last_row=row, way=way)
    if last is not None:
        moved = se2.between(last.odom, pose)
        if math.hypot(moved[0], moved[1]) < kf.DISTANCE and abs(moved[2]) < kf.TURNED:
            return state
    geometry = state.geometry
    if geometry is None or not same_kind(scan, geometry):
        geometry = scan_geometry(scan, state.T_base_laser, 5)
    features = loop_closure._matcher().features(scan, geometry, np.zeros(3), 0.0)
    if last is None:
        C, at = 1e-9 * np.eye(3), pose
    else:
        C = kf.motion_covariance((last.odom, state.places["P"]), (pose, P), way - last.way)
        at = se2.compose(state.poses[-1], moved)
    state.places["P"] = P
    k = Keyframe(stamp, pose, C, way, features)
    state = replace(state, keyframes=(*state.keyframes, k), poses=(*state.poses, at), geometry=geometry)
    if last is not None:
        A = se2.adjoint(se2.inverse(moved))
        state = replace(state, covariance_since=A @ state.covariance_since @ A.T + C)
    else:
        state = _solve(state)
    turned = abs(float(se2.between(np.array([0, 0, state.sought_heading]), np.array([0, 0, pose[2]]))[2]))
    if way - state.sought < _EVERY[0] and turned < _EVERY[1]:
        return state
    state = replace(state, sought=way, sought_heading=pose[2])
    return _looked(state)


def graph_of(state: MapperState) -> PoseGraph:
    K = state.keyframes
    n = len(K)
    od = np.array([k.odom for k in K])
    odometry = Edges(np.arange(n - 1), np.arange(1, n), se2.between(od[:-1], od[1:]), np.array([k.covariance for k in K[1:]]).reshape(-1, 3, 3))
    found = [state.closures[a] for a in state.accepted]
    closures = edges_of(found)
    return PoseGraph(np.array(state.poses), odometry, closures)


def edges_of(found: Sequence[Closure]) -> Edges:
    if not found:
        return no_edges()
    return Edges(np.array([c.i for c in found]), np.array([c.j for c in found]), np.array([c.pose for c in found]), np.array([c.covariance for c in found]))


def _solve(state: MapperState) -> MapperState:
    graph = graph_of(state)
    solved = solver.optimize(graph)
    if len(solved.closure_chi2) and np.max(solved.closure_chi2) > _CHI2:
        solved = solver.optimize_robust(graph)
    return replace(state, solved=solved, poses=tuple(solved.poses), covariance_since=np.zeros((3, 3)))


def odometry_between(state: MapperState, i: int, j: int) -> Edge:
    if i > j:
        return reversed_edge(odometry_between(state, j, i))
    K = state.keyframes
    if i == j:
        return np.zeros(3), np.zeros((3, 3))
    to = se2.between(np.array([k.odom for k in K[i + 1 : j + 1]]), np.broadcast_to(K[j].odom, (j - i, 3)))
    A = adjoints(se2.between(to, np.zeros((j - i, 3))))
    S = np.array([k.covariance for k in K[i + 1 : j + 1]])
    return se2.between(K[i].odom, K[j].odom), np.einsum("kab,kbc,kdc->ad", A, S, A)


def _candidates(state: MapperState):
    """Return old keyframes with the relative pose and covariance that the graph gives, nearest first."""
    j, K = len(state.keyframes) - 1, state.keyframes
    way = np.array([k.way for k in K])
    old = np.flatnonzero(way < way[j] - _APART)
    s = len(state.solved.poses) - 1
    old = old[old <= s]
    if len(old) == 0:
        return []
    poses = np.array(state.poses)
    S = solver.relative_covariances(state.solved, old, np.full(len(old), s))
    tail = se2.between(poses[s], poses[j])
    A = se2.adjoint(se2.inverse(tail))
    S = A @ S @ A.T + state.covariance_since
    back = se2.between(np.broadcast_to(poses[j], (len(old), 3)), poses[old])
    d = np.hypot(back[:, 0], back[:, 1])
    u = back[:, :2] / np.maximum(d, 1e-6)[:, None]
    sigma = np.sqrt(np.einsum("ka,kab,kb->k", u, S[:, :2, :2], u))
    can = d - loop_closure.WINDOW * sigma < _REACH
    cost = d**2 / (sigma**2 + 1.5**2) + back[:, 2] ** 2 / (S[:, 2, 2] + 1.0)
    out = []
    for a in np.argsort(cost):
        if can[a] and all(abs(way[old[a]] - way[c]) > _SEPARATE for c, _, _ in out):
            out.append((int(old[a]), se2.between(poses[old[a]], poses[j]), S[a]))
            if len(out) == _TRIED:
                break
    return out


def _span(state: MapperState, c: int, before: float, after: float) -> list[int]:
    way = [k.way for k in state.keyframes]
    low, high = c, c
    while low > 0 and way[c] - way[low - 1] <= before and c - low < 20:
        low -= 1
    while high < len(way) - 1 and way[high + 1] - way[c] <= after and high - c < 20:
        high += 1
    return list(range(low, high + 1))


def place_of(state: MapperState, c: int):
    if c not in state.places:
        i = [q for q in _span(state, c, _AROUND, _AROUND) if q != c] + [c]
        odom = np.array([state.keyframes[q].odom for q in i])
        state.places[c] = kf.local_map_of([state.keyframes[q] for q in i], se2.between(np.broadcast_to(state.keyframes[c].odom, odom.shape), odom))
    return state.places[c]


def _looked(state: MapperState) -> MapperState:
    """Look for closures of the newest keyframe."""
    j = len(state.keyframes) - 1
    candidates = _candidates(state)
    if not candidates:
        return state
    i = _span(state, j, _JOINED, 0.0)
    odom = np.array([state.keyframes[q].odom for q in i])
    query = kf.joined_scan([state.keyframes[q] for q in i], se2.between(np.broadcast_to(state.keyframes[j].odom, odom.shape), odom))
    points = loop_closure.sampled(query)
    for c, mean, S in candidates:
        closure = _compared(state, c, j, mean, S, query, points)
        if closure is not None:
            state = _judged(replace(state, closures=(*state.closures, closure)))
    return state


def _compared(state, c, j, mean, S, query, points):
    place = place_of(state, c)
    window = loop_closure.Window(place, points, mean, S)
    peak = window.best(_LEAST)
    if peak is None:
        return None
    free = 9.0 * np.diag(S)
    fit = loop_closure.fitted(query, place, peak.pose, free)
    along = fit.directions[0][:2] if len(fit.directions) else np.zeros(2)
    if len(fit.directions):
        along = along / max(np.hypot(*along), 1e-9)
        t = fit.pose[2]
        along = np.array([math.cos(t) * along[0] - math.sin(t) * along[1], math.sin(t) * along[0] + math.cos(t) * along[1]])
    half = loop_closure.WINDOW * math.sqrt(np.linalg.eigvalsh(S[:2, :2])[1])
    second = window.best(_UNIQUE * peak.agreement, 1.0, peak.pose, along) if half > 0.5 else None
    # re-centre
    near = [q for q in _span(state, c, 8.0, 8.0) if state.keyframes[j].way - state.keyframes[q].way > _APART]
    T = np.array([se2.between(state.keyframes[c].odom, state.keyframes[q].odom) for q in near])
    off = np.hypot(T[:, 0] - fit.pose[0], T[:, 1] - fit.pose[1])
    q = near[int(np.argmin(off))]
    if q != c:
        place = place_of(state, q)
        pose = se2.between(T[int(np.argmin(off))], fit.pose)
        fit = loop_closure.fitted(query, place, pose, free, np.array([0.2, 0.2, 0.05]))
        A = odometry_between(state, q, c)
        mean = se2.compose(A[0], mean)
    through = loop_closure.seen_through(query, place, fit.pose)
    overlap = fit.rows / query.count
    quality = fit.inlier_ratio / max(overlap, 1e-6)
    xi = se2.difference(mean, fit.pose)
    cov = 2.25 * fit.covariance + np.diag([0.005**2, 0.005**2, math.radians(0.1) ** 2])
    chi = float(xi @ np.linalg.solve(S + cov, xi))
    reason = ""
    if not math.isfinite(fit.scale) or fit.rows < 12:
        return None
    if overlap < 0.4:
        reason = "overlap"
    elif quality < 0.55:
        reason = "quality"
    elif through > 0.2:
        reason = "through"
    elif second is not None:
        reason = "ambiguous"
    elif chi > _CHI2:
        reason = "chi2"
    figures = dict(agreement=peak.agreement, second=second.agreement if second else 0.0, overlap=overlap, quality=quality, through=through, chi2=chi, half=half, blind=len(fit.directions), scale=fit.scale, first=c, S=S, mean=mean)
    return Closure(q, j, fit.pose, cov, reason, half < _SURE, figures)


def _judged(state: MapperState) -> MapperState:
    """Take the newest closure, if it is sure or others agree with it."""
    new = len(state.closures) - 1
    c = state.closures[new]
    if c.reason:
        return state
    way = [k.way for k in state.keyframes]
    if c.sure:
        return _solve(replace(state, accepted=(*state.accepted, new)))
    near = [
        a for a, o in enumerate(state.closures)
        if (not o.reason) and abs(way[o.j] - way[c.j]) < _NEIGHBOURS and abs(way[o.i] - way[c.i]) < _NEIGHBOURS
    ][-20:]
    n = len(near)
    agree = np.zeros((n, n), dtype=bool)
    for a in range(n):
        for b in range(a):
            p, q = state.closures[near[a]], state.closures[near[b]]
            chi = cycle_chi2((p.pose, p.covariance), odometry_between(state, p.j, q.j), reversed_edge((q.pose, q.covariance)), odometry_between(state, q.i, p.i))
            apart = abs(way[p.j] - way[q.j]) > 0.9
            agree[a, b] = agree[b, a] = chi < _CHI2 and apart
    clique = largest_clique(agree, [n - 1])
    last = max((way[state.closures[a].j] for a in state.accepted), default=0.0)
    need = 3 if way[c.j] - last > _LONG else 2
    if len(clique) < need:
        return state
    return _solve(replace(state, accepted=tuple(sorted({*state.accepted, *(near[a] for a in clique)}))))


def path_of(state: MapperState, rows) -> np.ndarray:
    """Return the pose (n, 3) on the map at each row of the localizer: corrections of the keyframes, interpolated."""
    K = state.keyframes
    stamps, odom = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
    ks, X = np.array([k.stamp for k in K]), np.array(state.poses)
    O = np.array([k.odom for k in K])
    a = np.clip(np.searchsorted(ks, stamps, side="right") - 1, 0, len(K) - 1)
    b = np.minimum(a + 1, len(K) - 1)
    f = np.where(b > a, (stamps - ks[a]) / np.where(b > a, ks[b] - ks[a], 1.0), 0.0)
    A = se2.compose(X[a], se2.between(O[a], odom))
    B = se2.compose(X[b], se2.between(O[b], odom))
    return se2.interpolate(A, B, np.clip(f, 0, 1))
