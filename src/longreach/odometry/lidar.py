"""LIDAR odometry: each scan against a reference that earlier scans have made, under a prior from the wheels.

`step` is one scan: predict, carry its points to where the sweep began, match, and perhaps make it a keyframe. How it
is matched is a `ScanMatcher`'s; the default is `PointToLine`, to a local map.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.measurement import LaserScan, RelativePoseMeasurement
from longreach.odometry.lidar_config import LidarConfig
from longreach.odometry.matchers.point_to_line import PointToLine
from longreach.odometry.matchers.range_flow import RangeFlow, RangeFlowConfig
from longreach.odometry.matchers.scan_matcher import Features, Fit, Prior, ScanMatcher
from longreach.odometry.matchers.symmetric_flow import SymmetricFlow
from longreach.odometry.scan_geometry import (
    FEWEST_BEAMS,
    ScanGeometry,
    check_mount,
    same_kind,
    scan_geometry,
    share_of_a_beam,
)
from longreach.odometry.scan_match import ScanMatch

__all__ = ["LidarConfig", "LidarState", "init", "lidar_odometry", "step"]

_LASTING = 0.07  # [s] over which the mean of the motions forgets; two or three scans of a fast scanner
_LAG = 0.3  # [s] that wheels may be behind a scan: a period of a slow logger, and then some
_POOR = 0.5  # share of the returns that agree, below which the last motion is tried as a prior, too
_RECENT = 0.5  # [s] over which the last motion predicts the next, at most
_FASTEST = (3.0, 3.0)  # [m/s, rad/s] that no indoor base exceeds
_LOST = 2  # scans in a row without a match, the last of which starts a reference anew
_FEWEST = 12  # returns of a scan that can start one


@dataclass(frozen=True, eq=False)
class LidarState:
    """What LIDAR odometry remembers.

    reference: what scans are matched against, None before the first. stamp: of the last scan [s].
    keyframe: stamp of the newest keyframe [s]; keyframe_pose (3,): where it is in the reference; keyframe_noise (3, 3):
    the error of its own match, which all poses relative to it share; None: it began the reference.
    pose (3,): of the base at the last scan, in the reference; variance (3,): that has added up since the last match.
    motion (2, 3): the base's twist from scan to scan, the last and the mean; predicted (3,): the mean of the priors'.
    observed: when a scan last showed all directions, or the first one was taken [s].
    lost: scans without a match since the last one. geometries: of the kinds of scans seen so far.
    """

    config: LidarConfig
    matcher: ScanMatcher
    T_base_laser: Float[np.ndarray, "4 4"]
    reference: Any = None
    stamp: float = -math.inf
    keyframe: float = -math.inf
    keyframe_pose: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    keyframe_noise: Float[np.ndarray, "3 3"] | None = None
    pose: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    variance: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    motion: Float[np.ndarray, "2 3"] = field(default_factory=lambda: np.zeros((2, 3)))
    predicted: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    observed: float = math.inf
    lost: int = 0
    geometries: tuple[ScanGeometry, ...] = ()


def matcher_of(config: LidarConfig) -> ScanMatcher:
    """Return the matcher that the settings name."""
    if config.method == "point-to-line":
        return PointToLine(config.fit, config.distance, config.turned, config.overlap)
    if config.method == "range-flow":
        return RangeFlow(RangeFlowConfig())
    return SymmetricFlow(with_last=config.method == "three-scan-flow")


def init(config: LidarConfig, T_base_laser: Float[np.ndarray, "4 4"]) -> LidarState:
    """Start before any scan, with a laser mounted at T_base_laser.

    Raises:
        EstimationError: the laser's plane is tilted by more than 15° against the floor.
    """
    check_mount(T_base_laser)
    return LidarState(config, matcher_of(config), T_base_laser)


def step(
    state: LidarState, scan: LaserScan, prior: Float[np.ndarray, "3"] | None = None
) -> tuple[LidarState, ScanMatch]:
    """Match a scan against the reference.

    prior: predicted pose (3,) of the base at this scan seen from the base at the last one; None: it moves on as it did.
    """
    if len(scan.ranges) < FEWEST_BEAMS:
        reason = f"the scan has {len(scan.ranges)} beams, where at least {FEWEST_BEAMS} are needed"
        return state, ScanMatch(scan.stamp, None, reason, 0)
    if prior is not None and not np.isfinite(prior).all():
        prior = None
    period = scan.stamp - state.stamp if math.isfinite(state.stamp) else math.inf
    state, geometry = _geometry(state, scan)
    features = _features(state, scan, geometry, prior, period)
    if state.reference is None:
        state, enough = replace(state, stamp=scan.stamp, observed=scan.stamp), features.count >= _FEWEST
        reason = "the scan is the first" if enough else f"only {features.count} beams see something"
        match = ScanMatch(scan.stamp, None, reason, 0, keyframe=enough)
        return (_restarted(state, features, geometry) if enough else state), match
    going_on = np.zeros(3) if _is_too_fast(state.motion[0], period) else state.motion[0]  # after a gap
    twist = going_on if prior is None else se2.log(prior)
    before = state.predicted
    if prior is not None:
        state = replace(state, predicted=_mean(before, twist, period))
    moved = se2.exp(twist)
    expected = _prior(state, moved, scan.stamp, period if prior is None else min(period, _LAG), prior is not None)
    fit = state.matcher.match(features, state.reference, geometry, expected)
    poor = isinstance(fit, str) or fit.inlier_ratio < _POOR
    if prior is not None and period < _RECENT and poor:  # wheels may have jumped
        goes_on = _prior(state, se2.exp(going_on), scan.stamp, period, False)
        other = state.matcher.match(features, state.reference, geometry, goes_on)
        if not isinstance(other, str) and (isinstance(fit, str) or other.inlier_ratio > fit.inlier_ratio):
            fit = other
    if not isinstance(fit, str) and _is_too_fast(se2.between(state.pose, fit.pose), period):
        fit = "it would have moved the base faster than a base moves"
    if isinstance(fit, str):
        if prior is not None:  # it alone shows how the motion goes on
            state = replace(state, motion=np.array([twist, state.motion[1] + state.predicted - before]))
        return _failed(state, scan, features, geometry, expected, fit, prior is not None)
    return _matched(state, scan, features, geometry, fit)


def _is_too_fast(moved: np.ndarray, period: float) -> bool:
    """Whether a motion (3,) in a period [s] is beyond what any indoor base does; stamps may be off by a period."""
    most = max(2.0 * period, _LAG)
    return bool(math.hypot(moved[0], moved[1]) > _FASTEST[0] * most or abs(moved[2]) > _FASTEST[1] * most)


def _geometry(state: LidarState, scan: LaserScan) -> tuple[LidarState, ScanGeometry]:
    """Return the tables for this kind of scan, made where it is a new one."""
    for known in state.geometries:
        if same_kind(scan, known):
            return state, known
    geometry = scan_geometry(scan, state.T_base_laser, 5)
    return replace(state, geometries=(*state.geometries, geometry)[-4:]), geometry


def _features(
    state: LidarState, scan: LaserScan, geometry: ScanGeometry, prior: np.ndarray | None, period: float
) -> Features:
    """Return the features of a scan, carried to where the sweep began by the mean of the last motions.

    A prior shows how that changes; what it says itself does worse, for wheels have errors of their own.
    """
    share, motion = share_of_a_beam(scan, period) if math.isfinite(period) else 0.0, np.zeros(3)
    if share > 0.0:
        motion = state.motion[1]
        if prior is not None:
            motion = motion + _mean(state.predicted, se2.log(prior), period) - state.predicted
        motion = se2.adjoint(se2.inverse(geometry.pose_base_laser)) @ motion
    return state.matcher.features(scan, geometry, motion, share)


def _mean(mean: np.ndarray, last: np.ndarray, period: float) -> np.ndarray:
    """Return the running mean (3,) of motions with one more of them, that took a period [s]."""
    return mean + -math.expm1(-period / _LASTING) * (last - mean)


def _prior(state: LidarState, moved: np.ndarray, stamp: float, unknown: float, by_wheels: bool) -> Prior:
    """Predict the base's pose in the reference, wide: it says where to look, and not what to find.

    unknown [s]: for how long the base may have accelerated without the prediction knowing of it. by_wheels: whether it
    is the wheels', which are off by a part of the way since the keyframe where scans do not show it.

    What has not been observed for a while is off by ever more of the same, not at random: its deviation grows with
    time, from keyframe to keyframe, so that the variance of this match is what is left of that since the keyframe.
    """
    config = state.config
    far, turned = math.hypot(moved[0], moved[1]), abs(float(moved[2]))
    linear, angular = (a * min(unknown, 1.0) ** 2 for a in config.prior_acceleration)
    at = config.prior_position + config.prior_motion * far + linear
    to = config.prior_heading + config.prior_motion * turned + 0.1 * far + angular
    sigma = np.sqrt(state.variance + np.array([at * at, at * at, to * to]))
    observed = min(state.observed, state.keyframe)
    growth = (stamp - observed) ** 2 - (state.keyframe - observed) ** 2
    free = np.array([config.speed, config.speed, config.turn]) ** 2 * growth
    pose, astray = se2.compose(state.pose, moved), free
    if by_wheels:
        away = se2.between(state.keyframe_pose, pose)
        far, turned = math.hypot(away[0], away[1]), abs(float(away[2]))
        at, to = config.prior_position + config.prior_motion * far, config.prior_heading + config.prior_motion * turned
        astray = np.minimum(free, np.array([at * at, at * at, to * to]))
    return Prior(pose, sigma, free, astray)


def _restarted(state: LidarState, features: Features, geometry: ScanGeometry) -> LidarState:
    """Return the state with a new reference, of which this scan is the only keyframe."""
    reference, pose = state.matcher.extended(None, features, geometry, None)
    return replace(
        state,
        reference=reference,
        keyframe=state.stamp,
        keyframe_pose=pose,
        keyframe_noise=None,
        pose=pose,
        variance=np.zeros(3),
        lost=0,
    )


def _failed(
    state: LidarState,
    scan: LaserScan,
    features: Features,
    geometry: ScanGeometry,
    prior: Prior,
    reason: str,
    predicted: bool,
) -> tuple[LidarState, ScanMatch]:
    """Go on with the prior; after some scans in a row that see enough, start anew where the base is thought to be."""
    state = replace(state, stamp=scan.stamp, pose=prior.pose, variance=prior.sigma**2)
    if features.count < _FEWEST:
        return state, ScanMatch(scan.stamp, None, reason, 0)
    if state.lost + 1 < _LOST:
        return replace(state, lost=state.lost + 1), ScanMatch(scan.stamp, None, reason, 0)
    motion = state.motion if predicted else np.zeros((2, 3))
    state = replace(_restarted(state, features, geometry), motion=motion)
    return state, ScanMatch(scan.stamp, None, reason, 0, keyframe=True)


def _matched(
    state: LidarState, scan: LaserScan, features: Features, geometry: ScanGeometry, fit: Fit
) -> tuple[LidarState, ScanMatch]:
    """Tell where the base is relative to the newest keyframe, and make the scan one where it is far from all."""
    config = state.config
    moved, pose = se2.between(state.pose, fit.pose), se2.between(state.keyframe_pose, fit.pose)
    A, shared = se2.adjoint(se2.inverse(pose)), fit.shared
    if state.keyframe_noise is not None:  # which has the map's own error in it
        shared = A @ state.keyframe_noise @ A.T
    measurement = RelativePoseMeasurement(
        state.keyframe, scan.stamp, pose, fit.covariance - fit.shared + shared, "lidar", shared_covariance=shared
    )
    blind = len(fit.directions) > 0
    is_keyframe = state.matcher.is_far(fit, features, geometry, state.reference) or (
        blind and config.speed * (scan.stamp - state.keyframe) > 2.0 * config.distance
    )
    last = se2.log(moved)
    motion = np.array([last, _mean(state.motion[1], last, scan.stamp - state.stamp)])
    match = ScanMatch(scan.stamp, measurement, "", fit.rows, fit.directions, is_keyframe, moved)
    state = replace(
        state,
        stamp=scan.stamp,
        pose=fit.pose,
        variance=np.zeros(3),
        motion=motion,
        observed=state.observed if blind else scan.stamp,
        lost=0,
    )
    if not is_keyframe:
        return replace(state, reference=state.matcher.followed(state.reference, features, fit)), match
    reference, pose = state.matcher.extended(state.reference, features, geometry, fit)
    noise = _noise_in_map(fit) if np.array_equal(pose, fit.pose) else None
    state = replace(
        state,
        reference=reference,
        keyframe=scan.stamp,
        keyframe_pose=pose,
        keyframe_noise=noise,
        pose=pose,
    )
    return state, replace(match, keyframe_noise=noise)


def _noise_in_map(fit: Fit) -> np.ndarray:
    """Return the error (3, 3) with which a scan enters a map, but for directions that it does not show.

    There its pose is the prior's, and so are those of later scans, which go on from it. A reference that begins anew
    with a scan has none of this error.
    """
    seen = np.eye(3) - np.linalg.pinv(fit.directions) @ fit.directions
    return seen @ fit.covariance @ seen


def lidar_odometry(
    scans: Iterable[LaserScan],
    T_base_laser: Float[np.ndarray, "4 4"],
    config: LidarConfig | None = None,
    show_progress: Callable[[int], None] | None = None,
    priors: Sequence[Float[np.ndarray, "3"] | None] | None = None,
) -> tuple[ScanMatch, ...]:
    """Match each scan against the reference; the first scan has no entry.

    show_progress is called now and then with the number of scans done. priors: of each scan, as `step` takes it.
    """
    state = init(config or LidarConfig(), T_base_laser)
    matches = []
    for i, scan in enumerate(scans):
        state, match = step(state, scan, None if priors is None else priors[i])
        if i > 0:
            matches.append(match)
        if show_progress and i % 200 == 0:
            show_progress(i)
    return tuple(matches)
