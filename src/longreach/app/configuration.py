"""All that can be set in an estimation, one model a step; `config.yaml` of a run holds every key."""

import math
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from longreach.estimation.filter_config import FilterConfig
from longreach.measurement import Recording
from longreach.odometry.lidar import LidarConfig
from longreach.odometry.wheel import WheelConfig
from longreach.robot.description import RobotDescription
from longreach.trajectory import stamp_deviation

Source = Literal["wheels", "lidar", "imu", "fixes"]

# What the filter learns of its sensors on the way: their noise, and how wrong the scale of wheels is, where 2 % is what
# rollers creep and tyres wear.
_LEARNED = {"noise_memory": 300.0, "scale_deviation": (0.02, 0.02, 0.02)}


class EvaluationConfig(BaseModel):
    """How an estimate is held against a reference."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    align: Literal["rigid", "first", "none"] = Field(
        default="rigid", description="How the estimate is carried to the truth for ATE; Sturm et al. 2012: rigid."
    )
    distances: tuple[float, ...] = Field(default=(1.0, 5.0), description="Lengths of RPE over distance [m].")
    times: tuple[float, ...] = Field(default=(1.0, 10.0), description="Spans of RPE over time [s].")
    relations_span: float = Field(default=5.0, gt=0, description="Relations up to this span are told apart [s].")
    longest_gap: float = Field(
        default=1.0, gt=0, description="Between two rows that interpolation may bridge [s]; a lost scan or two."
    )
    truth_speed: float = Field(
        default=3.0, gt=0, description="Faster than this a reference does not move, it jumps [m/s]; indoor bases."
    )


class EstimateConfig(BaseModel):
    """Settings of an estimation: which sources are fused, and each step's own.

    Settings of the filter that are not given come from the robot and the recording; `Estimate.config` has what ran.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    sources: tuple[Source, ...] | None = Field(
        default=None, min_length=1, description="What is fused; null: all that the recording has."
    )
    wheels: WheelConfig = WheelConfig()
    lidar: LidarConfig = LidarConfig()
    filter: FilterConfig = FilterConfig(gate_mode="inflate", history=0.0)
    smooth: bool = Field(default=False, description="Whether to look back over the whole run as well: `smoothed`.")
    compare: bool = Field(
        default=False, description="Whether to run LIDAR odometry alone as well where nothing is compared with it."
    )
    evaluation: EvaluationConfig = EvaluationConfig()


def filter_for(config: EstimateConfig, robot: RobotDescription, recording: Recording) -> FilterConfig:
    """Return the filter's settings for one run.

    The robot's limits say how hard it accelerates, the scans' rhythm how far stamps can be trusted, a gyro that the
    heading is not coupled to the wheels; a pause in the recording may be as long as the recording.
    """
    stamps = [records[i].stamp for records in (recording.wheels, recording.scans) if records for i in (0, -1)]
    rhythm = np.array([record.stamp for record in recording.scans or recording.wheels])
    length = max(stamps) - min(stamps) if stamps else 0.0
    changes: dict[str, Any] = {"longest_prediction": max(config.filter.longest_prediction, length)}
    if "stamp_deviation" not in config.filter.model_fields_set:
        changes["stamp_deviation"] = stamp_deviation(rhythm)
    if "acceleration_deviation" not in config.filter.model_fields_set:
        changes["acceleration_deviation"] = tuple(limit / math.sqrt(3) for limit in robot.acceleration_limits)
    for key, value in _LEARNED.items():
        if key not in config.filter.model_fields_set:
            changes[key] = value
    if "coupled_to_wheels" not in config.filter.model_fields_set:
        gyro = bool(recording.imu) and (config.sources is None or "imu" in config.sources)
        changes["coupled_to_wheels"] = (True, True, not gyro)
    if robot.imu is not None:
        for key, value in (
            ("gyro_bias_walk", robot.imu.gyro_bias_walk),
            ("initial_gyro_bias_deviation", robot.imu.gyro_bias_deviation),
        ):
            if key not in config.filter.model_fields_set:
                changes[key] = value
    return config.filter.model_copy(update=changes)
