"""PID for any number of joints: an integral that does not wind up, a derivative that does not amplify noise.

Source: Åström & Hägglund 2006, "Advanced PID Control", sections 3.2 (filter of the derivative) and 3.5 (windup:
conditional integration).
"""

from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

Gains = tuple[Annotated[float, Field(ge=0, allow_inf_nan=False)], ...]


class PidConfig(BaseModel):
    """Gains of a PID; one number for all joints, or one a joint."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    p: Gains = Field(default=(5.0,), min_length=1, description="Output for an error of 1 [1/s where it is a velocity].")
    i: Gains = Field(default=(0.0,), min_length=1, description="Output for an error of 1 that lasted 1 s.")
    d: Gains = Field(default=(0.0,), min_length=1, description="Output for an error that grows by 1 a second.")
    output_limit: tuple[Annotated[float, Field(gt=0)], ...] = Field(
        default=(1.0,), min_length=1, description="The output stays within ± this; where it is reached, i waits; ours."
    )
    derivative_time: float = Field(
        default=0.02, ge=0, allow_inf_nan=False, description="Time constant of the derivative's filter [s]; ours."
    )


class PidState(NamedTuple):
    """Integral of the error, the last error (None: there was none yet), its filtered slope; (n,) each."""

    integral: Float[np.ndarray, " n"]
    error: Float[np.ndarray, " n"] | None
    slope: Float[np.ndarray, " n"]


def init(joints: int) -> PidState:
    """Start with nothing behind."""
    return PidState(np.zeros(joints), None, np.zeros(joints))


def step(
    config: PidConfig, state: PidState, error: Float[np.ndarray, " n"], dt: float
) -> tuple[PidState, Float[np.ndarray, " n"]]:
    """Return the output (n,) for the error (n,) after dt [s]; an error that is no number is taken as none."""
    error = np.where(np.isfinite(error), error, 0.0)
    slope, integral = state.slope, state.integral
    if state.error is not None and dt > 0.0:
        slope = slope + ((error - state.error) / dt - slope) * dt / (config.derivative_time + dt)
        integral = integral + error * dt
    p, i, d, most = (np.asarray(gains) for gains in (config.p, config.i, config.d, config.output_limit))
    u = p * error + i * integral + d * slope
    winding = (np.abs(u) > most) & (u * error > 0.0)
    integral = np.where(winding, state.integral, integral)
    u = np.clip(p * error + i * integral + d * slope, -most, most)
    return PidState(integral, error, slope), u
