"""What can be set in a localizer, and what a robot's description says of its filter."""

import math
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from longreach.estimation.planar.config import FilterConfig
from longreach.odometry.lidar import LidarConfig
from longreach.odometry.wheel import WheelConfig
from longreach.robot.description import RobotDescription

Source = Literal["wheels", "lidar", "imu", "fixes"]

# What the filter learns of its sensors on the way: their noise, and how wrong the scale of wheels is, where 2 % is what
# rollers creep and tyres wear.
_LEARNED = {"noise_memory": 300.0, "scale_deviation": (0.02, 0.02, 0.02)}


class LocalizerConfig(BaseModel):
    """Settings of a localizer: which sources are fused, and each step's own.

    Settings of the filter that are not given come from the robot; how wrong stamps are, and that a gyro is there, are
    learned on the way.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    sources: tuple[Source, ...] | None = Field(
        default=None, min_length=1, description="What is fused; null: all that there is."
    )
    wheels: WheelConfig = WheelConfig()
    lidar: LidarConfig = LidarConfig()
    filter: FilterConfig = FilterConfig(gate_mode="inflate", history=0.5)


def filter_for(config: LocalizerConfig, robot: RobotDescription) -> FilterConfig:
    """Return the filter's settings for a robot: its limits say how hard it accelerates, its IMU how the bias walks."""
    described: dict[str, Any] = {
        "acceleration_deviation": tuple(limit / math.sqrt(3) for limit in robot.acceleration_limits),
        **_LEARNED,
    }
    if robot.imu is not None:
        described["gyro_bias_walk"] = robot.imu.gyro_bias_walk
        described["initial_gyro_bias_deviation"] = robot.imu.gyro_bias_deviation
    given = config.filter.model_fields_set
    return config.filter.changed(**{key: value for key, value in described.items() if key not in given})
