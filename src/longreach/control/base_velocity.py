"""The base velocity controller: holds a body twist to what the base can do, with ramps, and lets it time out."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.control import _limit_kernels

_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
_Axes = tuple[_Positive, _Positive, _Positive]
_ROOM = np.full(3, math.inf)


class BaseVelocityConfig(BaseModel):
    """Settings of the base velocity controller; the defaults are those of the Ridgeback's own."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["base_velocity"] = "base_velocity"
    velocity: _Axes = Field(default=(1.1, 1.1, 2.0), description="Top speed [m/s, m/s, rad/s].")
    acceleration: _Axes = Field(default=(2.5, 2.5, 1.0), description="Steepest ramp [m/s², m/s², rad/s²].")
    command_timeout: _Positive = Field(default=0.25, description="A twist older than this is none [s].")

    @cached_property
    def limits(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Top speeds and steepest ramps, (3,) each."""
        return np.array(self.velocity), np.array(self.acceleration)


@dataclass(frozen=True, slots=True, eq=False)
class BaseVelocityState:
    """The twist sent last, the one that was desired last, and when [s]."""

    config: BaseVelocityConfig
    stamp: float
    twist: Float[np.ndarray, "3"]
    desired: Float[np.ndarray, "3"]
    desired_stamp: float
    limited: bool = False


def init(config: BaseVelocityConfig, now: float) -> BaseVelocityState:
    """Start at rest."""
    return BaseVelocityState(config, now, np.zeros(3), np.zeros(3), now)


def step(
    state: BaseVelocityState, desired: Float[np.ndarray, "3"] | None, now: float
) -> tuple[BaseVelocityState, Float[np.ndarray, "3"]]:
    """Return the twist (3,) to send at `now` [s] for the desired one.

    The direction of the desired one is kept where its size is not. None, or numbers that are not finite: the last goes
    on until it times out, and the base ramps down.
    """
    config = state.config
    dt = min(max(now - state.stamp, 0.0), config.command_timeout)
    target, since = state.desired, state.desired_stamp
    if desired is not None and np.isfinite(desired).all():
        target, since = np.array(desired, dtype=float), now
    if now - since > config.command_timeout:
        target = np.zeros(3)
    twist = np.empty(3)
    limited = _limit_kernels.limit(target, state.twist, dt, 0.0, *config.limits, _ROOM, _ROOM, twist)
    return BaseVelocityState(config, now, twist, target, since, limited), twist
