"""What each measurement says about the state (3.27b): innovation z - h(mean), Jacobian H over the errors, covariance R.

A component of infinite variance was not measured and gives no row: a huge number in its place would cost digits.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.errors import RecordingError
from longreach.estimation import _observation_kernels as _kernels
from longreach.estimation.noise import NOMINAL, Noise
from longreach.measurement import (
    Imu,
    PoseMeasurement,
    RelativePoseMeasurement,
    TwistMeasurement,
    frozen_array,
)

Mean = Float[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class PlanarImu:
    """An IMU's rate about z [rad/s] and its acceleration (2,) [m/s²] in the base's axes, at `position` (2,) [m] there.

    acceleration None: only the rate was measured. An infinite variance means not measured.
    """

    stamp: float
    rate: float
    acceleration: Float[np.ndarray, "2"] | None
    position: Float[np.ndarray, "2"]
    rate_variance: float
    acceleration_covariance: Float[np.ndarray, "2 2"] | None = None
    source: str = "imu"

    def __post_init__(self) -> None:
        if not math.isfinite(self.stamp):
            raise RecordingError(f"A PlanarImu has the stamp {self.stamp}; a stamp is a finite number of seconds.")
        if (self.acceleration is None) != (self.acceleration_covariance is None):
            raise RecordingError("A PlanarImu needs both an acceleration and its covariance, or neither.")
        for name, shape in {"acceleration": (2,), "position": (2,), "acceleration_covariance": (2, 2)}.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen_array(value, shape, f"PlanarImu.{name}"))


Measurement = TwistMeasurement | PoseMeasurement | RelativePoseMeasurement | PlanarImu


class Observation(NamedTuple):
    """Innovation (k,), H (k, n) and R (k, k) of the k components that were measured: innovation = H · error + noise.

    blocks (k,): of each component whether it is a translation (0) or a turn (1).
    """

    innovation: np.ndarray
    H: np.ndarray
    R: np.ndarray
    blocks: np.ndarray


class Relation(NamedTuple):
    """A relative pose with what was not yet taken of it: the stamp that it refers to, pose (3,), covariance (3, 3)."""

    since: float
    pose: np.ndarray
    covariance: np.ndarray


def planar_imu(
    imu: Imu,
    T_base_imu: Float[np.ndarray, "4 4"],
    rate_variance: float,
    acceleration_variance: float = math.inf,
    source: str = "imu",
) -> PlanarImu:
    """Turn an IMU's reading from the sensor's axes to the base's and keep what matters in the plane.

    Gravity is left out with the z axis: that is right only while the base stands level. A tilt of ε adds 9.81 ε [m/s²]
    to the acceleration, which `acceleration_variance` [(m/s²)²] has to cover; infinite, only the rate is used.
    """
    R = T_base_imu[:3, :3]
    uses_acceleration = acceleration_variance != math.inf
    return PlanarImu(
        imu.stamp,
        float(R[2] @ imu.angular_velocity),
        R[:2] @ imu.acceleration if uses_acceleration else None,
        T_base_imu[:2, 3],
        rate_variance,
        acceleration_variance * np.eye(2) if uses_acceleration else None,
        source,
    )


def _said(r: np.ndarray, H: np.ndarray, R: np.ndarray, blocks: np.ndarray, fault: int) -> tuple[Observation, str]:
    return Observation(r, H, R, blocks), _FAULTS[fault]


def observe_twist(mean: Mean, measurement: TwistMeasurement, noise: Noise) -> tuple[Observation, str]:
    """z = v, the body twist."""
    return _said(*_kernels.observe_twist(mean, measurement.twist, measurement.covariance, noise.row))


def observe_pose(mean: Mean, measurement: PoseMeasurement, noise: Noise) -> tuple[Observation, str]:
    """z = G X, its error n in the world's axes: H = blkdiag(R(θ), 1) on the error Ad(X⁻¹) γ + ξ of G X.

    G is the reference's pose. With d = log((G X)⁻¹ · z) known, that is with all three measured, ours is
    R(θ_z) d = R(θ_z) Ad(exp(-d)) (Ad(X⁻¹) γ + ξ) + n: linearised at the measurement, with the error seen from there, so
    that a first fix after a holiday lands on the pose measured however far that is.
    """
    return _said(*_kernels.observe_pose(mean, measurement.pose, measurement.covariance, noise.row))


def observe_relative_pose(
    mean: Mean, measurement: RelativePoseMeasurement | Relation, noise: Noise, clone: int, at: int = 0
) -> tuple[Observation, str]:
    """z = K⁻¹ · X · exp(-n): innovation -e with e = log(z⁻¹ · K⁻¹ · X); K, X are the poses at `clone` and `at`.

    H = Ad(exp(e)) on the error of X and -Ad(z⁻¹) on that of K: the derivatives of e at X · exp(-e), where it is 0, with
    the error seen from there. At X they would be J_r⁻¹(e) and -J_r⁻¹(e) Ad(X⁻¹ K); both agree as e goes to 0. This one
    is exact in X, so that steps that were badly predicted still compound as dead reckoning does, mean and covariance.
    And H vanishes on errors Ad(X⁻¹) g, Ad(K⁻¹) g that all poses share, which no relative pose can tell.
    Source: Huang, Mourikis & Roumeliotis 2010, "Observability-based rules for designing consistent EKF SLAM
    estimators".
    """
    return _said(*_kernels.observe_relative_pose(mean, measurement.pose, measurement.covariance, noise.row, clone, at))


def observe_imu(mean: Mean, measurement: PlanarImu, noise: Noise) -> tuple[Observation, str]:
    """Rate ω + bias, and the acceleration v̇ + ω×v + ω̇×p + ω×(ω×p) of the IMU's place p, v̇ and ω̇ from the state.

    Taking ω̇ from the state makes it a quantity of the filter's own, whatever the rate of the messages.
    """
    rate, variance, p = float(measurement.rate), float(measurement.rate_variance), measurement.position
    a, covariance = measurement.acceleration, measurement.acceleration_covariance
    if a is None or covariance is None:
        a, covariance = _NOT_MEASURED
    return _said(*_kernels.observe_imu(mean, rate, variance, a, covariance, p, noise.row))


_NOT_MEASURED = frozen_array(np.zeros(2), (2,), "z"), frozen_array(np.diag([math.inf] * 2), (2, 2), "R")

MODELS: Mapping[type, Callable[..., tuple[Observation, str]]] = {
    TwistMeasurement: observe_twist,
    PoseMeasurement: observe_pose,
    RelativePoseMeasurement: observe_relative_pose,
    PlanarImu: observe_imu,
}

_FAULTS = (
    "",
    "not finite, or larger than anything a robot measures",
    "its covariance is not symmetric positive semidefinite",
    "it measures nothing: every variance is infinite",
)


def observe(mean: Mean, measurement: Any, *indices: int, noise: Noise = NOMINAL) -> tuple[Observation, str]:
    """Return the observation, and why it must not be used ("" where it may be).

    indices: in the mean, of the clone that a relative pose is seen from, and of the pose that it tells, 0 the present.
    noise: what is known of its source's.
    """
    return MODELS[type(measurement)](mean, measurement, noise, *indices)
