"""The two steps of the extended Kalman filter (3.28), (3.29) on plain arrays; `fusion` puts measurements in order.

The mean (13 + 3m,) is pose, twist, acceleration, gyro bias, a counter's scale errors and m anchors: past poses kept in
the state, so that a pose measured relative to one of them is judged with the right correlation (stochastic cloning:
Roumeliotis & Burdick 2002).
Ours differs from (3.29) in what a pose needs: corrections are put on by X · exp(ξ), after which P is carried to the
frame of the new mean by Ad(exp(-ξ)); P is corrected in Joseph's form, which rounding cannot make indefinite.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.estimation import _anchor_kernels, _kernels
from longreach.estimation.motion import Counter, MotionModel

BODY, SCALE = _kernels.BODY, _kernels.SCALE

Mean = Float[np.ndarray, " n"]
Covariance = Float[np.ndarray, "n n"]


class Corrected(NamedTuple):
    """New mean and covariance, NIS = rᵀ S⁻¹ r with the R given, and the factor that was put on R (0: not taken).

    NIS is infinite where S is not positive definite or the result would not be finite.
    """

    mean: np.ndarray
    covariance: np.ndarray
    nis: float
    scale: float


def _read_only(mean: np.ndarray, P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mean.flags.writeable = False
    P.flags.writeable = False
    return mean, P


def predict(model: MotionModel, mean: Mean, P: Covariance, dt: float) -> tuple[Mean, Covariance]:
    """Predict dt ≥ 0 [s] ahead, (3.28)."""
    return _read_only(
        *_kernels.predict(
            mean,
            P,
            dt,
            model.time_constant,
            model.acceleration_variance,
            model.bias_walk,
            model.stamp_deviation**2,
        )
    )


def correct(
    mean: Mean,
    P: Covariance,
    innovation: Float[np.ndarray, " k"],
    H: Float[np.ndarray, "k n"],
    R: Float[np.ndarray, "k k"],
    gate: float = math.inf,
    inflate: bool = False,
) -> Corrected:
    """Correct by an innovation z - h(mean), (3.29), unless its NIS is above the gate.

    With `inflate`, one above the gate is taken with R scaled up until its NIS equals the gate, so that what it can
    move is bounded: the treatment of a heavy tail.
    """
    new, covariance, nis, scale = _kernels.correct(mean, P, innovation, H, R, gate, inflate)
    return Corrected(*_read_only(new, covariance), nis, scale)


def innovation_covariance(
    P: Covariance, H: Float[np.ndarray, "k n"], R: Float[np.ndarray, "k k"]
) -> Float[np.ndarray, "k k"]:
    """Return S = H P Hᵀ + R."""
    return _kernels.innovation_covariance(P, H, R)


def clone(mean: Mean, P: Covariance, anchor: int) -> tuple[np.ndarray, np.ndarray]:
    """Remember the pose as the anchor of that number, in place of what it held; the next free number adds one."""
    return _read_only(*_anchor_kernels.clone(mean, P, anchor))


def moved_anchor(mean: Mean, P: Covariance, anchor: int, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Put the last anchor, of that number, in place of another; there is one fewer then."""
    rows = _moved_rows(anchor, number)
    return _read_only(mean[rows], P[np.ix_(rows, rows)])


def _moved_rows(anchor: int, number: int) -> np.ndarray:
    rows = np.arange(BODY + 3 * anchor)
    rows[BODY + 3 * number : BODY + 3 * number + 3] = BODY + 3 * anchor + np.arange(3)
    return rows


def moved_anchor_map(anchor: int, number: int) -> Float[np.ndarray, "m n"]:
    """Return how errors before `moved_anchor` are errors after."""
    return np.eye(BODY + 3 * anchor + 3)[_moved_rows(anchor, number)]


def clone_map(n: int, anchor: int) -> Float[np.ndarray, "m n"]:
    """Return how n errors before `clone` are errors after."""
    i = BODY + 3 * anchor
    rows = np.arange(max(n, i + 3))
    rows[i : i + 3] = np.arange(3)
    return np.eye(n)[rows]


def correction_map(
    mean: Mean,
    P: Covariance,
    r: Float[np.ndarray, " k"],
    H: Float[np.ndarray, "k n"],
    R: Float[np.ndarray, "k k"],
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "k n"], Float[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    """Return how errors before `correct` are errors after, H, S⁻¹ r and S⁻¹."""
    n = len(mean)
    information = np.linalg.inv(H @ P @ H.T + R)
    K, G = P @ H.T @ information, np.empty((n, n))
    _kernels.retract(mean, K @ r, G)
    return G @ (np.eye(n) - K @ H), H, information @ r, 0.5 * (information + information.T)


def carry(
    counter: Counter,
    mean: Mean,
    P: Covariance,
    anchor: int,
    pose: Float[np.ndarray, "3"],
    Q: Float[np.ndarray, "3 3"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Move the anchor of that number by a pose [m, m, rad] seen from it, in error by log(pose⁻¹ · truth) ~ N(0, Q).

    The step ξ = log(pose) is taken as (1 + s) ξ with the counter's scale errors s, axis by axis. In the axes that the
    counter leads, the present pose shares the step's error, having been led by it. An error that both share leaves
    their difference alone: what the motion model expects is not held against the step. Returns mean, covariance, and
    how errors before are errors after (n, n).
    """
    moved, covariance, T = _anchor_kernels.carry(
        mean, P, anchor, pose, Q, counter.led, counter.scale_variance, counter.reach
    )
    return *_read_only(moved, covariance), T
