"""LIDAR odometry: each scan against a reference that earlier scans have made, under a prior from the wheels.

`step` is one scan: predict, carry its points to where the sweep began, match, and perhaps make it a keyframe. How it
is matched is a `ScanMatcher`'s; the default is `PointToLine`, to a local map.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.geometry import se2
from longreach.measurement import LaserScan, RelativePoseMeasurement
from longreach.odometry import _lidar_kernels
from longreach.odometry._lidar_kernels import PriorSettings
from longreach.odometry.matchers._point_to_line_kernels import FitSettings
from longreach.odometry.matchers.point_to_line import PointToLine
from longreach.odometry.matchers.range_flow import RangeFlow, RangeFlowConfig
from longreach.odometry.matchers.scan_matcher import Features, Fit, Prior, ScanMatch, ScanMatcher
from longreach.odometry.matchers.symmetric_flow import SymmetricFlow
from longreach.odometry.scan_geometry import (
    FEWEST_BEAMS,
    ScanGeometry,
    check_mount,
    same_kind,
    scan_geometry,
    share_of_a_beam,
)

__all__ = ["LidarConfig", "LidarState", "Method", "ScanMatch", "init", "lidar_odometry", "step"]

_LASTING = 0.07  # [s] over which the mean of the motions forgets; two or three scans of a fast scanner
_LAGGING = 0.2  # [s] over which it is learned how far twists lag behind in sweeps: two of a slow scanner
_LAG = 0.3  # [s] that wheels may be behind a scan: a period of a slow logger, and then some
_POOR = 0.5  # share of the returns that agree, below which the last motion is tried as a prior, too
_RECENT = 0.5  # [s] over which the last motion predicts the next, at most
_GAP = 1.0  # [s] from which on the motion since the last scan is not that from scan to scan
_FASTEST = (3.0, 3.0)  # [m/s, rad/s] that no indoor base exceeds
_HELD = 1.0  # [s] for which motions stay relative to a keyframe that is better than newer ones, at most
_LOST = 2  # scans in a row without a match, the last of which starts a reference anew
_FEWEST = 12  # returns of a scan that can start one
_NONE, _UNKNOWN = np.zeros(3), np.full((3, 3), np.nan)  # variance of a pose that is known; noise of one that is not

Method = Literal["point-to-line", "keyscan-flow", "three-scan-flow", "range-flow"]


class LidarConfig(BaseModel):
    """Parameters of LIDAR odometry; the defaults serve 180 to 1081 beams at 5 to 40 Hz."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: Method = Field(default="point-to-line", description="How scans are matched: see docs/estimation.md.")
    iterations: int = Field(default=20, ge=1, le=100, description="Linearisations a match at most [1].")
    gate: float = Field(default=5.0, gt=1, description="Residuals beyond this many deviations take no part [1].")
    grazing: float = Field(default=0.2, gt=0, description="Of the noise, across a wall that is along the beam [1].")
    worst: float = Field(default=4.0, gt=0, description="Scatter of the residuals at most, in noises of a range [1].")
    flat: float = Field(default=0.01, gt=0, description="Scatter of the residuals at least: no map is better [m].")
    prior_position: float = Field(default=0.01, gt=0, description="Least deviation of the predicted position [m].")
    prior_heading: float = Field(default=0.01, gt=0, description="The same of the heading [rad].")
    prior_motion: float = Field(default=0.2, gt=0, description="Deviation over the predicted motion: wheels slip [1].")
    prior_acceleration: tuple[float, float] = Field(default=(1.0, 2.0), description="Unknown ones [m/s², rad/s²].")
    known: float = Field(default=3.0, ge=1, description="Information over that from errors of directions [1]; ours.")
    chance: float = Field(default=0.075, ge=0, description="Part of a direction's returns that agrees by chance [1].")
    common: float = Field(default=0.02, ge=0, description="Of the ranges' noise, the part common to all beams [1].")
    surface: float = Field(default=0.0, ge=0, description="The part common to beams that see one surface [1].")
    coarse: float = Field(default=0.4, gt=0, description="Radius of a surface in the first fit [m].")
    fine: float = Field(default=0.18, gt=0, description="Radius of a surface in the last fit [m].")
    distance: float = Field(default=0.25, gt=0, description="From the nearest keyframe to a new one [m]; ours.")
    turned: float = Field(default=1 / 18, gt=0, description="The same, in fields of view turned by [1]; ours.")
    overlap: float = Field(default=0.6, gt=0, lt=1, description="Beams that the map explains at least [1]; ours.")
    speed: float = Field(default=1.0, gt=0, description="What a base may drive where scans do not tell [m/s].")
    turn: float = Field(default=1.0, gt=0, description="What a base may turn where scans do not tell [rad/s].")

    @cached_property
    def fit(self) -> FitSettings:
        """The settings of a fit, as the kernels take them."""
        return FitSettings(*(getattr(self, name) for name in FitSettings._fields))

    @cached_property
    def prior(self) -> PriorSettings:
        """The settings of a prior, as the kernels take them."""
        deviations = self.prior_position, self.prior_heading, self.prior_motion
        return PriorSettings(*deviations, *self.prior_acceleration, self.speed, self.turn)


class Sweep(NamedTuple):
    """How the last scan was undistorted: the part of a period that it took, and the twist (3,) in a period.

    lag (3,): by how much such twists have been behind of late; square (3,): the mean square of what is left of that.
    """

    part: float
    motion: Float[np.ndarray, "3"]
    lag: Float[np.ndarray, "3"]
    square: Float[np.ndarray, "3"]


class LidarState(NamedTuple):
    """What LIDAR odometry remembers.

    reference: what scans are matched against, None before the first. stamp: of the last scan [s].
    keyframe: stamp of the newest keyframe [s]; keyframe_pose (3,): where it is in the reference; keyframe_noise (3, 3):
    the error of its own match, which all poses relative to it share; None: it began the reference.
    pose (3,): of the base at the last scan, in the reference; variance (3,): that has added up since the last match.
    motion (2, 3): the base's twist from scan to scan, the last and the mean; predicted (3,): the mean of the priors'.
    sweep: of the last scan. observed: when a scan last showed all directions, or the first one was taken [s].
    lost: scans without a match since the last one. geometries: of the kinds of scans seen so far.
    """

    config: LidarConfig
    matcher: ScanMatcher
    T_base_laser: Float[np.ndarray, "4 4"]
    keyframe_pose: Float[np.ndarray, "3"]
    pose: Float[np.ndarray, "3"]
    variance: Float[np.ndarray, "3"]
    motion: Float[np.ndarray, "2 3"]
    predicted: Float[np.ndarray, "3"]
    reference: Any = None
    stamp: float = -math.inf
    keyframe: float = -math.inf
    keyframe_noise: Float[np.ndarray, "3 3"] | None = None
    sweep: Sweep = Sweep(0.0, _NONE, _NONE, _NONE)
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
    """Start before any scan; raise EstimationError where the laser's plane is tilted by more than 15°."""
    check_mount(T_base_laser)
    none = np.zeros(3)
    return LidarState(config, matcher_of(config), T_base_laser, none, none, none, np.zeros((2, 3)), none)


def step(state: LidarState, scan: LaserScan, prior: np.ndarray | None = None) -> tuple[LidarState, ScanMatch]:
    """Match a scan against the reference.

    prior: predicted pose (3,) of the base at this scan seen from the base at the last one; None: it moves on as it did.
    """
    if len(scan.ranges) < FEWEST_BEAMS:
        reason = f"the scan has {len(scan.ranges)} beams, where at least {FEWEST_BEAMS} are needed"
        return state, ScanMatch(scan.stamp, None, reason, 0)
    if prior is not None and not all(map(math.isfinite, prior)):
        prior = None
    period = scan.stamp - state.stamp if math.isfinite(state.stamp) else math.inf
    state, geometry = _geometry(state, scan)
    before_sweep, (features, sweep) = state.sweep, _features(state, scan, geometry, prior, period)
    state = state._replace(sweep=sweep)
    if state.reference is None:
        state, enough = state._replace(stamp=scan.stamp, observed=scan.stamp), features.count >= _FEWEST
        reason = "the scan is the first" if enough else f"only {features.count} beams see something"
        match = ScanMatch(scan.stamp, None, reason, 0, keyframe=enough)
        return (_restarted(state, features) if enough else state), match
    going_on = np.zeros(3) if _is_too_fast(state.motion[0], period) else state.motion[0]  # after a gap
    twist = going_on if prior is None else se2.log(prior)
    before = state.predicted
    if prior is not None and not _bends(scan, period):
        state = state._replace(predicted=_mean(before, twist, period) if state.motion.any() else twist)
    expected = _prior(state, twist, scan.stamp, period if prior is None else min(period, _LAG), prior is not None)
    fit = state.matcher.match(features, state.reference, geometry, expected)
    poor = isinstance(fit, str) or fit.inlier_ratio < _POOR
    if prior is not None and period < _RECENT and poor:  # wheels may have jumped
        goes_on = _prior(state, going_on, scan.stamp, period, False)
        other = state.matcher.match(features, state.reference, geometry, goes_on)
        if not isinstance(other, str) and (isinstance(fit, str) or other.inlier_ratio > fit.inlier_ratio):
            fit = other if isinstance(fit, str) else _either(other, fit)
    if not isinstance(fit, str):
        moved = se2.between(state.pose, fit.pose)
        if not _is_too_fast(moved, scan.stamp - state.observed if state.variance.any() else period):
            if sweep.part > 0.0:
                state, fit = _with_sweep(state, before_sweep, fit, se2.log(moved), period)
            return _matched(state, scan, features, geometry, fit, moved)
        fit = "it would have moved the base faster than a base moves"
    state, match = _failed(state._replace(stamp=scan.stamp), features, expected, fit)
    if prior is not None and not _bends(scan, period):  # it alone shows how the motion goes on
        state = state._replace(motion=np.array([twist, state.motion[1] + state.predicted - before]))
    elif match.keyframe:
        state = state._replace(motion=np.zeros((2, 3)))
    return state, match


def _is_too_fast(moved: np.ndarray, period: float) -> bool:
    """Whether a motion (3,) in a period [s] is beyond what any indoor base does; stamps may be off by a period."""
    most = max(2.0 * period, _LAG)
    return bool(math.hypot(moved[0], moved[1]) > _FASTEST[0] * most or abs(moved[2]) > _FASTEST[1] * most)


def _bends(scan: LaserScan, period: float) -> bool:
    """Whether a sweep would be undistorted by a motion over so long a period [s] that it says nothing of the sweep."""
    return scan.time_increment > 0.0 and period >= _GAP


def _either(better: Fit, other: Fit) -> Fit:
    """Return the better of two fits, as wrong as they are apart where half as many returns agree with the other one."""
    if other.inlier_ratio < 0.5 * better.inlier_ratio:
        return better
    apart = np.outer(*2 * [se2.difference(better.pose, other.pose)])
    return replace(better, covariance=better.covariance + apart, shared=better.shared + apart)


def _geometry(state: LidarState, scan: LaserScan) -> tuple[LidarState, ScanGeometry]:
    """Return the tables for this kind of scan, made where it is a new one."""
    for known in state.geometries:
        if same_kind(scan, known):
            return state, known
    geometry = scan_geometry(scan, state.T_base_laser, 5)
    return state._replace(geometries=(*state.geometries, geometry)[-4:]), geometry


def _features(
    state: LidarState, scan: LaserScan, geometry: ScanGeometry, prior: np.ndarray | None, period: float
) -> tuple[Features, Sweep]:
    """Return the features of a scan, carried to where the sweep began by the mean of the last motions, and that motion.

    A prior shows how that changes; what it says itself does worse, for wheels have errors of their own. What that was
    off by, one time after the other, shows how the motion lags.
    """
    share, motion = share_of_a_beam(scan, period) if math.isfinite(period) else 0.0, np.zeros(3)
    if period >= _GAP:  # the motion of a gap says little of that in a sweep, and nothing of how it lags
        motion = np.zeros(3) if prior is None else se2.log(prior)
    elif share > 0.0 and not state.motion.any() and prior is not None:
        motion = se2.log(prior)
    elif share > 0.0:
        motion = state.motion[1]
        if prior is not None:
            motion = motion + _mean(state.predicted, se2.log(prior), period) - state.predicted
        motion = motion + state.sweep.lag
    part = share * len(scan.ranges) if period < _GAP else 0.0
    sweep = state.sweep._replace(part=part, motion=motion)
    motion = se2.adjoint(se2.inverse(geometry.pose_base_laser)) @ motion
    return state.matcher.features(scan, geometry, motion, share), sweep


def _with_sweep(state: LidarState, before: Sweep, fit: Fit, moved: np.ndarray, period: float) -> tuple[LidarState, Fit]:
    """Learn what the last sweep's motion was off by, now that it is shown; let matches be as wrong as that makes them.

    moved (3,): the twist since the last scan. Its own noise counts three times: of two poses, and of the mean.
    """
    own = np.diag(fit.covariance - fit.shared)
    sweep = state.sweep
    if before.part > 0.0 and period < _RECENT and not state.variance.any():  # the last scan was matched, too
        e, part = moved - before.motion, -math.expm1(-period / _LAGGING)
        square = sweep.square + part * (e * e - 3.0 * own - sweep.square)
        sweep = sweep._replace(lag=sweep.lag + part * e, square=square)
    bent = np.maximum(sweep.part**2 * sweep.square - own, 0.0)  # less than the match's own noise is in its residuals
    return state._replace(sweep=sweep), replace(fit, covariance=fit.covariance + np.diag(bent))


def _mean(mean: np.ndarray, last: np.ndarray, period: float) -> np.ndarray:
    """Return the running mean (3,) of motions with one more of them, that took a period [s]."""
    return mean + -math.expm1(-period / _LASTING) * (last - mean)


def _prior(state: LidarState, twist: np.ndarray, stamp: float, unknown: float, by_wheels: bool) -> Prior:
    """Predict the base's pose in the reference, wide: it says where to look, and not what to find (`predict`).

    What has not been observed for a while is off by ever more of the same, not at random: its deviation grows with
    time, from keyframe to keyframe, so that the variance of this match is what is left of that since the keyframe.
    """
    observed = min(state.observed, state.keyframe)
    growth = (stamp - observed) ** 2 - (state.keyframe - observed) ** 2
    settings, at = state.config.prior, (state.pose, state.variance, state.keyframe_pose)
    return Prior(*_lidar_kernels.predict(settings, *at, twist, unknown, growth, by_wheels))


def _restarted(state: LidarState, features: Features) -> LidarState:
    """Return the state with a new reference, of which this scan is the only keyframe."""
    reference, pose = state.matcher.extended(None, features, None)
    state = state._replace(keyframe=state.stamp, keyframe_pose=pose, keyframe_noise=None)
    return state._replace(reference=reference, pose=pose, variance=_NONE, lost=0)


def _failed(state: LidarState, features: Features, prior: Prior, reason: str) -> tuple[LidarState, ScanMatch]:
    """Go on with the prior; after some scans in a row that see enough, start anew where the base is thought to be."""
    state = state._replace(pose=prior.pose, variance=prior.sigma**2)
    enough = features.count >= _FEWEST
    lost = enough and state.lost + 1 >= _LOST
    state = _restarted(state, features) if lost else state._replace(lost=state.lost + enough)
    return state, ScanMatch(state.stamp, None, reason, 0, keyframe=lost)


def _matched(
    state: LidarState, scan: LaserScan, features: Features, geometry: ScanGeometry, fit: Fit, moved: np.ndarray
) -> tuple[LidarState, ScanMatch]:
    """Tell where the base is relative to the newest keyframe, and make the scan one where it is far from all."""
    config, noise, matcher = state.config, state.keyframe_noise, state.matcher
    keyframe = state.keyframe_pose, _UNKNOWN if noise is None else noise
    found, last = (
        (fit.pose, fit.covariance, fit.shared),
        (moved, state.motion[1] if state.motion.any() else se2.log(moved), (scan.stamp - state.stamp) / _LASTING),
    )
    pose, covariance, shared, motion = _lidar_kernels.relate(*keyframe, *found, *last)
    if _bends(scan, scan.stamp - state.stamp):
        motion = np.zeros((2, 3))
    measurement = RelativePoseMeasurement(state.keyframe, scan.stamp, pose, covariance, "lidar", None, shared)
    blind = len(fit.directions) > 0
    observed = state.observed if blind else scan.stamp
    state = state._replace(stamp=scan.stamp, pose=fit.pose, variance=_NONE, motion=motion, observed=observed, lost=0)
    is_keyframe, noise = matcher.is_far(fit, features, geometry, state.reference), None
    if is_keyframe or (blind and config.speed * (scan.stamp - state.keyframe) > 2.0 * config.distance):
        reference, pose = matcher.extended(state.reference, features, fit)
        is_keyframe, noise = True, _noise_in_map(fit) if np.array_equal(pose, fit.pose) else None
        if _is_noisier(noise, keyframe[1]) and scan.stamp - state.keyframe < _HELD:
            is_keyframe = False
        else:
            state = state._replace(keyframe=scan.stamp, keyframe_pose=pose, keyframe_noise=noise, pose=pose)
    else:
        reference = matcher.followed(state.reference, features, fit)
    match = ScanMatch(scan.stamp, measurement, "", fit.rows, fit.directions, is_keyframe, moved, noise)
    return state._replace(reference=reference), match


def _is_noisier(noise: np.ndarray | None, before: np.ndarray) -> bool:
    """Whether a keyframe is placed with far more noise than the one before: a base that is bumped bends its sweeps."""
    return noise is not None and bool((np.diag(noise) > 4.0 * np.diag(before)).any())


def _noise_in_map(fit: Fit) -> np.ndarray:
    """Return the error (3, 3) with which a scan enters a map, but for directions that it does not show.

    There its pose is the prior's, and so are those of later scans, which go on from it. A reference that begins anew
    with a scan has none of this error.
    """
    if len(fit.directions) == 0:
        return fit.covariance
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
