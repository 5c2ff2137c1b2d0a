"""What the safety gate holds the robot to; a robot's own limits come from its hardware's capabilities."""

import math
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from longreach.control.hardware import Capabilities
from longreach.errors import ControlError

Source = Literal["wheels", "scans", "imu", "joints", "wrenches"]
_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_Bound = Annotated[float, Field(allow_inf_nan=True)]


class _Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class ArmLimits(_Settings):
    """What the arm's joints may do, one number a joint."""

    names: tuple[str, ...] = Field(description="The joints as joint states name them, in the order of commands.")
    lower: tuple[_Bound, ...] = Field(description="Least position [rad]; -.inf: none.")
    upper: tuple[_Bound, ...] = Field(description="Largest position [rad]; .inf: none.")
    velocity: tuple[_Positive, ...] = Field(description="Top speed [rad/s].")
    acceleration: tuple[_Positive, ...] = Field(description="Hardest acceleration, also when braking [rad/s²].")
    period: _Positive = Field(default=0.008, description="A commanded position is reached within this [s]; 125 Hz.")

    @model_validator(mode="after")
    def _one_number_a_joint(self) -> "ArmLimits":
        for name in ("lower", "upper", "velocity", "acceleration"):
            if len(getattr(self, name)) != len(self.names):
                raise ValueError(f"{name} has {len(getattr(self, name))} numbers for {len(self.names)} joints")
        if not all(a < b for a, b in zip(self.lower, self.upper, strict=True)):
            raise ValueError("every lower limit must be below its upper one")
        return self


class BaseLimits(_Settings):
    """What the base may do along x, y and about z."""

    velocity: tuple[_Positive, _Positive, _Positive] = Field(description="Top speed [m/s, m/s, rad/s].")
    acceleration: tuple[_Positive, _Positive, _Positive] = Field(
        description="Hardest acceleration, also when braking [m/s², m/s², rad/s²]."
    )


class SafetyConfig(_Settings):
    """Settings of the last gate before the robot."""

    arm: ArmLimits | None = Field(default=None, description="Limits of the arm; null: there is none.")
    base: BaseLimits | None = Field(default=None, description="Limits of the base; null: it is bolted down.")
    position_margin: float = Field(
        default=0.01, ge=0, allow_inf_nan=False, description="Joints stay this far within their limits [rad]; ours."
    )
    position_lag: _Positive = Field(
        default=0.3, description="A commanded position further away than this is not followed [rad]; ours."
    )
    longest_tick: _Positive = Field(
        default=0.04, description="For how long a command may last before the next [s]; five ticks at 125 Hz, ours."
    )
    command_timeout: _Positive = Field(
        default=0.25, description="What was commanded longer ago is over [s]; the Ridgeback's driver."
    )
    stale_after: dict[Source, _Positive] = Field(
        default={"joints": 0.1, "wheels": 0.2, "scans": 0.25},
        description="Sensors that must be heard, and for how long they may be silent [s]; ten periods, ours.",
    )
    heartbeat_timeout: _Positive | None = Field(
        default=None, description="For how long the client may be silent [s]; null: no client is watched."
    )
    jolt_limit: _Positive = Field(
        default=20.0,
        description="Level acceleration that is a contact of the base [m/s²]; a Husky's outdoors: 13 at most in 395 s.",
    )
    obstacles: bool = Field(default=True, description="Whether the base minds what the laser sees.")
    force_limit: _Positive = Field(
        default=100.0, description="Force on the tool that is a contact [N]; a third of the FT300's range, ours."
    )
    torque_limit: _Positive = Field(
        default=15.0, description="Torque on the tool that is a contact [N·m]; half of the FT300's range, ours."
    )
    divergence_probability: float = Field(
        default=1.0 - 1e-4, gt=0, lt=1, description="Share of good measurements whose NIS is below the bound; ours."
    )
    divergence_streak: int = Field(
        default=15, ge=1, description="Measurements of one source above it in a row that mean divergence; ours."
    )
    gripper: bool = Field(default=False, description="Whether there are fingers, which a stop halts.")
    gripper_velocity: _Positive = Field(default=1.0, description="Top speed of the fingers [1/s]; ours.")
    gripper_force: _Positive = Field(default=60.0, description="Force at the tips [N]; the Robotiq 3-finger's.")

    @cached_property
    def _bounds(self) -> tuple[float, ...]:
        from scipy.special import gammaincinv  # the χ² quantile, without the weight of scipy.stats

        return tuple(2.0 * float(gammaincinv(0.5 * k, self.divergence_probability)) for k in range(1, 16))

    def nis_bound(self, dof: int) -> float:
        """Return the bound on the NIS of a measurement of `dof` components, at most 15."""
        return self._bounds[min(dof, 15) - 1]

    @cached_property
    def arm_arrays(self) -> tuple[np.ndarray, ...]:
        """Lower and upper limits with the margin taken off, velocities, accelerations, each (n,)."""
        arm = self.arm
        if arm is None:
            return tuple(np.zeros(0) for _ in range(4))
        margin = self.position_margin
        limits = (np.array(arm.lower) + margin, np.array(arm.upper) - margin, arm.velocity, arm.acceleration)
        return tuple(np.array(limit, dtype=float) for limit in limits)

    @cached_property
    def arm_ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits themselves, each (n,)."""
        arm = self.arm
        return (np.zeros(0), np.zeros(0)) if arm is None else (np.array(arm.lower), np.array(arm.upper))

    @cached_property
    def base_arrays(self) -> tuple[np.ndarray, ...]:
        """Velocities, accelerations and endless room, each (3,)."""
        base = self.base
        if base is None:
            return tuple(np.zeros(3) for _ in range(3))
        return np.array(base.velocity), np.array(base.acceleration), np.full(3, math.inf)


def limits_of(capabilities: Capabilities, config: SafetyConfig | None = None) -> SafetyConfig:
    """Return the configuration with the limits of a robot's arm and base wherever it has none of its own.

    Raises:
        ControlError: the robot does not say how fast or how hard a joint may move.
    """
    config = config or SafetyConfig()
    changes: dict[str, ArmLimits | BaseLimits | bool] = {"gripper": config.gripper or capabilities.gripper}
    limits = capabilities.arm_limits
    if config.arm is None and capabilities.arm_names:
        for name, speed, hardest in zip(capabilities.arm_names, limits.velocity, limits.acceleration, strict=True):
            if not (0.0 < speed < math.inf and 0.0 < hardest < math.inf):
                raise ControlError(
                    f"{name} may move at {speed:g} rad/s and {hardest:g} rad/s²; "
                    "give the robot's description a velocity and an acceleration that are finite."
                )
        changes["arm"] = ArmLimits(
            names=capabilities.arm_names,
            lower=tuple(limits.lower.tolist()),
            upper=tuple(limits.upper.tolist()),
            velocity=tuple(limits.velocity.tolist()),
            acceleration=tuple(limits.acceleration.tolist()),
            period=1.0 / capabilities.arm_rate,
        )
    if config.base is None and capabilities.base_velocity is not None and capabilities.base_acceleration is not None:
        changes["base"] = BaseLimits.model_validate(
            {"velocity": capabilities.base_velocity.tolist(), "acceleration": capabilities.base_acceleration.tolist()}
        )
    return config.model_copy(update=changes)
