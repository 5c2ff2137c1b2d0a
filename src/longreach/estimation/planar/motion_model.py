"""How the base moves between measurements: Singer acceleration, integrated exactly and put on the pose.

Per body axis the chain (displacement δ, velocity v, acceleration a) obeys δ' = v, v' = a, a' = -a/τ + white noise, of
such strength that a has a given standard deviation when nothing is measured. Over dt it is discretised exactly, for
any dt; the pose moves by X · exp(δ), its error by Ad(exp(-δ)) and J_r(δ). (3.27a) and (3.28), where the thesis leaves f
and Q open; robot_localization holds the acceleration constant with a noise to be tuned, for which no physical scale
exists. The gyro bias walks at random.

Source: Singer 1970, "Estimating optimal tracking filter performance for manned maneuvering targets", (5)-(9).
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from longreach.estimation.planar import _ekf_kernels as kernels
from longreach.measurement import frozen_array


@dataclass(frozen=True, eq=False)
class MotionModel:
    """Time constant τ [s], stationary variance of the accelerations (3,) [(m/s²)², (rad/s²)²], bias walk [rad²/s³].

    stamp_deviation [s]: how wrong stamps are, which no motion can be judged finer than.
    """

    time_constant: float
    acceleration_variance: Float[np.ndarray, "3"]
    bias_walk: float
    stamp_deviation: float = 0.0

    def __post_init__(self) -> None:
        variance = frozen_array(self.acceleration_variance, (3,), "The acceleration's variance")
        object.__setattr__(self, "acceleration_variance", variance)


@dataclass(frozen=True, eq=False)
class WheelModel:
    """How the steps of wheel odometry, which dead reckoning adds up, are wrong.

    coupled (3,): 1 in the axes in which the pose follows the wheels and shares a step's error, else 0.
    scale_variance (3,): of the errors of scale in x, y and θ, which stay much the same over `reach` [m and rad].
    """

    coupled: Float[np.ndarray, "3"]
    scale_variance: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    reach: float = 1.0

    def __post_init__(self) -> None:
        for name in ("coupled", "scale_variance"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (3,), f"WheelModel.{name}"))


def transition(
    model: MotionModel, mean: Float[np.ndarray, " n"], dt: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n n"], Float[np.ndarray, "n n"]]:
    """Move the mean by dt [s] and return it with F = ∂(new error)/∂(old error) and the process noise Q."""
    n = len(mean)
    F, Q = np.empty((n, n)), np.empty((n, n))
    new = kernels.transition(mean, float(dt), model.time_constant, model.acceleration_variance, model.bias_walk, F, Q)
    return new, F, Q


def retract(mean: Float[np.ndarray, " n"], error: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Move the mean by an error state: poses by X · exp(ξ), the rest by addition."""
    return kernels.retract(mean, error, np.empty((len(mean), len(mean))))
