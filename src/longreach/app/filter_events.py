"""What joins wheels, LIDAR and filter: which events their odometry is to the filter."""

from collections.abc import Iterable

import numpy as np

from longreach.estimation.fusion import Event, Keyframe, PoseClone
from longreach.measurement import RelativePoseMeasurement
from longreach.odometry.scan_match import ScanMatch


def match_events(match: ScanMatch) -> list[Event]:
    """Return what a scan's match is to the filter: a measurement, a keyframe that the next ones refer to, or both."""
    measurement = match.measurement
    if match.keyframe:
        return [Keyframe(match.stamp, "lidar", measurement, match.keyframe_noise)]
    return [] if measurement is None else [measurement]


def lidar_events(matches: Iterable[ScanMatch]) -> list[Event]:
    """Return `match_events` of all, and the first keyframe, which no match leads to."""
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
