"""What can be set in LIDAR odometry, with its defaults."""

from functools import cached_property
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from longreach.odometry.matchers._point_to_line_kernels import FitSettings

Method = Literal["point-to-line", "keyscan-flow", "three-scan-flow", "range-flow"]


class LidarConfig(BaseModel):
    """Parameters of LIDAR odometry; the defaults serve 180 to 1081 beams at 5 to 40 Hz."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: Method = Field(
        default="point-to-line",
        description="How scans are matched: to the surfaces of a local map, by symmetric range flow against a keyscan, "
        "or against that and the last scan, or by the range flow of 2016 from scan to scan.",
    )
    iterations: int = Field(default=20, ge=1, le=100, description="Linearisations a match at most [1].")
    gate: float = Field(default=5.0, gt=1, description="Residuals beyond this many deviations take no part [1].")
    grazing: float = Field(
        default=0.2, gt=0, description="Of the noise that a wall along the beam still sees; footprint of the beam [1]."
    )
    worst: float = Field(default=4.0, gt=0, description="Scatter of the residuals at most, in noises of a range [1].")
    flat: float = Field(default=0.01, gt=0, description="Scatter of the residuals at least: no map is better [m].")
    prior_position: float = Field(
        default=0.01, gt=0, description="Deviation of the predicted position, before what motion and time add [m]."
    )
    prior_heading: float = Field(default=0.01, gt=0, description="The same of the heading [rad].")
    prior_motion: float = Field(
        default=0.2,
        gt=0,
        description="Part of the predicted motion that it may be off by: wheels slip and lag [1].",
    )
    prior_acceleration: tuple[float, float] = Field(
        default=(1.0, 2.0), description="Accelerations that a prediction does not know of [m/s², rad/s²]."
    )
    known: float = Field(
        default=3.0, ge=1, description="Information over that from errors of the surfaces' directions alone [1]; ours."
    )
    common: float = Field(default=0.02, ge=0, description="Of the ranges' noise, the part common to all beams [1].")
    coarse: float = Field(default=0.4, gt=0, description="Radius of a surface in the first fit [m].")
    fine: float = Field(default=0.18, gt=0, description="Radius of a surface in the last fit [m].")
    distance: float = Field(default=0.25, gt=0, description="From the nearest keyframe to a new one [m]; ours.")
    turned: float = Field(
        default=1 / 18, gt=0, description="The same, as a part of the field of view that is turned by [1]; ours."
    )
    overlap: float = Field(default=0.6, gt=0, lt=1, description="Beams that the map explains at least [1]; ours.")
    speed: float = Field(default=1.0, gt=0, description="What a base may drive where scans do not tell [m/s].")
    turn: float = Field(default=1.0, gt=0, description="What a base may turn where scans do not tell [rad/s].")

    @cached_property
    def fit(self) -> FitSettings:
        """The settings of a fit, as the kernels take them."""
        return FitSettings(
            iterations=self.iterations,
            gate=self.gate,
            grazing=self.grazing,
            worst=self.worst,
            flat=self.flat,
            known=self.known,
            common=self.common,
            coarse=self.coarse,
            fine=self.fine,
        )
