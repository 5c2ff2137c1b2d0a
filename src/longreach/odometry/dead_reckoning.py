"""Dead reckoning: a trajectory from relative poses alone."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from longreach.errors import EstimationError
from longreach.measurement import RelativePoseMeasurement
from longreach.odometry import _dead_reckoning_kernels
from longreach.trajectory import PoseTrajectory


def integrate(
    measurements: Sequence[RelativePoseMeasurement],
    stamps: Sequence[float] | Float[np.ndarray, " n"],
    start: Float[np.ndarray, "3"] | None = None,
) -> PoseTrajectory:
    """Compose relative poses: T ← T · Δ and Σ ← Ad(Δ⁻¹) Σ Ad(Δ⁻¹)ᵀ + Q.

    A row at which no measurement ends keeps the pose and the covariance of the row before. Such rows are the second one
    of two with the same stamp, a scan without a match, and the row after a break of the wheel odometry.

    Arguments:
        measurements: each from one of the stamps to a later one; at most one ends at a stamp.
        stamps: of the rows (n,) [s], never backwards.
        start: pose of the first row (3,) [m, m, rad], known exactly; None is the identity.

    Returns: n rows with the covariance (3, 3) of ξ = log(mean⁻¹ · truth) [m, m, rad].

    Raises:
        EstimationError: the stamps run backwards, or a measurement's are not among them.
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
