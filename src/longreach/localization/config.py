"""What can be set in a localizer, and what a robot's description says of its filter."""

import math
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from longreach.estimation.planar.config import FilterConfig
from longreach.odometry.lidar import LidarConfig
from longreach.odometry.wheel import WheelConfig
from longreach.robot.description import RobotDescription

Source = Literal["wheels", "lidar", "imu", "fixes"]

# How a localizer uses its filter. What it learns of its sensors on the way: their noise, and how wrong the scale of
# wheels is, where 2 % is what rollers creep and tyres wear. history: a sweep and its way, many times over.
_USED = {"gate_mode": "inflate", "history": 0.5, "noise_memory": 300.0, "scale_deviation": (0.02, 0.02, 0.02)}


class LocalizerConfig(BaseModel):
    """Settings of a localizer: which sources are fused, and each step's own.

    Settings of the filter that are not given come from `filter_for`; how wrong stamps are, and that a gyro is there, is
    learned on the way.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    sources: tuple[Source, ...] | None = Field(
        default=None, min_length=1, description="What is fused; null: all that there is."
    )
    wheels: WheelConfig = WheelConfig()
    lidar: LidarConfig = LidarConfig()
    filter: FilterConfig = FilterConfig()


def filter_for(config: LocalizerConfig, robot: RobotDescription) -> FilterConfig:
    """Return the filter's settings in a localizer of a robot, where they are not given.

    The robot's limits say how hard it accelerates, its IMU how the bias walks; an innovation beyond the gate is taken
    with a larger covariance, a reading may be 0.5 s late, and noise and scale errors are learned.
    """
    described: dict[str, Any] = {
        "acceleration_deviation": tuple(limit / math.sqrt(3) for limit in robot.acceleration_limits),
        **_USED,
    }
    if robot.imu is not None:
        described["gyro_bias_walk"] = robot.imu.gyro_bias_walk
        described["initial_gyro_bias_deviation"] = robot.imu.gyro_bias_deviation
    given = config.filter.model_fields_set
    return config.filter.changed(**{key: value for key, value in described.items() if key not in given})
