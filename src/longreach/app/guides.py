"""What joins wheels, LIDAR and filter: where the wheels expect a scan, and which pose a match refers to.

Both are told from what came before the scan alone, so that a run and its replay see the same.
"""

from bisect import bisect_right
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.estimation.fusion import Event, Keyframe, PoseClone
from longreach.geometry import se2
from longreach.measurement import LaserScan, RelativePoseMeasurement
from longreach.odometry import lidar
from longreach.odometry.lidar import LidarConfig, LidarState
from longreach.odometry.scan_match import ScanMatch

_FRESH = 0.2  # weight of the last scan in `Trust`
_SMALL = 0.001  # [m] that does not matter
_ARM = np.array([1.0, 1.0, 0.5])  # [1, 1, m]: a turn moves what the laser sees as if by this
_AHEAD = 0.3  # [s] that the last step of the wheels is carried on at most; a stop takes about that


def wheel_guide(steps: Sequence[RelativePoseMeasurement], before: float, now: float) -> Float[np.ndarray, "3"] | None:
    """Return the pose of the base at `now` seen from the base at `before` [s], as the wheels' steps up to `now` tell.

    steps: in order, each from a record to a later one; those that end after `now` are left out. Between records the
    twist is constant, after the last one it goes on. None where a step is missing, or too long ago.
    """
    last = bisect_right(steps, now, key=lambda step: step.stamp)
    first = min(bisect_right(steps, before, key=lambda step: step.stamp), last - 1)
    known = steps[max(first, 0) : last]
    if not known or before < known[0].stamp_reference or now - known[-1].stamp > _AHEAD:
        return None
    if any(a.stamp != b.stamp_reference for a, b in pairwise(known)):
        return None
    if len(known) == 1:
        return _part(known[0], (now - before) / (known[0].stamp - known[0].stamp_reference))
    moved = _part(known[0], (known[0].stamp - before) / (known[0].stamp - known[0].stamp_reference))
    for step in known[1:]:
        moved = se2.compose(moved, step.pose)
    return se2.compose(moved, _part(known[-1], (now - known[-1].stamp) / (known[-1].stamp - known[-1].stamp_reference)))


def _part(step: RelativePoseMeasurement, share: float) -> np.ndarray:
    return se2.exp(share * se2.log(step.pose))


def wheel_guides(
    steps: Sequence[RelativePoseMeasurement], stamps: Sequence[float]
) -> list[Float[np.ndarray, "3"] | None]:
    """Return for each scan what `wheel_guide` tells of the way since the scan before; None for the first."""
    return [None, *(wheel_guide(steps, before, now) for before, now in pairwise(stamps))][: len(stamps)]


class Trust(NamedTuple):
    """How well the last scans were where the wheels, and where the motion before, expected them: mean squares [m²]."""

    wheels: float = 0.0
    before: float = 0.0


def guided_step(
    state: LidarState, trust: Trust, scan: LaserScan, guide: Float[np.ndarray, "3"] | None, last: ScanMatch | None
) -> tuple[LidarState, Trust, ScanMatch]:
    """Match a scan from where the wheels expect it, unless they slip: unless going on as before has told better.

    last: the match before this one, whose motion is what going on means.
    """
    trusted = guide is not None and trust.wheels <= trust.before + _SMALL**2
    on = None if last is None else last.motion
    state, match = lidar.step(state, scan, guide if trusted else None)
    if guide is not None and on is not None and match.motion is not None:
        far = [float(np.sum((_ARM * se2.difference(expected, match.motion)) ** 2)) for expected in (guide, on)]
        trust = Trust(trust.wheels + _FRESH * (far[0] - trust.wheels), trust.before + _FRESH * (far[1] - trust.before))
    return state, trust, match


def guided_odometry(
    scans: Sequence[LaserScan],
    T_base_laser: Float[np.ndarray, "4 4"],
    config: LidarConfig,
    guides: Sequence[Float[np.ndarray, "3"] | None],
    show_progress: Callable[[int], None],
) -> tuple[ScanMatch, ...]:
    """Match all scans with `guided_step`; the first one has no entry."""
    state, trust, matches, last = lidar.init(config, T_base_laser), Trust(), [], None
    for i, (scan, guide) in enumerate(zip(scans, guides, strict=True)):
        state, trust, last = guided_step(state, trust, scan, guide, last)
        matches.append(last)
        if i % 200 == 0:
            show_progress(i)
    return tuple(matches[1:])


def match_events(match: ScanMatch) -> list[Event]:
    """Return what a scan's match is to the filter: a measurement, a keyframe that the next ones refer to, or both."""
    measurement = match.measurement
    if match.keyframe:
        return [Keyframe(match.stamp, "lidar", measurement)]
    return [] if measurement is None else [measurement]


def lidar_events(matches: Iterable[ScanMatch]) -> list[Event]:
    """Return `match_events` of all, and the first keyframe, which no match tells of."""
    events: list[Event] = []
    for match in matches:
        if not events and match.measurement is not None:
            events.append(Keyframe(match.measurement.stamp_reference, "lidar"))
        events += match_events(match)
    return events


def wheel_events(steps: Iterable[RelativePoseMeasurement], carried_to: float = -np.inf) -> list[Event]:
    """Return the steps of wheel odometry, and a pose clone wherever none has carried it to where a step begins.

    carried_to: stamp of the reading that the clone was carried to before [s].
    """
    events: list[Event] = []
    for step in steps:
        if step.stamp_reference != carried_to:
            events.append(PoseClone(step.stamp_reference, step.source))
        events.append(step)
        carried_to = -np.inf if step.reading_covariance is None else step.stamp
    return events
