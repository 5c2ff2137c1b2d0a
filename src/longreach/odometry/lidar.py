"""LIDAR odometry: each scan against a keyframe, from a guess that the wheels or a filter may give."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.measurement import LaserScan, RelativePoseMeasurement
from longreach.odometry import point_to_line, range_flow, symmetric_flow
from longreach.odometry.lidar_config import LidarConfig
from longreach.odometry.point_to_line import Lines
from longreach.odometry.scan_fit import Fit, Points, flow_guess
from longreach.odometry.scan_geometry import (
    FEWEST_BEAMS,
    ScanGeometry,
    check_mount,
    same_kind,
    scan_geometry,
    share_of_a_beam,
)
from longreach.odometry.scan_match import ScanMatch
from longreach.odometry.symmetric_flow import Keyscan

__all__ = ["LidarConfig", "LidarState", "Reference", "init", "lidar_odometry", "step"]

_FEWEST_ROWS = 12  # fewer beams that fall on the keyframe's lines than this do not make a match
_LASTING = 0.07  # [s] over which the mean of the motions forgets; two or three scans of a fast scanner
_DOUBTFUL = 0.6  # share of points that agree below which another guess is tried, too
_LEAST_SUPPORT = 0.1  # share of points that agree below which there is no match
_LOST = 2  # scans without a match, after which the next one becomes a keyframe


@dataclass(frozen=True, eq=False)
class Reference:
    """A keyframe of one kind of scans: when it was, what scans are matched to, the last scan, and where that was.

    pose (3,), covariance (3, 3): of the base at the last scan, seen from there. lost: scans since the last match.
    """

    stamp: float
    geometry: ScanGeometry
    lines: Lines | Keyscan
    last: Points
    pose: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    lost: int = 0


@dataclass(frozen=True, eq=False)
class LidarState:
    """The keyframe of each kind of scan, when the last scan was, and the base's twist per scan: the last, the mean.

    told: when a scan last told all directions, or the first one was. guided: the mean of what guides told (3,).
    flow: what range flow from scan to scan goes on from.
    """

    config: LidarConfig
    T_base_laser: Float[np.ndarray, "4 4"]
    references: tuple[Reference, ...] = ()
    stamp: float = -math.inf
    told: float = math.inf
    motion: Float[np.ndarray, "2 3"] = field(default_factory=lambda: np.zeros((2, 3)))
    guided: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    flow: range_flow.RangeFlowState | None = None


def init(config: LidarConfig, T_base_laser: Float[np.ndarray, "4 4"]) -> LidarState:
    """Start before any scan, with a laser mounted at T_base_laser.

    Raises:
        EstimationError: the laser's plane is tilted by more than 15° against the floor.
    """
    check_mount(T_base_laser)
    return LidarState(config, T_base_laser)


def step(
    state: LidarState, scan: LaserScan, guide: Float[np.ndarray, "3"] | None = None
) -> tuple[LidarState, ScanMatch]:
    """Match a scan against the keyframe of its kind.

    guide: predicted pose (3,) of the base at this scan seen from the base at the last one; None: it moves on as it did.
    """
    if len(scan.ranges) < FEWEST_BEAMS:
        reason = f"the scan has {len(scan.ranges)} beams, where at least {FEWEST_BEAMS} are needed"
        return state, ScanMatch(scan.stamp, None, reason, 0)
    if state.config.method == "range-flow":
        return _flowed(state, scan)
    period = scan.stamp - state.stamp
    if guide is not None and not np.isfinite(guide).all():
        guide = None
    moved = _moved(state, guide)
    place = next((i for i, known in enumerate(state.references) if same_kind(scan, known.geometry)), None)
    geometry = scan_geometry(scan, state.T_base_laser, 5) if place is None else state.references[place].geometry
    points = _points(state, scan, geometry, guide, period)
    if place is None:
        reason = "the scan is the first of its kind"
        state = replace(state, told=min(state.told, scan.stamp))
        return _restarted(state, scan, geometry, points, moved, None), ScanMatch(
            scan.stamp, None, reason, 0, keyframe=True
        )
    before = state.guided
    if guide is not None:
        state = replace(state, guided=_mean(before, se2.log(guide), period))
    found = _best_fit(state, state.references[place], points, moved, scan.stamp)
    reason = _wrong(found, points)
    if reason:
        if guide is not None:  # it alone tells how the motion goes on
            motion = np.array([se2.log(guide), state.motion[1] + state.guided - before])
            state = replace(state, motion=motion)
        return _failed(state, scan, points, moved, place, reason, guide is not None)
    return _matched(state, scan, points, place, found)


def _best_fit(state: LidarState, reference: Reference, points: Points, moved: np.ndarray, stamp: float) -> Fit:
    """Match from the guess, and where few points agree from what range flow finds since the last scan, too."""
    config, told = state.config, min(state.told, reference.stamp)
    # What has not been told for a while is off by ever more of the same, not at random: its deviation grows with time,
    # from keyframe to keyframe, so that the variance of this match is what is left of that since the keyframe.
    growth = (stamp - told) ** 2 - (reference.stamp - told) ** 2
    free = np.array([config.speed, config.speed, config.turn]) ** 2 * growth

    def from_guess(moved: np.ndarray) -> Fit:
        far, turned = math.hypot(moved[0], moved[1]), abs(moved[2])
        doubt = np.array([config.doubt + 0.3 * far, config.doubt + 0.3 * far, config.doubt + 0.3 * turned])
        guess, geometry = se2.compose(reference.pose, moved), reference.geometry
        if isinstance(reference.lines, Lines):
            return point_to_line.fit(points, reference.lines, geometry, config.lines, guess, doubt, free)
        assert isinstance(points, Keyscan)
        assert isinstance(reference.last, Keyscan)
        key, last, seen = reference.lines, reference.last, (reference.pose, reference.covariance)
        three = config.method == "three-scan-flow" and last is not key
        return symmetric_flow.fit(points, key, last, seen, three, geometry, guess, doubt, free)

    found = from_guess(moved)
    if found.support < _DOUBTFUL and points.count >= _FEWEST_ROWS:
        other = from_guess(flow_guess(reference.last, points, reference.geometry))
        if other.support > found.support:
            return other
    return found


def _moved(state: LidarState, guide: np.ndarray | None) -> np.ndarray:
    """Return the pose of the base now seen from the base at the last scan, as expected.

    Without a guide as far as last time: the stamps of a logger may be less regular than the scans are.
    """
    return se2.exp(state.motion[0]) if guide is None else guide


def _mean(mean: np.ndarray, last: np.ndarray, period: float) -> np.ndarray:
    """Return the running mean (3,) of motions with one more of them, that took a period [s]."""
    return mean + -math.expm1(-period / _LASTING) * (last - mean)


def _points(
    state: LidarState, scan: LaserScan, geometry: ScanGeometry, guide: np.ndarray | None, period: float
) -> Points:
    """Return the points of a scan, carried to where the sweep began by the mean of the last motions.

    A guide tells how that changes; what it says itself does worse, for wheels have errors of their own.
    """
    share = share_of_a_beam(scan, period) if math.isfinite(period) else 0.0
    motion = np.zeros(3)
    if share > 0.0:
        motion = state.motion[1]
        if guide is not None:
            motion = motion + _mean(state.guided, se2.log(guide), period) - state.guided
        motion = se2.adjoint(se2.inverse(geometry.pose_base_laser)) @ motion
    make = point_to_line.points_of if state.config.method == "point-to-line" else symmetric_flow.keyscan_of
    return make(scan.ranges, (float(scan.range_min), float(scan.range_max)), geometry, motion, share)


def _wrong(found: Fit, points: Points) -> str:
    """Return why a fit is none, or nothing."""
    if points.count < _FEWEST_ROWS:
        return f"only {points.count} beams see something"
    if found.rows < _FEWEST_ROWS:
        return f"only {found.rows} beams see something that the keyframe saw"
    if found.support < _LEAST_SUPPORT:
        return f"only {100 * found.support:.0f} % of the beams agree with the keyframe"
    if not math.isfinite(found.scale):
        return "the match is not finite"
    return ""


def _restarted(
    state: LidarState,
    scan: LaserScan,
    geometry: ScanGeometry,
    points: Points,
    moved: np.ndarray,
    place: int | None,
) -> LidarState:
    """Return the state in which this scan is the keyframe of its kind, and the other kinds have moved on."""
    others = tuple(
        replace(known, pose=se2.compose(known.pose, moved)) for i, known in enumerate(state.references) if i != place
    )
    old = None if place is None else state.references[place]
    noise = math.inf if old is None else 1.2 * old.lines.noise
    lines = points if isinstance(points, Keyscan) else point_to_line.lines_of(points, geometry, noise)
    new = Reference(scan.stamp, geometry, lines, points, np.zeros(3), np.zeros((3, 3)))
    return replace(state, references=(*others, new), stamp=scan.stamp)


def _failed(
    state: LidarState, scan: LaserScan, points: Points, moved: np.ndarray, place: int, reason: str, guided: bool
) -> tuple[LidarState, ScanMatch]:
    reference = state.references[place]
    if reference.lost + 1 >= _LOST and points.count >= _FEWEST_ROWS:
        state = _restarted(state, scan, reference.geometry, points, moved, place)
        motion = state.motion if guided else np.zeros((2, 3))
        return replace(state, motion=motion), ScanMatch(scan.stamp, None, reason, 0, keyframe=True)
    references = tuple(
        replace(known, pose=se2.compose(known.pose, moved), lost=known.lost + (i == place))
        for i, known in enumerate(state.references)
    )
    return replace(state, references=references, stamp=scan.stamp), ScanMatch(scan.stamp, None, reason, 0)


def _matched(
    state: LidarState, scan: LaserScan, points: Points, place: int, found: Fit
) -> tuple[LidarState, ScanMatch]:
    reference, config = state.references[place], state.config
    moved = se2.between(reference.pose, found.pose)
    measurement = RelativePoseMeasurement(
        reference.stamp, scan.stamp, found.pose, found.covariance, source="lidar", shared_covariance=found.shared
    )
    keyframe = bool(
        _is_far(config, found.pose, points)
        or found.rows < config.overlap * min(points.count, reference.lines.count)
        or (len(found.directions) and config.speed * (scan.stamp - reference.stamp) > 2.0 * config.distance)
    )
    last = se2.log(moved)
    motion = np.array([last, _mean(state.motion[1], last, scan.stamp - state.stamp)])
    told = state.told if len(found.directions) else scan.stamp
    if keyframe:
        references = _restarted(state, scan, reference.geometry, points, moved, place).references
    else:
        references = tuple(
            Reference(known.stamp, known.geometry, known.lines, points, found.pose, found.covariance)
            if i == place
            else replace(known, pose=se2.compose(known.pose, moved))
            for i, known in enumerate(state.references)
        )
    state = LidarState(config, state.T_base_laser, references, scan.stamp, told, motion, state.guided)
    match = ScanMatch(scan.stamp, measurement, "", found.rows, found.directions, keyframe, moved)
    return state, match


def _is_far(config: LidarConfig, pose: np.ndarray, points: Points) -> bool:
    """Whether a pose (3,) is so far from the keyframe that there has to be a new one."""
    if isinstance(points, Keyscan):
        return symmetric_flow.is_far(pose, points.xyr.shape[1])
    return bool(math.hypot(pose[0], pose[1]) > config.distance or abs(pose[2]) > config.angle)


def _flowed(state: LidarState, scan: LaserScan) -> tuple[LidarState, ScanMatch]:
    """Match a scan to the last one by range flow: every scan is a keyframe."""
    settings, mount = range_flow.RangeFlowConfig(), state.T_base_laser
    if state.flow is None:
        flow, match = range_flow.init(scan, mount, settings), ScanMatch(scan.stamp, None, "the scan is the first", 0)
    else:
        flow, match = range_flow.step(state.flow, scan, mount, settings)
    pose = None if match.measurement is None else match.measurement.pose
    return replace(state, flow=flow, stamp=scan.stamp), replace(match, keyframe=True, motion=pose)


def lidar_odometry(
    scans: Iterable[LaserScan],
    T_base_laser: Float[np.ndarray, "4 4"],
    config: LidarConfig | None = None,
    show_progress: Callable[[int], None] | None = None,
    guides: Sequence[Float[np.ndarray, "3"] | None] | None = None,
) -> tuple[ScanMatch, ...]:
    """Match each scan against its keyframe; the first scan has no entry.

    show_progress is called now and then with the number of scans done. guides: of each scan, as `step` takes it.
    """
    state = init(config or LidarConfig(), T_base_laser)
    matches = []
    for i, scan in enumerate(scans):
        state, match = step(state, scan, None if guides is None else guides[i])
        if i > 0:
            matches.append(match)
        if show_progress and i % 200 == 0:
            show_progress(i)
    return tuple(matches)
