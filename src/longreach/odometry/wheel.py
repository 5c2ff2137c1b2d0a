"""Wheel odometry: the base's motion between two wheel records, with its covariance.

`init` and `step` take the records of one robot as they come; `wheel_odometry` is one `step` over a recording. Results
do not depend on how records are divided into calls, to the last bit. Sources: (3.19)–(3.23); Chong & Kleeman 1997,
"Accurate odometry and error modelling for a mobile robot". Figures of its consistency are in docs/estimation.md.

**Motion.** A step is the SE(2) exponential of a body displacement ξ: counts and angles are differenced, of speeds and
twists the mean of both ends is taken (trapezoid rule), poses of a robot's own driver are taken relative to each other.

**Covariance.** `constant` is (3.23). `growing` is a random walk over the distance d and the angle φ (`WheelNoise`),

    along the direction of travel  along² d + turning² φ + rest² dt,    across it  across² d + turning² φ + rest² dt,
    heading  heading_travel² d + heading_turning² φ + heading_rest² dt,

carried to the end of the step, Q = ∫ Ad(exp(-sξ)) (…) Ad(exp(-sξ))ᵀ ds, so that it does not depend on the number of
records in a motion. Where four wheels disagree, they slip: the part of their motion that no twist explains
(`residual_matrix`) is summed to ρ over `slip_window`, and adds ρ² for x, y and (ρ/k)² for θ in each window.

**Reading covariance.** An encoder reading has an error that does not add up: rounding, and an age that is uniform over
a step, of mean square ξξᵀ/3; the mean of the step to the reading and the one before.

**Breaks.** A step `break_factor` times faster than the robot can be is no motion, and no measurement bridges it. Delays
move stamps, so a step may take the mean interval of the last 50 where its own is shorter.

**Wrapping.** Angles may start again after 2π and counts after 2^16 or 2^32, signed or not. Where no wheel can turn by
half of that in a step, the first jump shows it, and readings are continued. `encoder.wrap_range` or `bits` state it.

Records with numbers that are not finite (`refused`) or a stamp before the newest (`late`) are passed over and counted;
of records with one stamp the first is used. No motion is lost thereby: the next step starts from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.errors import EstimationError
from longreach.measurement import Odometry, RelativePoseMeasurement, Wheels, WheelSpeeds, frozen_array
from longreach.odometry import _wheel_kernels
from longreach.odometry._wheel_kernels import COUNTS, POSES, RATES, Model
from longreach.robot.bases import AckermannBase
from longreach.robot.description import RobotDescription

_FLOOR = 1e-10  # [m², rad²], of a reading: a hundredth of a millimetre keeps covariances definite
_ANGLES, _TICKS = (2 * np.pi,), (2.0**16, 2.0**32)  # ranges after which readings may start again [rad], [counts]
_Variance = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class WheelConfig(BaseModel):
    """Settings of wheel odometry; a robot's own wheel noise is in its description."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    covariance: Literal["growing", "constant"] = Field(default="growing", description="With motion; or as of (3.23).")
    twist_variance: tuple[_Variance, _Variance, _Variance] = Field(
        default=(0.001, 0.001, 0.03), description="Of one twist, where constant [m²/s², m²/s², rad²/s²]; (3.23)."
    )
    twist_rate: _Variance = Field(default=50.0, description="Twists a second that (3.23) was found at [Hz].")
    break_factor: float = Field(default=3.0, gt=1, description="Over a robot's speed, an encoder's fault [1]; ours.")
    longest_gap: float = Field(default=1.0, gt=0, description="Between speeds that show the motion [s]; ours.")
    slip_window: float = Field(default=0.1, gt=0, description="How long a slip lasts until a wheel grips again [s].")


class _Signal(NamedTuple):
    """What the records of one stream hold: `field` of each `record`, `width` numbers, and how they become steps."""

    record: type
    field: str
    width: int
    model: Model


class WheelState(NamedTuple):
    """What wheel odometry knows after the newest record. Arrays are read-only.

    signal: what the records hold, fixed by the first one; None before it.
    stamps (k,) [s], disagreement (k,) [m]: of the records in the slip window, and of the wheels in the steps to them.
    values (1, w): numbers of the newest record. displacement (3,): ξ of the last step [m, m, rad], zeros at a break.
    interval, intervals: mean interval between records [s], and how many there were.
    seen (4,): least and greatest count, the range after which counts were found to start again (0: none), and how often
    they did. breaks: steps that no wheel made, or of speeds across too long a gap. refused, late: records that are
    passed over.
    """

    robot: RobotDescription
    config: WheelConfig
    signal: _Signal | None = None
    stamps: np.ndarray = frozen_array([], (0,), "WheelState.stamps")
    disagreement: np.ndarray = frozen_array([], (0,), "WheelState.disagreement")
    values: np.ndarray = frozen_array([[]], (1, 0), "WheelState.values")
    displacement: np.ndarray = frozen_array([0.0] * 3, (3,), "WheelState.displacement")
    seen: np.ndarray = frozen_array([np.inf, -np.inf, 0.0, 0.0], (4,), "WheelState.seen")
    interval: float = 0.0
    intervals: int = 0
    breaks: int = 0
    refused: int = 0
    late: int = 0


@dataclass(frozen=True, eq=False)
class WheelOdometry:
    """Wheel odometry of a whole recording: steps (`source` wheels), and what was left out.

    breaks, refused: as in `WheelState`. wraps: how often readings of wheels started again after `wrap_range` [counts or
    rad], where the description does not say so. slip (n,): speed [m/s] over each one's window, None where not observed.
    """

    measurements: tuple[RelativePoseMeasurement, ...]
    breaks: int = 0
    refused: int = 0
    wraps: int = 0
    wrap_range: float = 0.0
    slip: Float[np.ndarray, " n"] | None = None


def init(robot: RobotDescription, config: WheelConfig | None = None) -> WheelState:
    """Start before the first record."""
    return WheelState(robot, config or WheelConfig())


def step(state: WheelState, records: Sequence[Wheels]) -> tuple[WheelState, tuple[RelativePoseMeasurement, ...]]:
    """Take new records, in order of their stamps; return the steps that they end.

    All records are of the kind of the first one, which fixes what is read: of an `Odometry` the pose, if it has one.
    Raises EstimationError where they are of several kinds, or the description has no such wheels.
    """
    state, steps, _ = _advance(state, records)
    return state, steps


def wheel_odometry(
    wheels: Sequence[Wheels], robot: RobotDescription, config: WheelConfig | None = None
) -> WheelOdometry:
    """Turn the wheel records of a recording into steps; raise EstimationError as `step`, or if out of order."""
    state, steps, slip = _advance(init(robot, config), wheels)
    if state.late:
        raise EstimationError("The stamps of the wheel records run backwards; repair them with monotone_clock.")
    return WheelOdometry(steps, state.breaks, state.refused, int(state.seen[3]), float(state.seen[2]), slip)


def _advance(
    state: WheelState, records: Sequence[Wheels]
) -> tuple[WheelState, tuple[RelativePoseMeasurement, ...], np.ndarray | None]:
    """Return the state after the records, the steps that they end, and the slip speed (n,) [m/s] of each step."""
    if not records:
        return state, (), None
    signal = state.signal or _signal(records[0], state.robot, state.config)
    stamps, values = _numbers(records, signal)
    known, n = len(state.stamps), len(records)
    stamps = np.concatenate((state.stamps, stamps))
    disagreement = np.concatenate((state.disagreement, np.zeros(n)))
    values = np.concatenate((state.values if known else np.zeros((1, signal.width)), values))
    displacement, seen = state.displacement.copy(), state.seen.copy()
    ends, poses, Q, R, slip = np.empty((2, n)), np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3, 3)), np.zeros(n)
    memory = (known, stamps, disagreement, values, displacement, seen, state.interval, state.intervals)
    count, first, last, interval, intervals, refused, late, breaks = _wheel_kernels.advance(
        signal.model, *memory, ends, poses, Q, R, slip
    )
    arrays = (stamps[first : last + 1], disagreement[first : last + 1], values[:1], displacement, seen)
    memory = (*[frozen_array(a, a.shape, "WheelState") for a in arrays], interval, intervals)
    left_out = (state.breaks + breaks, state.refused + refused, state.late + late)
    state = WheelState._make((state.robot, state.config, signal, *memory, *left_out))
    starts, stops = ends[:, :count].tolist()
    rows = zip(starts, stops, poses, Q, R if signal.model.growing else [None] * count, strict=False)
    steps = tuple([RelativePoseMeasurement(start, stop, T, q, "wheels", r) for start, stop, T, q, r in rows])
    return state, steps, frozen_array(slip[:count], (None,), "slip") if len(signal.model.residual) else None


def _signal(record: Wheels, robot: RobotDescription, config: WheelConfig) -> _Signal:
    """Return what a stream holds that starts with `record`, and how its records become steps."""
    if isinstance(record, Odometry):
        if record.pose is None and record.twist is None:
            raise EstimationError("Neither a pose nor a twist is in every odometry record; use those that have one.")
        field, kind = ("twist", RATES) if record.pose is None else ("pose", POSES)
        return _Signal(Odometry, field, 3, _model(kind, np.eye(3), np.empty(0), 1.0, robot, config))
    field, kind = ("speeds", RATES) if isinstance(record, WheelSpeeds) else ("ticks", COUNTS)
    base, width, unit = robot.base, len(getattr(record, field)), 1.0
    if base is None:
        raise EstimationError(f"The recording has wheel {field}, but the description of {robot.name} has no base.")
    if width != len(base.wheel_names):
        raise EstimationError(
            f"A wheel record has {width} numbers, but {robot.name} has {len(base.wheel_names)} wheels: "
            f"{', '.join(base.wheel_names)}."
        )
    if kind == COUNTS:
        if robot.encoder is None:
            raise EstimationError(f"The recording has wheel ticks, but the description of {robot.name} has no encoder.")
        unit = robot.encoder.radians_per_tick
    model = _model(kind, base.forward_matrix, base.residual_matrix.ravel(), unit, robot, config)
    return _Signal(type(record), field, width, model)


def _model(
    kind: int, forward: np.ndarray, residual: np.ndarray, unit: float, robot: RobotDescription, config: WheelConfig
) -> Model:
    """Return the numbers that steps are computed with; `unit` [rad] of one count."""
    encoder, base, noise = robot.encoder, robot.base, robot.wheel_noise
    travel = [noise.along, noise.across, noise.turning, noise.heading_travel, noise.heading_turning]
    rounding, ranges, fastest = np.full(3, _FLOOR), (), 0.0
    wrap = 0.0 if encoder is None else encoder.range
    if kind == COUNTS and encoder is not None:
        if encoder.resolution is not None:
            rounding += np.sum(forward**2, axis=1) * encoder.resolution**2 / 12
        if wrap == 0.0 and base is not None:
            ranges = _TICKS if encoder.signal == "ticks" else _ANGLES
            fastest = float(np.max(np.abs(base.inverse_matrix) @ robot.velocity_limits)) / unit
    return Model(
        signal=kind,
        forward=frozen_array(forward, (3, None), "Model.forward"),
        residual=frozen_array(residual, (None,), "Model.residual"),
        wheelbase=base.wheelbase if kind != POSES and isinstance(base, AckermannBase) and forward.shape[1] > 1 else 0.0,
        unit=unit,
        wrap=wrap,
        ranges=frozen_array(ranges, (None,), "Model.ranges"),
        fastest=fastest,
        bounds=frozen_array(config.break_factor * np.array(robot.velocity_limits), (3,), "Model.bounds"),
        longest_gap=config.longest_gap,
        slip_window=config.slip_window,
        growing=config.covariance == "growing",
        noise=frozen_array([*travel, noise.rest, noise.heading_rest], (7,), "Model.noise"),
        lever=1.0 if base is None else base.lever,
        constant=frozen_array(np.array(config.twist_variance) / config.twist_rate, (3,), "Model.constant"),
        rounding=frozen_array(rounding, (3,), "Model.rounding"),
    )


def _numbers(records: Sequence[Wheels], signal: _Signal) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps (n,) [s] and values (n, w) of records, which must be of the stream's kind."""
    if not all(isinstance(record, signal.record) for record in records):
        raise EstimationError("The wheel records are of several kinds; use only ticks, only speeds or only odometry.")
    rows = [getattr(record, signal.field) for record in records]
    if any(row is None for row in rows):
        raise EstimationError("Neither a pose nor a twist is in every odometry record; use those that have one.")
    if set(map(len, rows)) != {signal.width}:
        raise EstimationError("The wheel records are of changing length; each must have one number a wheel.")
    return np.array([record.stamp for record in records]), np.concatenate(rows).reshape(-1, signal.width)
