"""The prior of a scan's match: where wheel odometry expects the base, from what it had measured by then."""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.measurement import RelativePoseMeasurement

_AHEAD = 0.3  # [s] that the last step of the wheels is carried on at most; a stop takes about that


def from_wheels(steps: Sequence[RelativePoseMeasurement], before: float, now: float) -> Float[np.ndarray, "3"] | None:
    """Return the pose of the base at `now` seen from the base at `before` [s], by the wheels' steps up to `now`.

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


def between_scans(
    steps: Sequence[RelativePoseMeasurement], stamps: Sequence[float]
) -> list[Float[np.ndarray, "3"] | None]:
    """Return for each scan the predicted pose seen from the scan before (`from_wheels`); None for the first."""
    return [None, *(from_wheels(steps, before, now) for before, now in pairwise(stamps))][: len(stamps)]
