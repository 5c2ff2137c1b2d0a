"""The base's pose on a map that is known: scans and the localizer's path in, poses in the frame map out, as they come.

    predicted ← pose ∘ odometry's motion; P grows as that of odometry does, and no more     every scan
    fit       ← scan to the surfaces of the keyframes about the nearest one                 every 0.1 m or 0.5 s
    pose, b   ← Kalman's correction by the fit, where its χ² is within 99.9 %
    given out ← P and the covariance of the nearest keyframe, whose error no number of fits can show

Fits that are taken from about the same place share an error: that of the surfaces, of cells and of what has changed.
It is a state b of its own, on the map's axes, which is another one after some way (a first-order Gauss-Markov process
along it) and the same for as long as the base stands: so the covariance does not shrink with the number of fits.
How large b and odometry's drift are is learned from the innovations while the base moves.
The frame odom is not touched; T_map_odom moves by corrections alone.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.errors import MappingError
from longreach.estimation.planar.state import Correction
from longreach.geometry import se2
from longreach.mapping import lost
from longreach.mapping.keyframes import DRIFT, MATCHER, motion_covariance
from longreach.mapping.known_map import FAR, Evidence, KnownMap, features_of
from longreach.mapping.loop_closure import CHI2, NEAR, WINDOW, Window, sampled
from longreach.mapping.lost import UNTESTED, LostTest
from longreach.mapping.mapper import PathRow
from longreach.measurement import LaserScan
from longreach.odometry.matchers.scan_matcher import Features, Fit, Prior
from longreach.odometry.scan_geometry import ScanGeometry, same_kind, scan_geometry

SOURCE = "map"  # of the corrections
_EVERY = 0.1, math.radians(5.0), 0.5  # [m, rad, s] between fits
_SHARED = np.array([0.004, 0.004, math.radians(0.06)])  # [m, m, rad] deviations of b
_LASTING = 0.5, math.radians(20.0)  # [m, rad] of way and turn after which b is another: a keyframe further on
_LEAST = np.diag([0.001**2, 0.001**2, math.radians(0.02) ** 2])  # of a fit's own covariance
# The variances of b, drift and _LEAST are for a cluttered place; a scale of them is learned, so that the mean NIS is 3:
# by so much of its error a fit, within limits. The least is that of simulated rooms: 0.4 mm and 0.006°.
_LEARNED, _SCALES, _MOST = 0.05, (0.01, 4.0), 4.0
_COVERED, _FEWEST = 0.1, 20  # share of the beams that the map covers, and returns on its surfaces, at least
_SHOWN = 0.5  # share that it covers where a fit can say that the base is lost
_AGREES = 0.5  # share that it explains of those, at least
_LIMITS = (0.0, 10.83, 13.82, CHI2)  # 99.9 % of χ² by degrees of freedom
_WIDE = 0.3  # [m] of deviation from where on the window is searched, for a fit alone may end beside it
# So many fits in a row that the gate refuses agree with the one before, and the map explains their beams as usual, up
# to a factor of −ln(share): then it is the map that bends, by more than its covariance says, and the pose follows.
_BENT, _RARE = 3, 3.0
_NOTHING = 1e4  # variance along what the scan does not show: the odometry's pose there is no measurement
_FOUND = 0.3  # agreement of the best place in a window, at least


class MapRow(NamedTuple):
    """Pose (3,) and covariance (3, 3) of ξ in the frame map at a stamp [s].

    p: of the test whether the base is there (`lost`). lost: it is not, and this is odometry.
    """

    stamp: float
    pose: np.ndarray
    covariance: np.ndarray
    p: float = 1.0
    lost: bool = False


@dataclass(frozen=True, eq=False)
class MapLocalizerState:
    """What a localizer on a map knows after its last correction, or at the start.

    pose (3,) and shared (3,), the error b of fits, with P (6, 6) of (ξ, b). at: the path's row then, None before the
    first. way, turned: since then. last: the newest row. waiting: scans whose row has not come. refused: fits in a
    row; agreeing: of those with the one before, whose innovation is gated. scale: of the variances of b and drift, as
    learned from so many fits. test: whether the base is here.
    """

    known: KnownMap
    T_base_laser: Float[np.ndarray, "4 4"]
    pose: Float[np.ndarray, "3"]
    P: Float[np.ndarray, "6 6"]
    shared: Float[np.ndarray, "3"]
    at: PathRow | None = None
    last: PathRow | None = None
    way: float = 0.0
    turned: float = 0.0
    waiting: tuple[LaserScan, ...] = ()
    refused: int = 0
    scale: float = 1.0
    learned: int = 0
    geometry: ScanGeometry | None = None
    test: LostTest = UNTESTED
    agreeing: int = 0
    gated: Float[np.ndarray, "3"] = field(default_factory=lambda: np.full(3, np.nan))

    @property
    def T_map_odom(self) -> Float[np.ndarray, "3"]:
        """Where the frame odom is on the map; before the first row as if the base were at odom's origin."""
        return self.pose if self.at is None else se2.compose(self.pose, se2.inverse(self.at.pose))


def init(
    known: KnownMap,
    T_base_laser: Float[np.ndarray, "4 4"],
    pose: Float[np.ndarray, "3"],
    covariance: Float[np.ndarray, "3 3"],
) -> MapLocalizerState:
    """Start at a pose (3,) on the map with a covariance (3, 3) of its ξ, at the first scan to come.

    Raises:
        MappingError: the start, or its covariance, is none, or it is off the map by more than its uncertainty.
    """
    if not (np.isfinite(pose).all() and np.isfinite(covariance).all() and np.linalg.eigvalsh(covariance)[0] > 0.0):
        raise MappingError("A start on the map is a finite pose whose deviations are larger than 0.")
    distance = known.nearest(pose)[1]
    sigma = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[1]))
    if distance > FAR + WINDOW * sigma:
        low, high = known.poses[:, :2].min(axis=0), known.poses[:, :2].max(axis=0)
        raise MappingError(
            f"The start ({pose[0]:.1f}, {pose[1]:.1f}) m is {distance:.0f} m from the nearest place of the map, which "
            f"goes from ({low[0]:.1f}, {low[1]:.1f}) to ({high[0]:.1f}, {high[1]:.1f}) m; give a start on it."
        )
    P = np.zeros((6, 6))
    P[:3, :3], P[3:, 3:] = covariance, _shared(known, 1.0)
    return MapLocalizerState(known, T_base_laser, np.array(pose, dtype=float), P, np.zeros(3))


def step(
    state: MapLocalizerState, scans: Iterable[LaserScan], rows: Iterable[PathRow]
) -> tuple[MapLocalizerState, list[MapRow], list[Correction]]:
    """Take scans, and rows of the localizer's path in the order of their stamps; a scan is used when its row is there.

    Returns a row on the map for each row, and what became of each fit.
    """
    waiting = [*state.waiting, *scans]
    by_stamp = {scan.stamp: scan for scan in waiting}
    given: list[MapRow] = []
    corrections: list[Correction] = []
    for row in rows:
        row = PathRow(*row)
        state, twist = _moved(state, row)
        scan = by_stamp.get(row.stamp)
        if scan is not None and _is_due(state, row):
            state, correction = _corrected(state, row, scan, twist)
            corrections.append(correction)
        given.append(row_of(state, row))
    newest = -math.inf if state.last is None else state.last.stamp
    return replace(state, waiting=tuple(scan for scan in waiting if scan.stamp > newest)), given, corrections


def _moved(state: MapLocalizerState, row: PathRow) -> tuple[MapLocalizerState, np.ndarray]:
    """Count the way to a row; return also the twist (3,) since the last one."""
    if state.last is None:
        return replace(state, at=row, last=row, way=math.inf), np.zeros(3)
    moved = se2.between(state.last.pose, row.pose)
    way, turned = state.way + math.hypot(moved[0], moved[1]), state.turned + abs(float(moved[2]))
    return replace(state, last=row, way=way, turned=turned), se2.log(moved) / (row.stamp - state.last.stamp)


def _shared(known: KnownMap, scale: float) -> np.ndarray:
    """Return the covariance (3, 3) of b."""
    return scale * np.diag(_SHARED**2) + known.rough


def _is_due(state: MapLocalizerState, row: PathRow) -> bool:
    assert state.at is not None
    way, turn, time = _EVERY
    return state.way >= way or state.turned >= turn or row.stamp - state.at.stamp >= time


def _predicted(state: MapLocalizerState, row: PathRow) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return pose, b and P at a row: T_map_odom stays, and its covariance grows by what odometry's does."""
    assert state.at is not None
    moved, P = se2.between(state.at.pose, row.pose), np.array(state.P)
    if row.stamp == state.at.stamp:
        return state.pose, state.shared, P
    way = state.way if math.isfinite(state.way) else 0.0
    kept = math.exp(-way / _LASTING[0] - state.turned / _LASTING[1])
    F = np.zeros((6, 6))
    F[:3, :3], F[3:, 3:] = se2.adjoint(se2.inverse(moved)), kept * np.eye(3)
    P = F @ P @ F.T
    less = (1.0 - state.scale) * np.diag(DRIFT * max(way, 0.01))
    P[:3, :3] += motion_covariance(state.at[1:], row[1:], way)[0] - less
    P[3:, 3:] += (1.0 - kept**2) * _shared(state.known, state.scale)
    return se2.compose(state.pose, moved), kept * state.shared, P


def row_of(state: MapLocalizerState, row: PathRow) -> MapRow:
    """Return the pose on the map at a row of the path, with what the map itself may be off there."""
    pose, _, P = _predicted(state, row)
    k, _ = state.known.nearest(pose)
    A = se2.adjoint(se2.between(pose, state.known.poses[k]))
    covariance = P[:3, :3] + A @ state.known.covariances[k] @ A.T
    return MapRow(row.stamp, pose, 0.5 * (covariance + covariance.T), state.test.p)


def _corrected(
    state: MapLocalizerState, row: PathRow, scan: LaserScan, twist: np.ndarray
) -> tuple[MapLocalizerState, Correction]:
    """Fit a scan to the map about the predicted pose, gate, and correct; a fit that is refused changes nothing."""
    geometry = state.geometry
    if geometry is None or not same_kind(scan, geometry):
        geometry = scan_geometry(scan, state.T_base_laser, 5)
    pose, shared, P = _predicted(state, row)
    way, turn, _ = _EVERY
    moving = math.isfinite(state.way) and (state.way > 0.5 * way or state.turned > 0.5 * turn)
    state = replace(state, pose=pose, shared=shared, P=P, at=row, way=0.0, turned=0.0, geometry=geometry)
    k, distance = state.known.nearest(pose)
    said = Correction(scan.stamp, SOURCE, "refused")
    if distance > FAR:
        return replace(state, refused=state.refused + 1), said._replace(
            reason=f"the nearest place of the map is {distance:.0f} m away"
        )
    fit, evidence, reason = fitted(state.known, k, features_of(scan, geometry, twist), pose, P[:3, :3])
    if reason:
        test = _tested(state.test, evidence, CHI2, moving, False)
        return replace(state, refused=state.refused + 1, test=test), said._replace(reason=reason)
    assert fit is not None
    assert evidence is not None
    H, r = _observation(pose, shared, fit)
    blind, dof = fit.directions, 3 - len(fit.directions)
    R = fit.covariance + state.scale * _LEAST + _NOTHING * blind.T @ blind
    S = H @ P @ H.T + R
    nis = float(r @ np.linalg.solve(S, r))
    usual = -math.log(evidence.share) < _RARE * state.test.usual[0][0]
    agreeing = state.agreeing + 1 if usual and _agree(r, state.gated, R, _LIMITS[dof]) else 0
    bent = nis >= _LIMITS[dof] and agreeing >= _BENT
    if bent:
        P[:3, :3] += np.outer(r, r)
        S = H @ P @ H.T + R
    taken = bent or nis < _LIMITS[dof]
    test = _tested(state.test, evidence, 3.0 * nis / max(dof, 1), moving, taken)
    state = replace(state, test=test, agreeing=0 if taken else agreeing, gated=r)
    if moving and dof:
        part = max(_LEARNED, 1.0 / (2.0 + state.learned))
        scale = state.scale * math.exp(part * (min(nis / dof, _MOST) - 1.0))
        state = replace(state, scale=min(max(scale, _SCALES[0]), _SCALES[1]), learned=state.learned + 1)
    said = said._replace(innovation=r, nis=nis, dof=dof)
    if not taken:
        reason = f"NIS {nis:.1f} is above the gate {_LIMITS[dof]:.1f}"
        return replace(state, refused=state.refused + 1), said._replace(status="gated", reason=reason)
    K = np.linalg.solve(S, H @ P).T
    d, left = K @ r, np.eye(6) - K @ H
    P = left @ P @ left.T + K @ R @ K.T
    reason = f"taken after {state.refused} fits in a row that were not" if state.refused else ""
    reason += ", all of which agreed with it: the map bends" if bent else ""
    state = replace(state, pose=se2.retract(pose, d[:3]), shared=shared + d[3:], P=0.5 * (P + P.T), refused=0)
    return state, said._replace(status="used", reason=reason)


def _tested(test: LostTest, evidence: Evidence | None, nis: float, moving: bool, taken: bool) -> LostTest:
    """Take a fit into the test whether the base is lost, but where the map ends: it leaves too much open there."""
    if evidence is None or evidence.covered < _SHOWN:
        return test
    return lost.step(test, evidence.share, nis, moving, taken)


def _agree(r: np.ndarray, before: np.ndarray, R: np.ndarray, limit: float) -> bool:
    """Whether the innovations of two fits after each other, each with a covariance R, are the same."""
    return bool((r - before) @ np.linalg.solve(2.0 * R, r - before) < limit)


def _observation(pose: np.ndarray, shared: np.ndarray, fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return H (3, 6) and the innovation (3,): a fit shows ξ and b, turned into the base's frame."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.hstack([np.eye(3), R]), se2.difference(pose, fit.pose) - R @ shared


def fitted(
    known: KnownMap, k: int, scan: Features, pose: Float[np.ndarray, "3"], covariance: Float[np.ndarray, "3 3"]
) -> tuple[Fit | None, Evidence | None, str]:
    """Fit a scan to the map about keyframe k, where the base is expected at a pose (3,) with a covariance (3, 3) of ξ.

    The fit's pose is on the map. Returns also what the beams say there, None where they say next to nothing, and why
    the fit is none, or "".
    """
    reference, at = known.reference(k), se2.between(known.poses[k], pose)
    if math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[1])) > _WIDE:
        peak = Window(reference, sampled(scan), at, covariance).best(_FOUND)
        if peak is None:
            return None, None, "nothing of the scan agrees with the map where the base is expected"
        at = peak.pose
    free = WINDOW**2 * np.diag(covariance)
    fit = MATCHER.fit(scan, reference, Prior(at, NEAR, free, free), at)
    if fit.rows == 0 or not math.isfinite(fit.scale) or not np.isfinite(fit.pose).all():
        return None, None, "no return of the scan is near a surface of the map"
    on_map = se2.compose(known.poses[k], fit.pose)
    evidence = known.evidence(k, scan, on_map)
    if evidence.covered < _COVERED:
        return (
            None,
            None,
            f"the map covers {100 * evidence.covered:.0f} % of the beams; {100 * _COVERED:.0f} % are asked for",
        )
    if evidence.share < _AGREES:
        reason = f"the map explains {100 * evidence.share:.0f} % of the beams that it covers; {100 * _AGREES:.0f} %"
        return None, evidence, f"{reason} are asked for"
    if fit.rows < _FEWEST:
        return None, evidence, f"{fit.rows} returns see a surface of the map; {_FEWEST} are asked for"
    changed = fit.rows / max(fit.inlier_ratio * scan.count, 1.0)  # what has changed pulls at the fit
    return replace(fit, pose=on_map, covariance=changed * fit.covariance), evidence, ""
