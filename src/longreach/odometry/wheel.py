"""Wheel odometry: the base's motion between two wheel records, with its covariance.

`init` and `step` take the records of one robot as they come. `wheel_odometry` is one `step` over all records of a
recording. Results do not depend on how records are divided into calls of `step`, to the last bit.

**Motion.** Each step is the SE(2) exponential of a body displacement ξ, the motion at a constant twist; the driver of
the thesis' base integrates by backward Euler. Encoder counts and wheel angles are differenced. Speeds and twists hold
for an instant; a step takes the mean of the two at its ends (trapezoid rule), which is right to second order, where the
last one alone would lag by half a step. The poses of a robot's own driver are taken relative to each other; its twists
are used only where it gives no poses.

**Covariance.** `constant` is the thesis' (3.23). The default, `growing`, is a random walk whose variance is in
proportion to the distance d and to the angle φ turned (`robot.description.WheelNoise`),

    along the direction of travel  along² d + turning² φ + rest² dt,    across it  across² d + turning² φ + rest² dt,
    heading  heading_travel² d + heading_turning² φ + heading_rest² dt,

carried to the end of the step, Q = ∫ Ad(exp(-sξ)) (…) Ad(exp(-sξ))ᵀ ds. The integral gives the cross terms: on a
straight line cov(y, θ) = d/2 · var θ, because an early error of the heading has become one of y. So the covariance of a
motion does not depend on the number of records that it is divided into.

**Slip.** Four wheels measure three velocities; where they disagree they slip. The part of their motion that no twist
explains (`residual_matrix`) is summed to a distance ρ over the last `slip_window`. It adds ρ² for x and y and (ρ/k)²
for θ in each window. A window is used because the rounding of encoder counts comes and goes from record to record, and
would be counted each time.

**Reading covariance.** An encoder reading has an error of its own, which does not add up from step to step: rounding,
and age. A message holds the encoder's last state, read at some time since the message before. The age is uniform over
one step, so its mean square is ξξᵀ/3, here the mean of the step to the reading and the one before. (In CARMEN's logs
the pose beside a scan is the last one of the wheels' own messages, up to 0.2 s old.)

**Breaks.** A step that is `break_factor` times faster than the robot can be is no motion; an encoder was reset or
miscounted, and no measurement bridges it. A late message makes the interval before it long and the one after it short,
down to nothing, so a step may take the mean interval where its own is shorter. The mean is taken over the last 50
intervals: delays move stamps, but neither the number of messages nor the time that they span. A pause counts as
`longest_gap` at most. (On the Intel log, with up to 13 messages in 13 ms after a pause of a second, the median of the
last 51 intervals takes 342 good steps for breaks, the mean none.)

**Input that cannot be used** is passed over and counted: numbers that are not finite (`refused`), and a stamp before
the newest one (`late`). Of records with one stamp the first is used, because its step was given out when it came. No
motion is lost thereby: the next step starts from it.

Consistency with one set of numbers, as the root of the mean NEES per degree of freedom (1 is ideal): 1.0 on the Intel
log's relations of up to 5 s; 1.0 across and 0.8 in heading on those of ACES; 1.0 to 1.8 on the mecanum base of polimi
over 1 to 10 s, whose nominal wheel radii are known to be 5 % off, which no random error describes.

Source: (3.19)–(3.23); Chong & Kleeman 1997, "Accurate odometry and error modelling for a mobile robot".
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.errors import EstimationError
from longreach.measurement import (
    Odometry,
    RelativePoseMeasurement,
    Wheels,
    WheelSpeeds,
    frozen_array,
)
from longreach.odometry import _wheel_kernels
from longreach.odometry._wheel_kernels import COUNTS, POSES, RATES, Model
from longreach.robot.description import RobotDescription, WheelNoise

_FLOOR = 1e-10  # [m², rad²], of a reading: a hundredth of a millimetre keeps covariances definite
_Variance = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class WheelConfig(BaseModel):
    """Settings of wheel odometry; a robot's own wheel noise is in its description."""

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
        description="A motion this many times faster than the robot can go is an encoder fault [1]; ours.",
    )
    longest_gap: float = Field(
        default=1.0, gt=0, description="Speeds further apart in time say nothing of the motion between them [s]; ours."
    )
    slip_window: float = Field(
        default=0.1, gt=0, description="How long a slip lasts [s]; a wheel regains its grip in that."
    )


class _Signal(NamedTuple):
    """What the records of one stream hold: `field` of each `record`, `width` numbers, and how they become steps."""

    record: type
    field: str
    width: int
    model: Model


class WheelState(NamedTuple):
    """What wheel odometry knows after the newest record. Arrays are read-only.

    signal: what the records hold, fixed by the first one; None before it.
    stamps (k,), disagreement (k,): of the records in the slip window [s], the newest one last; how far [m] the wheels
        disagree in the step that ends at each.
    values (1, w): numbers of the newest record.
    displacement (3,): ξ of the last step [m, m, rad], zeros where it was a break.
    interval, intervals: mean interval between records [s], and how many there were.
    breaks: steps that no wheel can have made, and those of speeds across too long a gap; no measurement bridges them.
    refused, late: records with a number that is not finite, and with a stamp before the newest; they are passed over.
    """

    robot: RobotDescription
    config: WheelConfig
    signal: _Signal | None = None
    stamps: np.ndarray = frozen_array([], (0,), "WheelState.stamps")
    disagreement: np.ndarray = frozen_array([], (0,), "WheelState.disagreement")
    values: np.ndarray = frozen_array([[]], (1, 0), "WheelState.values")
    displacement: np.ndarray = frozen_array([0.0] * 3, (3,), "WheelState.displacement")
    interval: float = 0.0
    intervals: int = 0
    breaks: int = 0
    refused: int = 0
    late: int = 0


@dataclass(frozen=True, eq=False)
class WheelOdometry:
    """Wheel odometry of a whole recording: steps (`source` wheels), and what was left out.

    breaks, refused: as in `WheelState`.
    slip: for each measurement the slip speed (n,) [m/s] over its window, None where slip cannot be observed.
    """

    measurements: tuple[RelativePoseMeasurement, ...]
    breaks: int = 0
    refused: int = 0
    slip: Float[np.ndarray, " n"] | None = None


def init(robot: RobotDescription, config: WheelConfig | None = None) -> WheelState:
    """Start before the first record."""
    return WheelState(robot, config or WheelConfig())


def step(state: WheelState, records: Sequence[Wheels]) -> tuple[WheelState, tuple[RelativePoseMeasurement, ...]]:
    """Take new records, in order of their stamps; return the steps that they end.

    Arguments:
        records: all of the kind of the first one, which fixes what is read of them. Where the first is an `Odometry`
            with a pose, that is the pose.

    Raises:
        EstimationError: the records are of several kinds, or the description has no such wheels. The state stays valid.
    """
    state, steps, _ = _advance(state, records)
    return state, steps


def wheel_odometry(
    wheels: Sequence[Wheels], robot: RobotDescription, config: WheelConfig | None = None
) -> WheelOdometry:
    """Turn the wheel records of a recording into steps: `step` over all of them.

    Raises:
        EstimationError: as `step`, or the records are out of order.
    """
    state, steps, slip = _advance(init(robot, config), wheels)
    if state.late:
        raise EstimationError("The stamps of the wheel records run backwards; repair them with monotone_clock.")
    return WheelOdometry(steps, state.breaks, state.refused, slip)


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
    displacement = state.displacement.copy()
    ends, poses, Q, R, slip = np.empty((2, n)), np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3, 3)), np.zeros(n)
    memory = (known, stamps, disagreement, values, displacement, state.interval, state.intervals)
    count, first, last, interval, intervals, refused, late, breaks = _wheel_kernels.advance(
        signal.model, *memory, ends, poses, Q, R, slip
    )
    state = WheelState(
        robot=state.robot,
        config=state.config,
        signal=signal,
        stamps=_read_only(stamps[first : last + 1]),
        disagreement=_read_only(disagreement[first : last + 1]),
        values=_read_only(values[:1]),
        displacement=_read_only(displacement),
        interval=interval,
        intervals=intervals,
        breaks=state.breaks + breaks,
        refused=state.refused + refused,
        late=state.late + late,
    )
    starts, stops = ends[:, :count].tolist()
    rows = zip(starts, stops, poses, Q, R if signal.model.growing else [None] * count, strict=False)
    steps = tuple([RelativePoseMeasurement(start, stop, T, q, "wheels", r) for start, stop, T, q, r in rows])
    return state, steps, frozen_array(slip[:count], (None,), "slip") if len(signal.model.residual) else None


def _read_only(array: np.ndarray) -> np.ndarray:
    array = array.copy()  # so that a block's arrays are not kept alive by what is remembered of them
    array.flags.writeable = False
    return array


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
    encoder, base = robot.encoder, robot.base
    rounding = np.full(3, _FLOOR)
    if kind == COUNTS and encoder is not None and encoder.resolution is not None:
        rounding += np.sum(forward**2, axis=1) * encoder.resolution**2 / 12
    return Model(
        signal=kind,
        forward=frozen_array(forward, (3, None), "Model.forward"),
        residual=frozen_array(residual, (None,), "Model.residual"),
        unit=unit,
        wrap=2.0**encoder.bits if kind == COUNTS and encoder is not None and encoder.bits is not None else 0.0,
        bounds=frozen_array(config.break_factor * np.array(robot.velocity_limits), (3,), "Model.bounds"),
        longest_gap=config.longest_gap,
        slip_window=config.slip_window,
        growing=config.covariance == "growing",
        noise=frozen_array(_noise(robot.wheel_noise), (7,), "Model.noise"),
        lever=1.0 if base is None else base.lever,
        constant=frozen_array(np.array(config.twist_variance) / config.twist_rate, (3,), "Model.constant"),
        rounding=frozen_array(rounding, (3,), "Model.rounding"),
    )


def _noise(noise: WheelNoise) -> list[float]:
    travel = [noise.along, noise.across, noise.turning, noise.heading_travel, noise.heading_turning]
    return [*travel, noise.rest, noise.heading_rest]


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
