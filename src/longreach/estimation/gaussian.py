"""What the filter believes at one moment: a mean on SE(2) × R⁷ and the covariance of the error about it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.measurement import frozen_array


@dataclass(frozen=True, eq=False)
class Belief:
    """Pose [x, y, θ], body twist [v_x, v_y, ω], its derivative in body axes, and the gyro's bias [rad/s] at `stamp`.

    covariance (10, 10): of the error in that order; the pose's is ξ = log(mean⁻¹ · truth), in the body frame.
    """

    stamp: float
    pose: Float[np.ndarray, "3"]
    twist: Float[np.ndarray, "3"]
    acceleration: Float[np.ndarray, "3"]
    gyro_bias: float
    covariance: Float[np.ndarray, "10 10"]

    def __post_init__(self) -> None:
        for name in ("pose", "twist", "acceleration"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (3,), f"Belief.{name}"))
        object.__setattr__(self, "covariance", frozen_array(self.covariance, (10, 10), "Belief.covariance"))

    @property
    def pose_covariance(self) -> Float[np.ndarray, "3 3"]:
        """Covariance of ξ, order x y θ [m², m rad, rad²]."""
        return self.covariance[:3, :3]
