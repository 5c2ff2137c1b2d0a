"""What can be set in the filter, with its defaults."""

import math
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from longreach.estimation.planar.motion_model import MotionModel, WheelModel

_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Axes = tuple[_Positive, _Positive, _Positive]


class FilterConfig(BaseModel):
    """Settings of the filter; axes are in the order x, y, θ of the base."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    acceleration_deviation: _Axes = Field(
        default=(1.0, 1.0, 2.0),
        description="how hard the base accelerates, standard deviation [m/s², m/s², rad/s²]; "
        "the order of an indoor base's limits, give the robot's own where they are known",
    )
    acceleration_time_constant: _Positive = Field(
        default=0.5,
        description="how long it keeps an acceleration [s]; a start or a stop of such a base takes about that",
    )
    gyro_bias_walk: _NotNegative = Field(
        default=1e-4, description="growth of the gyro's bias [rad/s/√s]; usual for MEMS gyros"
    )
    stamp_deviation: _NotNegative | None = Field(
        default=None,
        description="how wrong stamps are, standard deviation [s]; null: a localizer learns it from the scans' rhythm",
    )
    coupled_to_wheels: tuple[bool, bool, bool] | None = Field(
        default=None,
        description="axes in which the pose shares the errors of the wheels' steps, and the motion model has no say "
        "against them; null: all, but the heading while a gyro is fused, which knows better",
    )
    scale_deviation: tuple[_NotNegative, _NotNegative, _NotNegative] = Field(
        default=(0.0, 0.0, 0.0),
        description="how wrong the wheels' scale is, in x, y and θ [1]: rollers that creep, wheels that are worn; "
        "0: not at all",
    )
    scale_reach: _Positive = Field(
        default=30.0, description="way [m] and turn [rad] over which such an error stays much the same; ours"
    )
    noise_memory: _NotNegative = Field(
        default=0.0, description="measurements over which the noise of a source is estimated [1]; 0: it is as stated"
    )
    initial_twist_deviation: _Axes = Field(
        default=(1.0, 1.0, 1.0),
        description="what is known of the twist at the start [m/s, m/s, rad/s]; a base's top speed",
    )
    initial_gyro_bias_deviation: _NotNegative = Field(
        default=0.02, description="the gyro's bias at the start [rad/s]; MEMS data sheets: 0.5-1 °/s"
    )
    gate_probability: float = Field(
        default=1.0 - 1e-4, gt=0, lt=1, description="share of good measurements that the χ² gate lets through; ours"
    )
    gate_mode: Literal["reject", "inflate", "none"] = Field(
        default="reject",
        description="beyond the gate: leave out, take with R scaled until it passes, or take as it is; ours",
    )
    gate_patience: int = Field(
        default=5,
        ge=0,
        description="measurements of a source left out in a row before the next is taken, scaled; ours",
    )
    history: _NotNegative = Field(
        default=2.0, description="how late a measurement may come [s]; 0 where all are sorted; ours"
    )
    longest_prediction: float = Field(
        default=60.0, gt=0, description="a stamp further ahead than this is not believed at once [s]; ours"
    )

    def changed(self, **changes: Any) -> "FilterConfig":
        """Return settings that differ in some, checked; the others that were given stay given."""
        given = {name: getattr(self, name) for name in self.model_fields_set}
        return FilterConfig(**{**given, **changes})

    @cached_property
    def motion(self) -> MotionModel:
        """The motion model of these settings."""
        tau, variance = self.acceleration_time_constant, np.square(self.acceleration_deviation)
        return MotionModel(tau, variance, self.gyro_bias_walk**2, self.stamp_deviation or 0.0)

    @cached_property
    def wheels(self) -> WheelModel:
        """What these settings say of the wheels' steps."""
        coupled = np.ones(3) if self.coupled_to_wheels is None else np.array(self.coupled_to_wheels, dtype=float)
        return WheelModel(coupled, np.square(self.scale_deviation), self.scale_reach)

    @cached_property
    def gates(self) -> tuple[float, float, float]:
        """The bound on the NIS of a measurement of one, two and three components."""
        if self.gate_mode == "none":
            return (math.inf, math.inf, math.inf)
        from scipy.special import gammaincinv  # the χ² quantile, without the weight of scipy.stats

        one, two, three = (2.0 * float(gammaincinv(0.5 * k, self.gate_probability)) for k in (1, 2, 3))
        return one, two, three
