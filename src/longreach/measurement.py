"""One stamped sensor reading each, immutable and checked once at the door.

`stamp` is float seconds on a clock that never runs backwards. Where a recording's own stamps do, its reader repairs
them (`trajectory.monotone_clock`) and keeps the stamps as recorded in `Recording.recorded_stamps`.
Arrays are read-only.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from longreach.errors import RecordingError
from longreach.trajectory import PoseTrajectory

_NANOSECONDS = 1e14  # seconds since 1970 stay below 1e10 until the year 2286


def frozen_array(value: Any, shape: tuple[int | None, ...], what: str) -> np.ndarray:
    """Return a read-only float copy of `value`, or raise RecordingError when its shape is not `shape` (None: any)."""
    array = np.array(value, dtype=float, order="C")  # so that kernels are compiled for one order only
    if array.shape != shape and (
        array.ndim != len(shape) or any(n is not None and n != m for n, m in zip(shape, array.shape, strict=True))
    ):
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise RecordingError(f"{what} has shape {array.shape}, expected {wanted}.")
    array.flags.writeable = False
    return array


def _check_stamp(stamp: float, what: str) -> None:
    if not math.isfinite(stamp):
        raise RecordingError(f"{what} has the stamp {stamp}; a stamp is a finite number of seconds.")
    if abs(stamp) > _NANOSECONDS:
        raise RecordingError(f"{what} has the stamp {stamp:.0f}, which looks like nanoseconds; stamps are seconds.")


class _Stamped:
    """Check the stamp and freeze the arrays named in `_shapes` of every record."""

    _shapes: ClassVar[Mapping[str, tuple[int | None, ...]]] = {}

    def __post_init__(self) -> None:
        kind = type(self).__name__
        _check_stamp(self.stamp, f"A {kind}")  # type: ignore[attr-defined]
        for name, shape in self._shapes.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen_array(value, shape, f"{kind}.{name}"))


@dataclass(frozen=True, eq=False)
class LaserScan(_Stamped):
    """One sweep of a planar laser scanner; beam i points at `angle_min + i * angle_increment` [rad].

    A range of 0, NaN, ±inf, or outside [range_min, range_max] [m] is no return (REP-117). `time_increment` [s] is the
    time between two beams (0: the sweep is taken in an instant); `stamp` is the time of the first beam.
    """

    stamp: float
    ranges: Float[np.ndarray, " n"]
    angle_min: float
    angle_increment: float
    range_min: float = 0.0
    range_max: float = math.inf
    time_increment: float = 0.0
    frame: str = "laser"
    _shapes: ClassVar = {"ranges": (None,)}

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.angle_min) and math.isfinite(self.angle_increment) and self.angle_increment != 0):
            raise RecordingError(
                f"A LaserScan has angle_min {self.angle_min} and angle_increment {self.angle_increment}; "
                "both must be finite and the increment not zero."
            )

    @property
    def angles(self) -> Float[np.ndarray, " n"]:
        """Beam angles [rad]."""
        return self.angle_min + self.angle_increment * np.arange(len(self.ranges))

    @property
    def returns(self) -> Float[np.ndarray, " n"]:
        """Ranges [m] as a fresh array, with 0 wherever there was no return."""
        r = self.ranges
        with np.errstate(invalid="ignore"):
            good = (r > 0) & (r >= self.range_min) & (r <= self.range_max) & (r < math.inf)
        return np.where(good, r, 0.0)


@dataclass(frozen=True, eq=False)
class WheelSpeeds(_Stamped):
    """Angular speeds of the wheels [rad/s], in the order of the robot's base."""

    stamp: float
    speeds: Float[np.ndarray, " wheels"]
    _shapes: ClassVar = {"speeds": (None,)}


@dataclass(frozen=True, eq=False)
class WheelTicks(_Stamped):
    """Accumulated encoder counts of the wheels, in the order of the robot's base."""

    stamp: float
    ticks: Float[np.ndarray, " wheels"]
    _shapes: ClassVar = {"ticks": (None,)}


@dataclass(frozen=True, eq=False)
class Odometry(_Stamped):
    """What a robot's own driver made of its wheels: a pose [m, m, rad] in a drifting frame, a body twist, or both."""

    stamp: float
    pose: Float[np.ndarray, "3"] | None = None
    twist: Float[np.ndarray, "3"] | None = None
    pose_covariance: Float[np.ndarray, "3 3"] | None = None
    twist_covariance: Float[np.ndarray, "3 3"] | None = None
    _shapes: ClassVar = {"pose": (3,), "twist": (3,), "pose_covariance": (3, 3), "twist_covariance": (3, 3)}


@dataclass(frozen=True, eq=False)
class Imu(_Stamped):
    """Angular velocity [rad/s] and specific force [m/s²], both in the sensor's frame; None: there is no such sensor."""

    stamp: float
    angular_velocity: Float[np.ndarray, "3"]
    acceleration: Float[np.ndarray, "3"] | None = None
    frame: str = "imu"
    _shapes: ClassVar = {"angular_velocity": (3,), "acceleration": (3,)}


@dataclass(frozen=True, eq=False)
class TwistMeasurement(_Stamped):
    """Body twist [v_x, v_y, ω] at `stamp` with its covariance; an infinite variance means not measured."""

    stamp: float
    twist: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    source: str = "twist"
    _shapes: ClassVar = {"twist": (3,), "covariance": (3, 3)}


@dataclass(frozen=True, eq=False)
class PoseMeasurement(_Stamped):
    """Absolute pose [x, y, θ] of the base in the world, with the covariance of [x, y] in the world's axes and of θ.

    An infinite variance means not measured: a GPS-like fix has diag(σ², σ², inf).
    """

    stamp: float
    pose: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    source: str = "pose"
    _shapes: ClassVar = {"pose": (3,), "covariance": (3, 3)}


@dataclass(frozen=True, eq=False)
class RelativePoseMeasurement(_Stamped):
    """Pose of the base at `stamp` seen from the base at `stamp_reference`; ξ = log(pose⁻¹ · truth) has `covariance`.

    reading_covariance: where `pose` is the step between two readings of one counter, the error of a reading itself
    (rounding, age): it does not add up from step to step as `covariance` does. None: there is none, or none is known.
    shared_covariance: the part of `covariance` that all poses relative to this reference have in common, as the noise
    of a keyframe's own scan. None: each stands for itself.
    """

    stamp_reference: float
    stamp: float
    pose: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    source: str = "relative"
    reading_covariance: Float[np.ndarray, "3 3"] | None = None
    shared_covariance: Float[np.ndarray, "3 3"] | None = None
    _shapes: ClassVar = {
        "pose": (3,),
        "covariance": (3, 3),
        "reading_covariance": (3, 3),
        "shared_covariance": (3, 3),
    }


@dataclass(frozen=True, eq=False)
class JointState(_Stamped):
    """Positions, velocities and efforts of named joints; an array that was not measured is empty."""

    stamp: float
    names: tuple[str, ...]
    position: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " m"]
    effort: Float[np.ndarray, " k"]
    _shapes: ClassVar = {"position": (None,), "velocity": (None,), "effort": (None,)}


@dataclass(frozen=True, eq=False)
class Wrench(_Stamped):
    """Force [N] and torque [N·m] that the environment exerts on the tool, in the frame of the sensor."""

    stamp: float
    force: Float[np.ndarray, "3"]
    torque: Float[np.ndarray, "3"]
    frame: str = "wrench"
    _shapes: ClassVar = {"force": (3,), "torque": (3,)}


@dataclass(frozen=True)
class GripperState:
    """Where the fingers are: closed from 0 (open) to 1 (closed), how fast [1/s], with what force at the tips [N]."""

    stamp: float
    closed: float
    velocity: float = 0.0
    force: float = 0.0


Wheels = WheelSpeeds | WheelTicks | Odometry


@dataclass(frozen=True, eq=False)
class Recording:
    """All that one robot measured in one run, by kind, each in the order of its (repaired) stamps.

    wheels: all of one type. fixes: absolute poses of the base that may be fused (motion capture, GPS-like).
    mounts: frame of a sensor → T_base_sensor (4, 4), from the recording's own tf.
    recorded_stamps: repaired stamp → the stamp as recorded, only where the two differ.
    remarks: what the reader repaired or left out, a sentence each.
    """

    name: str
    wheels: tuple[Wheels, ...] = ()
    scans: tuple[LaserScan, ...] = ()
    imu: tuple[Imu, ...] = ()
    fixes: tuple[PoseMeasurement, ...] = ()
    joints: tuple[JointState, ...] = ()
    wrenches: tuple[Wrench, ...] = ()
    truth: PoseTrajectory | None = None
    mounts: Mapping[str, Float[np.ndarray, "4 4"]] = field(default_factory=dict)
    recorded_stamps: Mapping[float, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def replace(self, **changes: Any) -> "Recording":
        """Return a copy with some fields changed."""
        unknown = set(changes) - {f.name for f in fields(self)}
        if unknown:
            raise RecordingError(f"A Recording has no {', '.join(sorted(unknown))}.")
        return replace(self, **changes)

    def as_recorded(self, stamps: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the stamps as recorded [s] for stamps of the repaired clock."""
        if not self.recorded_stamps:
            return stamps
        return np.array([self.recorded_stamps.get(s, s) for s in stamps.tolist()])
