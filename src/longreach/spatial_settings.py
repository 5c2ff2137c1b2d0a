"""What can be set in the 15-state filter; a file for robot_localization says the same in its own words.

The state is x y z, roll pitch yaw, body velocity, body rates, body acceleration, and so are all masks and matrices.
"""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

Mask = tuple[bool, ...]

# The defaults of robot_localization.
PROCESS_NOISE = (0.05, 0.05, 0.06, 0.03, 0.03, 0.06, 0.025, 0.025, 0.04, 0.01, 0.01, 0.02, 0.01, 0.01, 0.015)
INITIAL_VARIANCE = 1e-9


@dataclass(frozen=True)
class SensorSettings:
    """One sensor: which of its 15 values are fused, and how.

    differential: poses are fused as the twist from the last one to this. relative: as seen from the first one. Gates
    are Mahalanobis distances [σ]. child_frame: the pose is that of the message's child frame, not of the base.
    """

    name: str
    kind: Literal["odom", "pose", "twist", "imu"]
    topic: str
    mask: Mask
    differential: bool = False
    relative: bool = False
    pose_gate: float = math.inf
    twist_gate: float = math.inf
    acceleration_gate: float = math.inf
    remove_gravity: bool = False
    child_frame: bool = False


@dataclass(frozen=True, eq=False)
class ControlSettings:
    """Which of the six commanded velocities drive the prediction, and with what accelerations [m/s², rad/s²]."""

    mask: Mask
    limits: tuple[float, ...]
    gains: tuple[float, ...]
    braking_limits: tuple[float, ...]
    braking_gains: tuple[float, ...]
    timeout: float
    stamped: bool = False


@dataclass(frozen=True, eq=False)
class SpatialSettings:
    """Everything the filter needs to know besides the recording.

    frequency: rows of the estimate [1/s]. sensor_timeout: after so long without a measurement rows are predicted [s].
    history: how late a measurement may come [s]. process_noise: growth of the covariance in 1 s (15, 15).
    as_robot_localization: take over its known defects, so that numbers can be compared.
    """

    sensors: tuple[SensorSettings, ...]
    filter: Literal["ekf", "ukf"] = "ekf"
    frequency: float = 30.0
    sensor_timeout: float = 1.0 / 30.0
    predict_to_now: bool = False
    two_d_mode: bool = False
    map_frame: str = "map"
    odom_frame: str = "odom"
    base_frame: str = "base_link"
    world_frame: str = "odom"
    process_noise: Float[np.ndarray, "15 15"] = field(default_factory=lambda: np.diag(PROCESS_NOISE))
    initial_covariance: Float[np.ndarray, "15 15"] = field(default_factory=lambda: INITIAL_VARIANCE * np.eye(15))
    initial_state: Float[np.ndarray, "15"] = field(default_factory=lambda: np.zeros(15))
    dynamic_process_noise: bool = False
    gravity: float = 9.80665
    history: float = 1.0
    control: ControlSettings | None = None
    alpha: float = 1e-3
    kappa: float = 0.0
    as_robot_localization: bool = False
