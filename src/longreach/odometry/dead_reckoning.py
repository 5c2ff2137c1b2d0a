"""Dead reckoning: a trajectory from relative poses alone, and the prior of a scan's match from those of the wheels."""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from longreach.errors import EstimationError
from longreach.geometry import se2
from longreach.measurement import RelativePoseMeasurement
from longreach.odometry import _dead_reckoning_kernels
from longreach.trajectory import PoseTrajectory

_AHEAD = 0.3  # [s] that the last step of the wheels is carried on at most; a stop takes about that


def integrate(
    measurements: Sequence[RelativePoseMeasurement],
    stamps: Sequence[float] | Float[np.ndarray, " n"],
    start: Float[np.ndarray, "3"] | None = None,
) -> PoseTrajectory:
    """Compose relative poses: T ← T · Δ and Σ ← Ad(Δ⁻¹) Σ Ad(Δ⁻¹)ᵀ + Q.

    A row at which no measurement ends keeps the pose and the covariance of the row before.

    measurements: each from one of the stamps to a later one; at most one ends at a stamp. stamps (n,) [s]: of the rows,
    never backwards. start (3,): pose of the first row, known exactly; None is the identity.
    Returns n rows with the covariance (3, 3) of ξ = log(mean⁻¹ · truth) [m, m, rad]. Raises EstimationError where the
    stamps run backwards, or a measurement's are not among them.
    """
    clock = np.array(stamps, dtype=float)
    n = len(clock)
    if np.any(np.diff(clock) < 0):
        raise EstimationError("The stamps of a path run backwards; give them, and their measurements, in order.")
    reference = np.arange(-1, n - 1)
    relative, Q = np.zeros((n, 3)), np.zeros((n, 3, 3))
    if measurements:
        ends = _rows(clock, [m.stamp for m in measurements])
        reference[ends] = _rows(clock, [m.stamp_reference for m in measurements])
        if np.any(reference[ends] >= ends):
            raise EstimationError("A relative pose must refer to an earlier stamp than its own.")
        relative[ends] = np.array([m.pose for m in measurements])
        Q[ends] = np.array([m.covariance for m in measurements])
    poses, covariance = np.zeros((n, 3)), np.zeros((n, 3, 3))
    poses[:1] = 0.0 if start is None else start
    _dead_reckoning_kernels.integrate_all(reference, relative, Q, poses, covariance)
    return PoseTrajectory(clock, poses, covariance, clock)


def _rows(clock: np.ndarray, stamps: Sequence[float]) -> np.ndarray:
    """Return the row of each stamp, the first one of equal stamps."""
    rows = np.searchsorted(clock, np.array(stamps))
    known = rows < len(clock)
    known[known] = clock[rows[known]] == np.array(stamps)[known]
    if not known.all():
        missing = stamps[int(np.argmin(known))]
        raise EstimationError(f"A relative pose has the stamp {missing:.6f}, which is not one of the path's.")
    return rows


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
