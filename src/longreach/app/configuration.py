"""All that can be set in an estimation, one model a step; `config.yaml` of a run holds every key."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from longreach.localization.config import LocalizerConfig


class EvaluationConfig(BaseModel):
    """How an estimate is held against a reference."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    align: Literal["rigid", "first", "none"] = Field(
        default="rigid", description="How the estimate is carried to the truth for ATE; Sturm et al. 2012: rigid."
    )
    distances: tuple[float, ...] = Field(default=(1.0, 5.0), description="Lengths of RPE over distance [m].")
    times: tuple[float, ...] = Field(default=(1.0, 10.0), description="Spans of RPE over time [s].")
    relations_span: float = Field(default=5.0, gt=0, description="Relations up to this span are grouped [s].")
    longest_gap: float = Field(
        default=1.0, gt=0, description="Between two rows that interpolation may bridge [s]; a lost scan or two."
    )
    truth_speed: float = Field(
        default=3.0, gt=0, description="Faster than this a reference does not move, it jumps [m/s]; indoor bases."
    )


class EstimateConfig(LocalizerConfig):
    """Settings of an estimation: those of the localizer, and what is made of a recording besides."""

    smooth: bool = Field(default=False, description="Whether to look back over the whole run as well: `smoothed`.")
    compare: bool = Field(
        default=False, description="Whether to run LIDAR odometry alone as well where nothing is compared with it."
    )
    evaluation: EvaluationConfig = EvaluationConfig()
