"""Wheel odometry: what the wheels did between two records as a motion of the base, and how wrong that may be.

Each motion is the SE(2) exponential of a body displacement ξ, the motion at a constant twist; the driver of the
thesis' base integrates by backward Euler.

**How wrong.** `constant` is the thesis' (3.23). The default, `growing`, says that on the way errors arise at random
whose variance is in proportion to the distance d and to the angle φ turned (`robot.description.WheelNoise`),

    along the direction of travel  along² d + turning² φ + rest² dt,    across it  across² d + turning² φ + rest² dt,
    heading  heading_travel² d + heading_turning² φ + heading_rest² dt,

and carries each to the end of the step, Q = ∫ Ad(exp(-sξ)) (…) Ad(exp(-sξ))ᵀ ds. That is where the cross terms come
from: on a straight line cov(y, θ) = d/2 · var θ, because an early error of the heading has become one of y. So it makes
no difference into how many records a motion is cut.

Where four wheels disagree about three velocities they slip. The part that no motion explains (`residual_matrix`), as
the distance ρ over the last `slip_window`, is what the explained parts are taken to be wrong by: ρ² for x and for y and
(ρ/k)² for θ in each window. The window keeps the rounding of an encoder's counts, which comes and goes from record to
record, from being counted each time.

How that fares with one set of numbers, as the root of the mean NEES per degree of freedom (1: as wrong as it says):
1.0 on the Intel log's relations of up to 5 s; 1.0 across and 0.8 in heading on those of ACES; 1.0 to 1.8 on the mecanum
base of polimi over 1 to 10 s, whose nominal wheels are known to be 5 % off, which no random error describes.

Source: (3.19)–(3.23); Chong & Kleeman 1997, "Accurate odometry and error modelling for a mobile robot".
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.errors import EstimationError
from longreach.geometry import se2
from longreach.measurement import (
    Odometry,
    RelativePoseMeasurement,
    Wheels,
    WheelSpeeds,
    WheelTicks,
    frozen_array,
)
from longreach.odometry import _relative_kernels, _wheel_kernels
from longreach.robot.description import RobotDescription, WheelNoise

_Kind = Literal["ticks", "speeds", "pose", "twist"]
_FLOOR = 1e-10  # [m², rad²], of a reading: a hundredth of a millimetre keeps covariances definite
_Variance = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class WheelConfig(BaseModel):
    """Settings of wheel odometry; how noisy a robot's wheels are stands in its description."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    covariance: Literal["growing", "constant"] = Field(
        default="growing", description="growing with motion; constant: (3.23), whatever the robot does."
    )
    twist_variance: tuple[_Variance, _Variance, _Variance] = Field(
        default=(0.001, 0.001, 0.03), description="Of one twist, where constant [m²/s², m²/s², rad²/s²]; (3.23)."
    )
    twist_rate: _Variance = Field(
        default=50.0, description="Twists a second that (3.23) was found at [Hz]; the Ridgeback's."
    )
    break_factor: float = Field(
        default=3.0,
        gt=1,
        description="A motion this many times faster than the robot can go is a counter that jumped [1]; ours.",
    )
    longest_gap: float = Field(
        default=1.0, gt=0, description="Speeds further apart in time say nothing of what was between them [s]; ours."
    )
    slip_window: float = Field(
        default=0.1, gt=0, description="How long a slip lasts [s]; a wheel regains its grip in that."
    )


@dataclass(frozen=True, eq=False)
class WheelOdometry:
    """Motions from record to record (`source` wheels), and what was left out.

    breaks: steps that no wheel can have made, or across too long a gap; no measurement bridges them.
    refused: records with a number that is not finite; the step goes past them.
    slip: for each measurement the speed (n,) [m/s] at which the wheels disagree, None where nothing can tell.
    """

    measurements: tuple[RelativePoseMeasurement, ...]
    breaks: int = 0
    refused: int = 0
    slip: Float[np.ndarray, " n"] | None = None


def wheel_odometry(
    wheels: Sequence[Wheels], robot: RobotDescription, config: WheelConfig | None = None, after: float = -np.inf
) -> WheelOdometry:
    """Turn wheel records into relative poses of the base with their covariance, one a step that ends after `after` [s].

    Counts and angles are differenced. Of speeds and twists, which hold for an instant, the mean of the two at a step's
    ends is taken for the step (trapezoid): right to second order, where the last one alone would lag half a step. Poses
    that a driver made are taken relative to each other; its twists only where it gives no poses.
    Of records with one stamp the last is used.

    Raises:
        EstimationError: the records are of several kinds or out of order, or the description has no such wheels.
    """
    config = config or WheelConfig()
    if not wheels:
        return WheelOdometry(())
    kind, stamps, values, refused = _read(wheels)
    if len(stamps) < 2:
        return WheelOdometry((), refused=refused)
    dt = np.diff(stamps)
    xi, residual = _displacements(kind, values, dt, robot)
    good = _possible(xi, dt, robot, config) & ((dt <= config.longest_gap) | (kind in ("ticks", "pose")))
    n, base, slip = len(xi), robot.base, None
    rate, span, Q = np.zeros(n), np.zeros(n), np.empty((n, 3, 3))
    if residual is not None and base is not None:
        _wheel_kernels.slipped(residual, good, stamps, config.slip_window, rate, span)
        slip = rate
    if config.covariance == "growing":
        lever = 1.0 if base is None else base.lever
        _wheel_kernels.growing(xi, stamps, _numbers(robot.wheel_noise), rate, span, lever, Q)
        R = np.empty((n, 3, 3))
        _wheel_kernels.readings(xi, good, _rounding(kind, robot), R)
    else:
        _relative_kernels.spread_all(xi, _constant(dt, config), Q)
        R = [None] * n
    poses, clock, rows = se2.exp(xi), stamps.tolist(), np.flatnonzero(good & (stamps[1:] > after))
    measurements = tuple(
        RelativePoseMeasurement(clock[i], clock[i + 1], poses[i], Q[i], "wheels", R[i]) for i in rows.tolist()
    )
    slip = None if slip is None else frozen_array(slip[rows], (None,), "WheelOdometry.slip")
    return WheelOdometry(measurements, int(np.count_nonzero(~good)), refused, slip)


def _read(wheels: Sequence[Wheels]) -> tuple[_Kind, np.ndarray, np.ndarray, int]:
    """Return what the records hold, increasing stamps (n,), the values (n, …), and how many were not finite."""
    kind, rows = _rows(wheels)
    if len(set(map(len, rows))) > 1:
        raise EstimationError("The wheel records are of changing length; each must have one number a wheel.")
    stamps, values = np.array([w.stamp for w in wheels]), np.array(rows)
    use = np.empty(len(stamps), dtype=np.bool_)
    refused, backwards = _wheel_kernels.usable(stamps, values, use)
    if backwards:
        raise EstimationError("The stamps of the wheel records run backwards; repair them with monotone_clock.")
    return kind, stamps[use], values[use], refused


def _rows(wheels: Sequence[Wheels]) -> tuple[_Kind, list[np.ndarray]]:
    if all(isinstance(w, WheelTicks) for w in wheels):
        return "ticks", [w.ticks for w in wheels if isinstance(w, WheelTicks)]
    if all(isinstance(w, WheelSpeeds) for w in wheels):
        return "speeds", [w.speeds for w in wheels if isinstance(w, WheelSpeeds)]
    driver = [w for w in wheels if isinstance(w, Odometry)]
    if len(driver) < len(wheels):
        raise EstimationError("The wheel records are of several kinds; use only ticks, only speeds or only odometry.")
    poses = [w.pose for w in driver if w.pose is not None]
    twists = [w.twist for w in driver if w.twist is not None]
    if len(poses) == len(driver):
        return "pose", poses
    if len(twists) == len(driver):
        return "twist", twists
    raise EstimationError("Neither a pose nor a twist is in every odometry record; use those that have one.")


def _displacements(
    kind: _Kind, values: np.ndarray, dt: np.ndarray, robot: RobotDescription
) -> tuple[np.ndarray, np.ndarray | None]:
    """Return body displacements ξ (n, 3) [m, m, rad], and how far (n,) [m] the wheels disagree, or None."""
    if kind == "pose":
        return se2.difference(values[:-1], values[1:]), None
    if kind == "twist":
        return 0.5 * (values[:-1] + values[1:]) * dt[:, None], None
    base = robot.base
    if base is None:
        raise EstimationError(f"The recording has wheel {kind}, but the description of {robot.name} has no base.")
    if values.shape[1] != len(base.wheel_names):
        raise EstimationError(
            f"A wheel record has {values.shape[1]} numbers, but {robot.name} has {len(base.wheel_names)} wheels: "
            f"{', '.join(base.wheel_names)}."
        )
    if kind == "speeds":
        turned = 0.5 * (values[:-1] + values[1:]) * dt[:, None]
    else:
        turned = _counted(np.diff(values, axis=0), robot)
    residual = turned @ base.residual_matrix.T
    return turned @ base.forward_matrix.T, residual[:, 0] if residual.shape[1] else None  # (3.21)


def _counted(steps: np.ndarray, robot: RobotDescription) -> np.ndarray:
    """Return the wheels' turns [rad] from differences of their counters, which may have wrapped."""
    encoder = robot.encoder
    if encoder is None:
        raise EstimationError(f"The recording has wheel ticks, but the description of {robot.name} has no encoder.")
    if encoder.bits is not None:
        turn = 2.0**encoder.bits
        steps = steps - turn * np.round(steps / turn)
    return steps * encoder.radians_per_tick


def _possible(xi: np.ndarray, dt: np.ndarray, robot: RobotDescription, config: WheelConfig) -> np.ndarray:
    """Return which steps (n,) a robot can make; shorter ones than usual, late messages, count as usual ones."""
    usual = np.sort(dt)[(len(dt) - 1) // 2]
    most = np.outer(np.maximum(dt, usual), config.break_factor * np.array(robot.velocity_limits))
    return np.all(np.abs(xi) <= most, axis=1)


def _constant(dt: np.ndarray, config: WheelConfig) -> np.ndarray:
    """Return the variance (n, 3, 3) of the integral over dt of twists whose errors are independent at `twist_rate`."""
    return dt[:, None, None] / config.twist_rate * np.diag(config.twist_variance)  # (3.23)


def _numbers(noise: WheelNoise) -> tuple[float, ...]:
    return (
        noise.along,
        noise.across,
        noise.turning,
        noise.heading_travel,
        noise.heading_turning,
        noise.rest,
        noise.heading_rest,
    )


def _rounding(kind: _Kind, robot: RobotDescription) -> np.ndarray:
    """Return the variance (3,) of a reading by its counter's rounding, or a floor that keeps covariances definite.

    A reading has another error, its age: a message holds the last state of a counter that was read at some time since
    the message before, so the age is evenly spread over one step, with a mean square of ξξᵀ/3, ξξᵀ the mean over the
    step to the reading and the one before. (In CARMEN's logs the pose beside a scan is just that: the last one of the
    wheels' own messages, up to 0.2 s old.)
    """
    rounding = np.full(3, _FLOOR)
    base, encoder = robot.base, robot.encoder
    if kind == "ticks" and base is not None and encoder is not None and encoder.resolution is not None:
        rounding += np.sum(base.forward_matrix**2, axis=1) * encoder.resolution**2 / 12
    return rounding
