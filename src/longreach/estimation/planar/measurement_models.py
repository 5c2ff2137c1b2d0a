"""What each measurement says about the state (3.27b): innovation z - h(mean), Jacobian H over the errors, covariance R.

A component of infinite variance was not measured and gives no row: a huge number in its place would cost digits.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.errors import RecordingError
from longreach.estimation.planar import _measurement_kernels as kernels
from longreach.estimation.planar.ekf import Mean, frozen
from longreach.estimation.planar.noise_adaptation import NOMINAL, Noise
from longreach.measurement import Imu, PoseMeasurement, RelativePoseMeasurement, TwistMeasurement, _Stamped


@dataclass(frozen=True, eq=False)
class PlanarImu(_Stamped):
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
    _shapes: ClassVar = {"acceleration": (2,), "position": (2,), "acceleration_covariance": (2, 2)}

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.acceleration is None) != (self.acceleration_covariance is None):
            raise RecordingError("A PlanarImu needs both an acceleration and its covariance, or neither.")


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
    imu: Imu, T_base_imu: Float[np.ndarray, "4 4"], rate_variance: float, acceleration_variance: float = math.inf,
    source: str = "imu",
) -> PlanarImu:  # fmt: skip
    """Turn an IMU's reading from the sensor's axes to the base's and keep what matters in the plane.

    Gravity is left out with the z axis: that is right only while the base stands level. A tilt of ε adds 9.81 ε [m/s²]
    to the acceleration, which `acceleration_variance` [(m/s²)²] has to cover; infinite, only the rate is used.
    """
    R, a, covariance = T_base_imu[:3, :3], None, None
    if imu.acceleration is not None and acceleration_variance != math.inf:
        a, covariance = R[:2] @ imu.acceleration, acceleration_variance * np.eye(2)
    rate, position = float(R[2] @ imu.angular_velocity), T_base_imu[:2, 3]
    return PlanarImu(imu.stamp, rate, a, position, rate_variance, covariance, source)


def _relative_pose(mean: Mean, z: RelativePoseMeasurement | Relation, noise: Noise, clone: int, at: int = 0) -> tuple:
    return kernels.observe_relative_pose(mean, z.pose, z.covariance, noise.row, clone, at)


def _imu(mean: Mean, z: PlanarImu, noise: Noise) -> tuple:
    a, covariance = z.acceleration, z.acceleration_covariance
    if a is None or covariance is None:
        a, covariance = _NOT_MEASURED
    return kernels.observe_imu(mean, float(z.rate), float(z.rate_variance), a, covariance, z.position, noise.row)


_NOT_MEASURED = frozen(np.zeros(2)), frozen(np.diag([math.inf] * 2))
MODELS: Mapping[type, Callable[..., tuple]] = {
    TwistMeasurement: lambda mean, z, noise: kernels.observe_twist(mean, z.twist, z.covariance, noise.row),
    PoseMeasurement: lambda mean, z, noise: kernels.observe_pose(mean, z.pose, z.covariance, noise.row),
    RelativePoseMeasurement: _relative_pose,
    Relation: _relative_pose,
    PlanarImu: _imu,
}
_FAULTS = (
    "",
    "not finite, or larger than anything a robot measures",
    "its covariance is not symmetric positive semidefinite",
    "it measures nothing: every variance is infinite",
)


def observe(mean: Mean, measurement: Any, *indices: int, noise: Noise = NOMINAL) -> tuple[Observation, str]:
    """Return the observation, and why it must not be used ("" where it may be); the models are in the kernels.

    indices: in the mean, of the clone that a relative pose is seen from, and of the pose that is seen, 0 the present.
    noise: what is known of its source's.
    """
    *observation, fault = MODELS[type(measurement)](mean, measurement, noise, *indices)
    return Observation(*observation), _FAULTS[fault]
