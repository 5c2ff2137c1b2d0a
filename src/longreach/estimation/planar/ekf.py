"""The steps of the extended Kalman filter (3.28), (3.29) on plain arrays; `filter` puts measurements in order.

The mean (16 + 3m,) is the base's pose relative to the local reference, twist, acceleration, gyro bias, the wheels'
scale errors; the pose of the reference in the world (odom or map); and m pose clones: past poses, relative to the
reference too, so that a pose measured relative to one of them is judged with the right correlation (stochastic cloning:
Roumeliotis & Burdick 2002).

Wheels, LIDAR and IMU measure relative poses, or in the body's frame. So they do not correct the reference: its pose is
considered in P and has no gain (Schmidt 1966). `rebase` makes a pose the reference, and only there the reference takes
over the error of that pose. A fix corrects the reference and the biases of gyro and wheels, which a long way shows
better than a short one, and leaves the local state alone: docs/estimation.md says why.

Ours differs from (3.29) in what a pose needs: corrections are put on by X · exp(ξ), after which P is carried to the
frame of the new mean by Ad(exp(-ξ)); P is corrected in Joseph's form, which holds for any gain and which rounding
cannot make indefinite.
"""

import math
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from longreach.estimation.planar import _ekf_kernels as kernels
from longreach.estimation.planar.motion_model import MotionModel, WheelModel

SCALE, REFERENCE = kernels.SCALE, kernels.REFERENCE
CLONES = REFERENCE + 3  # where the pose clones begin
_GAINS = {"all": 0, "local": 1, "fix": 2}

Mean = Float[np.ndarray, " n"]
Covariance = Float[np.ndarray, "n n"]


class Corrected(NamedTuple):
    """New mean and covariance, NIS = rᵀ S⁻¹ r with the R given, the factor that was put on R (0: not taken), and S.

    NIS is infinite where S is not positive definite or the result would not be finite.
    """

    mean: np.ndarray
    covariance: np.ndarray
    nis: float
    scale: float
    S: np.ndarray


def frozen(array: np.ndarray) -> np.ndarray:
    """Make a new array read-only; not a copy."""
    array.flags.writeable = False
    return array


def predict(model: MotionModel, mean: Mean, P: Covariance, dt: float) -> tuple[Mean, Covariance]:
    """Predict dt ≥ 0 [s] ahead, (3.28)."""
    tau, variances, walk = model.time_constant, model.acceleration_variance, model.bias_walk
    mean, P = kernels.predict(mean, P, dt, tau, variances, walk, model.stamp_deviation**2)
    return frozen(mean), frozen(P)


def correct(
    mean: Mean, P: Covariance, innovation: Float[np.ndarray, " k"], H: Float[np.ndarray, "k n"],
    R: Float[np.ndarray, "k k"], gate: float = math.inf, inflate: bool = False,
    gain: Literal["all", "local", "fix"] = "all",
) -> Corrected:  # fmt: skip
    """Correct by an innovation z - h(mean), (3.29), unless its NIS is above the gate.

    With `inflate`, one above the gate is taken with R scaled up until its NIS equals the gate, so that what it can move
    is bounded: the treatment of a heavy tail. gain: what is corrected, the rest is considered (Schmidt): "local", all
    but the pose of the reference; "fix", that pose and the biases of gyro and wheels.
    """
    mean, P, *judged = kernels.correct(mean, P, innovation, H, R, gate, inflate, _GAINS[gain])
    return Corrected(frozen(mean), frozen(P), *judged)


def chosen(mean: Mean, P: Covariance, rows: Int[np.ndarray, " m"]) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and P of these rows, which may repeat: errors after are np.eye(n)[rows] times those before."""
    mean, P = kernels.chosen(mean, P, rows)
    return frozen(mean), frozen(P)


def copying(n: int, source: int, i: int) -> Int[np.ndarray, " n"]:
    """Return n rows for `chosen`, of which the pose at i is a copy of that at `source`, and the rest stay."""
    rows = np.arange(n)
    rows[i : i + 3] = np.arange(source, source + 3)
    return rows


def rebase(mean: Mean, P: Covariance, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Make the pose at i (0: the base's) the reference; returns also how errors before are errors after (n, n)."""
    mean, P, M = kernels.rebase(mean, P, i)
    return frozen(mean), frozen(P), M


def correction_map(
    mean: Mean, P: Covariance, r: Float[np.ndarray, " k"], H: Float[np.ndarray, "k n"], R: Float[np.ndarray, "k k"]
) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, "k n"], Float[np.ndarray, " k"], Float[np.ndarray, "k k"]]:
    """Return how errors before `correct` of all states are errors after, H, S⁻¹ r and S⁻¹."""
    n = len(mean)
    information = np.linalg.inv(H @ P @ H.T + R)
    K, G = P @ H.T @ information, np.empty((n, n))
    kernels.retract(mean, K @ r, G)
    return G @ (np.eye(n) - K @ H), H, information @ r, 0.5 * (information + information.T)


def carry(
    wheels: WheelModel, mean: Mean, P: Covariance, i: int, pose: Float[np.ndarray, "3"], Q: Float[np.ndarray, "3 3"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Move the clone at i by a pose [m, m, rad] seen from it, in error by log(pose⁻¹ · truth) ~ N(0, Q).

    The step ξ = log(pose) is taken as (1 + s) ξ with the wheels' scale errors s, axis by axis. An error that the pose
    shares with the step leaves their difference alone: what the motion model expects is not held against the step.
    Returns mean, covariance, and how errors before are errors after (n, n).
    """
    mean, P, T = kernels.carry(mean, P, i, pose, Q, wheels.coupled, wheels.scale_variance, wheels.reach)
    return frozen(mean), frozen(P), T
