"""What joins wheels, LIDAR and filter: where the wheels expect a scan, and which pose a match refers to.

Both are told from what came before the scan alone, so that a run and its replay see the same.
"""

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from longreach.estimation.fusion import Anchor, Event
from longreach.geometry import se2
from longreach.measurement import RelativePoseMeasurement
from longreach.odometry.scan_match import ScanMatch

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
    moved = _part(known[0], (known[0].stamp - before) / (known[0].stamp - known[0].stamp_reference))
    if len(known) == 1:
        moved = _part(known[0], (now - before) / (known[0].stamp - known[0].stamp_reference))
        return moved
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


def match_events(match: ScanMatch) -> list[Event]:
    """Return what a scan's match is to the filter: a measurement, an anchor that the next ones refer to, or both."""
    measurement = match.measurement
    if match.keyframe:
        return [Anchor(match.stamp, "lidar", measurement)]
    return [] if measurement is None else [measurement]


def lidar_events(matches: Iterable[ScanMatch]) -> list[Event]:
    """Return `match_events` of all, and the anchor of the first keyframe, which no match tells of."""
    events: list[Event] = []
    for match in matches:
        if not events and match.measurement is not None:
            events.append(Anchor(match.measurement.stamp_reference, "lidar"))
        events += match_events(match)
    return events


def counter_events(steps: Iterable[RelativePoseMeasurement], carried_to: float = -np.inf) -> list[Event]:
    """Return a counter's steps, and an anchor wherever none has carried it to where a step begins.

    carried_to: stamp of the reading that the anchor was carried to before [s].
    """
    events: list[Event] = []
    for step in steps:
        if step.stamp_reference != carried_to:
            events.append(Anchor(step.stamp_reference, step.source))
        events.append(step)
        carried_to = -np.inf if step.reading_covariance is None else step.stamp
    return events
