"""Dead reckoning: a path out of relative poses alone."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from longreach.errors import EstimationError
from longreach.measurement import RelativePoseMeasurement
from longreach.odometry import _relative_kernels
from longreach.trajectory import PoseTrajectory


def chain(
    measurements: Sequence[RelativePoseMeasurement],
    stamps: Sequence[float] | Float[np.ndarray, " n"],
    start: Float[np.ndarray, "3"] | None = None,
) -> PoseTrajectory:
    """Put relative poses one after the other: T ← T · Δ and Σ ← Ad(Δ⁻¹) Σ Ad(Δ⁻¹)ᵀ + Q.

    A row that no measurement ends at keeps the pose and the covariance of the row before: a stamp that occurs twice, a
    scan that gave no match, wheels whose counter broke.

    Arguments:
        measurements: each from one of the stamps to a later one; at most one ends at a stamp.
        stamps: of the rows (n,) [s], never backwards.
        start: pose of the first row [m, m, rad], known exactly; None is the identity.

    Returns: n rows with the covariance of ξ = log(mean⁻¹ · truth).

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
    _relative_kernels.chain_all(reference, relative, Q, poses, covariance)
    return PoseTrajectory(clock, poses, covariance, clock)


def _rows(clock: np.ndarray, stamps: Sequence[float]) -> np.ndarray:
    rows = np.searchsorted(clock, np.array(stamps))  # the first of equal stamps; the others keep its pose
    known = rows < len(clock)
    known[known] = clock[rows[known]] == np.array(stamps)[known]
    if not known.all():
        missing = stamps[int(np.argmin(known))]
        raise EstimationError(f"A relative pose has the stamp {missing:.6f}, which is not one of the path's.")
    return rows
