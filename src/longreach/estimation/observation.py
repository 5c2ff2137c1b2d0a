"""What each measurement says about the state (3.27b): innovation z - h(mean), Jacobian H over the errors, covariance R.

A component of infinite variance was not measured and gives no row: a huge number in its place would cost digits.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from longreach.errors import RecordingError
from longreach.estimation import _observation_kernels as _kernels
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
    """Innovation (k,), H (k, n) and R (k, k) of the k components that were measured: innovation = H · error + noise."""

    innovation: np.ndarray
    H: np.ndarray
    R: np.ndarray


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


def _copy(array: np.ndarray) -> np.ndarray:
    """The kernels write into what they get, and want rows first."""
    return np.array(array, order="C")


def observe_twist(mean: Mean, measurement: TwistMeasurement) -> Observation:
    """z = v, the body twist."""
    return Observation(*_kernels.observe_twist(mean, _copy(measurement.twist), _copy(measurement.covariance)))


def observe_pose(mean: Mean, measurement: PoseMeasurement) -> Observation:
    """z = G X, its error n in the world's axes: H = blkdiag(R(θ), 1) on the error Ad(X⁻¹) γ + ξ of G X.

    G is the reference's pose. With d = log((G X)⁻¹ · z) known, that is with all three measured, ours is
    R(θ_z) d = R(θ_z) Ad(exp(-d)) (Ad(X⁻¹) γ + ξ) + n: linearised at the measurement, with the error seen from there, so
    that a first fix after a holiday lands on the pose measured however far that is.
    """
    return Observation(*_kernels.observe_pose(mean, _copy(measurement.pose), _copy(measurement.covariance)))


def observe_relative_pose(mean: Mean, measurement: RelativePoseMeasurement, clone: int, at: int = 0) -> Observation:
    """z = K⁻¹ · X · exp(-n): innovation -e with e = log(z⁻¹ · K⁻¹ · X); K, X are the poses at `clone` and `at`.

    H = Ad(exp(e)) on the error of X and -Ad(z⁻¹) on that of K: the derivatives of e at X · exp(-e), where it is 0, with
    the error seen from there. At X they would be J_r⁻¹(e) and -J_r⁻¹(e) Ad(X⁻¹ K); both agree as e goes to 0. This one
    is exact in X, so that steps that were badly predicted still compound as dead reckoning does, mean and covariance.
    And H vanishes on errors Ad(X⁻¹) g, Ad(K⁻¹) g that all poses share, which no relative pose can tell.
    Source: Huang, Mourikis & Roumeliotis 2010, "Observability-based rules for designing consistent EKF SLAM
    estimators".
    """
    return Observation(
        *_kernels.observe_relative_pose(mean, _copy(measurement.pose), _copy(measurement.covariance), clone, at)
    )


def observe_imu(mean: Mean, measurement: PlanarImu) -> Observation:
    """Rate ω + bias, and the acceleration v̇ + ω×v + ω̇×p + ω×(ω×p) of the IMU's place p, v̇ and ω̇ from the state.

    Taking ω̇ from the state makes it a quantity of the filter's own, whatever the rate of the messages.
    """
    z, R = np.zeros(3), np.diag([measurement.rate_variance, np.inf, np.inf])
    z[0] = measurement.rate
    if measurement.acceleration is not None:
        z[1:], R[1:, 1:] = measurement.acceleration, measurement.acceleration_covariance
    px, py = measurement.position.tolist()
    return Observation(*_kernels.observe_imu(mean, z, R, px, py))


MODELS: Mapping[type, Callable[..., Observation]] = {
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


_BLOCKS_OF_POSE, _BLOCKS_OF_IMU = np.array([0, 0, 1]), np.array([1, 0, 0])


def blocks_of(measurement: Measurement) -> Int[np.ndarray, " k"]:
    """Tell of each measured component whether it is a translation (0) or a turn (1)."""
    if isinstance(measurement, PlanarImu):
        if measurement.acceleration_covariance is None:
            return _BLOCKS_OF_IMU[:1] if measurement.rate_variance != math.inf else _BLOCKS_OF_IMU[:0]
        C, blocks, first = measurement.acceleration_covariance, _BLOCKS_OF_IMU, measurement.rate_variance
        infinite = [first == math.inf, C[0, 0] == math.inf, C[1, 1] == math.inf]
    else:
        C, blocks = measurement.covariance, _BLOCKS_OF_POSE
        infinite = [C[0, 0] == math.inf, C[1, 1] == math.inf, C[2, 2] == math.inf]
    return blocks[~np.array(infinite)] if any(infinite) else blocks


def observe(mean: Mean, measurement: Any, *indices: int) -> tuple[Observation, str]:
    """Return the observation, and why it must not be used ("" where it may be).

    indices: in the mean, of the clone that a relative pose is seen from, and of the pose that it tells, 0 the present.
    """
    observation = MODELS[type(measurement)](mean, measurement, *indices)
    return observation, _FAULTS[_kernels.fault(observation.innovation, observation.R)]
