"""What can be set in LIDAR odometry, with its defaults."""

from functools import cached_property
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from longreach.odometry import _match_kernels

Method = Literal["point-to-line", "keyscan-flow", "three-scan-flow", "range-flow"]


class LidarConfig(BaseModel):
    """Parameters of LIDAR odometry; the defaults serve 180 to 1081 beams at 5 to 40 Hz."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: Method = Field(
        default="point-to-line",
        description="How scans are matched: to the lines of a keyframe, by symmetric range flow against a keyscan, or "
        "against that and the last scan, or by the range flow of 2016 from scan to scan.",
    )
    iterations: int = Field(default=20, ge=1, le=100, description="Linearisations a match at most [1].")
    gate: float = Field(default=4.0, gt=1, description="Residuals beyond this many deviations take no part [1].")
    grazing: float = Field(
        default=0.2, gt=0, description="Of the noise that a wall along the beam still sees; footprint of the beam [1]."
    )
    worst: float = Field(default=4.0, gt=0, description="Scatter of the residuals at most, in noises of a range [1].")
    doubt: float = Field(default=0.1, gt=0, description="Deviation of a guess [m, rad], and 0.3 of the motion.")
    known: float = Field(default=15.0, ge=1, description="Information over that from errors of lines alone [1]; ours.")
    common: float = Field(default=0.02, ge=0, description="Of the ranges' noise, the part common to all beams [1].")
    distance: float = Field(default=0.7, gt=0, description="From a keyframe to the next [m]; ours.")
    angle: float = Field(default=0.6, gt=0, description="From a keyframe to the next [rad]; ours.")
    overlap: float = Field(default=0.6, gt=0, lt=1, description="Beams that a keyframe explains at least [1]; ours.")
    speed: float = Field(default=1.0, gt=0, description="What a base may drive where scans do not tell [m/s].")
    turn: float = Field(default=1.0, gt=0, description="What a base may turn where scans do not tell [rad/s].")

    @cached_property
    def lines(self) -> _match_kernels.LineSettings:
        """The same as the kernels take it."""
        return _match_kernels.LineSettings(
            iterations=self.iterations,
            gate=self.gate,
            grazing=self.grazing,
            worst=self.worst,
            agree=1.0,
            known=self.known,
            common=self.common,
        )
