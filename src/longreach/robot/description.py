"""A robot as data: its base and encoders, where its sensors sit, what its topics are, where its arm is described."""

import math
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, model_validator

from longreach.geometry import se3, so3
from longreach.robot.bases import Base
from longreach.robot.dh import DhRow

_Positive = Annotated[float, Field(gt=0)]
_Axes = tuple[_Positive, _Positive, _Positive]


class _Described(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Mount(_Described):
    """Where a sensor sits in base_link: position [m] and roll, pitch, yaw [rad] as in URDF."""

    x: float = Field(default=0.0, description="Forward [m].")
    y: float = Field(default=0.0, description="To the left [m].")
    z: float = Field(default=0.0, description="Up [m].")
    roll: float = Field(default=0.0, description="About x [rad].")
    pitch: float = Field(default=0.0, description="About y [rad].")
    yaw: float = Field(default=0.0, description="About z [rad].")

    def matrix(self) -> Float[np.ndarray, "4 4"]:
        """Return T_base_sensor."""
        R = so3.from_roll_pitch_yaw(self.roll, self.pitch, self.yaw)
        return se3.from_rotation_translation(R, np.array([self.x, self.y, self.z]))


class Encoder(_Described):
    """What a wheel's message holds: encoder counts, or a wheel's angle [rad] or speed [rad/s] already made of them."""

    signal: Literal["ticks", "angle", "speed"] = Field(
        default="angle",
        description="ticks: counts; angle: JointState position [rad]; speed: JointState velocity [rad/s].",
    )
    counts_per_revolution: _Positive | None = Field(
        default=None, description="Counts a turn of the encoder's shaft [1]."
    )
    gear: float = Field(default=1.0, gt=0, description="Turns of the encoder's shaft a turn of the wheel [1].")
    bits: int | None = Field(
        default=None,
        ge=8,
        le=52,
        description="The counter wraps at 2^bits; None: as wrap_range says.",
    )
    wrap_range: _Positive | None = Field(
        default=None,
        description="Readings start again after this much [rad or counts]; None: found, where steps are small.",
    )

    @model_validator(mode="after")
    def _ticks_have_a_size(self) -> "Encoder":
        if self.bits is not None and self.wrap_range is not None:
            raise ValueError("give either bits or wrap_range")
        if self.signal == "ticks" and self.counts_per_revolution is None:
            raise ValueError("an encoder whose signal is ticks needs counts_per_revolution")
        return self

    @property
    def range(self) -> float:
        """What readings start again after [rad or counts]; 0 where it is not stated."""
        return self.wrap_range or (0.0 if self.bits is None else 2.0**self.bits)

    @property
    def resolution(self) -> float | None:
        """Turn of the wheel a count [rad], where it is known."""
        if self.counts_per_revolution is None:
            return None
        return 2 * math.pi / (self.counts_per_revolution * self.gear)

    @property
    def radians_per_tick(self) -> float:
        """Turn of the wheel [rad] for a step of one in what the message holds; 1 where that is an angle or a speed."""
        return self.resolution if self.signal == "ticks" and self.resolution is not None else 1.0


class WheelNoise(_Described):
    """How wrong wheels are: the error's variance grows in proportion to the distance and to the angle turned.

    Each number is the standard deviation after one metre, one radian or one second; after n of them it is √n times
    that, whatever the rate of the samples (Chong & Kleeman 1997, Siegwart & Nourbakhsh 2004, section 5.2.4).
    One set serves all robots: where particle filters for indoor bases start (MRPT's Gaussian motion model: 1 % of the
    distance, 5 % of the angle, 1° a metre), made larger until four real logs agree (see `longreach.odometry.wheel`).
    """

    along: float = Field(default=0.02, ge=0, description="In the direction of travel, after 1 m [m/√m].")
    across: float = Field(default=0.015, ge=0, description="Across it, after 1 m [m/√m].")
    turning: float = Field(
        default=0.03, ge=0, description="In any direction, after a turn of 1 rad [m/√rad]; wheels scrub."
    )
    heading_travel: float = Field(default=0.03, ge=0, description="Of the heading, after 1 m [rad/√m].")
    heading_turning: float = Field(default=0.07, ge=0, description="Of the heading, after a turn of 1 rad [rad/√rad].")
    rest: float = Field(
        default=1e-4, gt=0, description="Of the position after 1 s of standing [m/√s]; keeps Σ definite."
    )
    heading_rest: float = Field(
        default=1e-4, gt=0, description="Of the heading after 1 s of standing [rad/√s]; likewise."
    )


class Lidar(_Described):
    """A planar laser scanner; ranges and angles here stand in where a recording does not say them."""

    frame: str | None = Field(default=None, description="Its frame in the recording's tf.")
    mount: Mount | None = Field(
        default=None, description="T_base_laser; None: from the recording's tf, else the identity."
    )
    range_min: float | None = Field(default=None, ge=0, description="Smaller ranges are no returns [m].")
    range_max: float | None = Field(default=None, gt=0, description="Larger ranges are no returns [m].")
    angle_min: float | None = Field(default=None, description="Angle of the first beam [rad].")
    angle_increment: float | None = Field(default=None, description="From one beam to the next [rad].")


class ImuSensor(_Described):
    """An inertial measurement unit; the defaults are those of a usual MEMS unit on wheels, read at 50 to 200 Hz."""

    frame: str | None = Field(default=None, description="Its frame in the recording's tf.")
    mount: Mount | None = Field(
        default=None, description="T_base_imu; None: from the recording's tf, else the identity."
    )
    gyro_deviation: float = Field(
        default=0.01,
        gt=0,
        description="Of one reading [rad/s]; data sheets: 0.01 °/s/√Hz, 0.002 at 100 Hz; vibration the rest.",
    )
    gyro_bias_deviation: float = Field(
        default=0.02, ge=0, description="Of the bias when switched on [rad/s]; data sheets: 0.5 to 1 °/s."
    )
    gyro_bias_walk: float = Field(
        default=1e-4, ge=0, description="Growth of the bias [rad/s/√s]; usual for MEMS gyros."
    )
    acceleration_deviation: float = Field(
        default=0.5, gt=0, description="Of one reading [m/s²]; a tilt of 2° alone is 0.34 m/s², vibration comes on top."
    )


class Topics(_Described):
    """Names of the topics in a recording; None: the only one of the right type."""

    wheels: str | None = Field(default=None, description="JointState or Odometry of the wheels.")
    lidar: str | None = Field(default=None, description="LaserScan.")
    imu: str | None = Field(default=None, description="Imu.")
    truth: str | None = Field(default=None, description="Reference pose, for evaluation alone.")
    fixes: str | None = Field(default=None, description="Absolute poses of the base that may be fused.")
    joints: str | None = Field(default=None, description="JointState of the arm.")
    wrench: str | None = Field(default=None, description="WrenchStamped of the sensor at the wrist.")


class AttachedFrame(Mount):
    """A frame that stands in another one of the robot."""

    parent: str = Field(description="The frame it stands in.")


class Arm(_Described):
    """The joints beyond the base, from a URDF file beside the description or from a DH table."""

    urdf: str | None = Field(default=None, description="The URDF's file; its root is the base's frame.")
    end: str | None = Field(default=None, description="The link where the chain ends; None: the only one there is.")
    dh: tuple[DhRow, ...] | None = Field(default=None, description="Rows of (3.7) from base_link on, instead.")
    accelerations: tuple[_Positive, ...] | None = Field(
        default=None, description="Hardest acceleration of each joint [rad/s² or m/s²], which a URDF cannot say."
    )

    home: tuple[float, ...] | None = Field(
        default=None, description="Where the joints are at the start, the arm's [rad or m]; None: at 0."
    )

    @model_validator(mode="after")
    def _one_says_the_chain(self) -> "Arm":
        if (self.urdf is None) == (self.dh is None):
            raise ValueError("give either urdf or dh")
        return self


class RobotDescription(_Described):
    """One robot: what the estimation of its base has to know, and where its arm is described."""

    name: str = Field(description="What the robot is called.")
    base: Annotated[Base, Field(discriminator="kind")] | None = Field(
        default=None, description="Wheels; None where the robot's own driver has made poses or twists of them."
    )
    drive: Literal["omnidirectional", "differential"] | None = Field(
        default=None, description="Whether the robot can move sideways, where no base says it; None: it can."
    )
    encoder: Encoder | None = Field(default=None, description="What the wheels' messages hold.")
    wheel_noise: WheelNoise = Field(default=WheelNoise(), description="How wrong its wheels are.")
    lidar: Lidar | None = Field(default=None, description="Planar laser scanner.")
    imu: ImuSensor | None = Field(default=None, description="Inertial measurement unit.")
    arm: Arm | None = Field(default=None, description="The joints beyond the base; None: it has none.")
    bolted: bool = Field(default=False, description="It stands in the world and q has no x, y, θ.")
    frames: dict[str, AttachedFrame] = Field(default={}, description="Frames beside those of the URDF.")
    tool: str | None = Field(default=None, description="The frame that planning moves; None: where the arm ends.")
    topics: Topics = Field(default=Topics(), description="Names of the topics in a recording.")
    reach: _Axes = Field(
        default=(10.0, 10.0, 2 * math.pi), description="Plans keep the base's x, y, θ within ± this [m, m, rad]; ours."
    )
    velocity_limits: _Axes = Field(
        default=(1.5, 1.5, 3.0), description="Top speed [m/s, m/s, rad/s]; of usual indoor bases, give the robot's own."
    )
    acceleration_limits: _Axes = Field(
        default=(3.0, 3.0, 6.0), description="Hardest acceleration [m/s², m/s², rad/s²]; likewise."
    )

    @model_validator(mode="after")
    def _one_says_the_drive(self) -> "RobotDescription":
        if self.base is not None and self.drive is not None:
            raise ValueError("give base or drive, not both: a base says itself whether it moves sideways")
        return self

    @property
    def holonomic(self) -> bool:
        """Whether the base can move sideways."""
        return self.drive != "differential" if self.base is None else self.base.kind in ("mecanum", "omni")
