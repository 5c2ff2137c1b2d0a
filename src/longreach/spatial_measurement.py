"""What a robot measured in space, for the 15-state filter: poses, twists and accelerations in the order they came in.

`source` is the sensor's name in the filter's settings (odom0, imu1, …). Covariances are as the messages have them: of a
pose over x y z and the angles about x y z, of a twist [v; ω] in the sensor's frame. What was not measured is NaN.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from longreach.measurement import _Stamped


@dataclass(frozen=True, eq=False)
class PoseReading(_Stamped):
    """T_frame_child (4, 4); of an IMU T_world_sensor, and `frame` is the sensor's."""

    stamp: float
    pose: Float[np.ndarray, "4 4"]
    covariance: Float[np.ndarray, "6 6"]
    frame: str
    source: str
    child: str = ""
    _shapes: ClassVar = {"pose": (4, 4), "covariance": (6, 6)}


@dataclass(frozen=True, eq=False)
class TwistReading(_Stamped):
    """[v; ω] (6,) [m/s, rad/s] of the sensor in its own frame."""

    stamp: float
    twist: Float[np.ndarray, "6"]
    covariance: Float[np.ndarray, "6 6"]
    frame: str
    source: str
    _shapes: ClassVar = {"twist": (6,), "covariance": (6, 6)}


@dataclass(frozen=True, eq=False)
class AccelerationReading(_Stamped):
    """Specific force (3,) [m/s²] in the sensor's frame; attitude: R_world_sensor, where the message has one."""

    stamp: float
    acceleration: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    frame: str
    source: str
    attitude: Float[np.ndarray, "3 3"] | None = None
    _shapes: ClassVar = {"acceleration": (3,), "covariance": (3, 3), "attitude": (3, 3)}


@dataclass(frozen=True, eq=False)
class Command(_Stamped):
    """[v; ω] (6,) that the base was told to drive from this stamp on."""

    stamp: float
    twist: Float[np.ndarray, "6"]
    _shapes: ClassVar = {"twist": (6,)}


Reading = PoseReading | TwistReading | AccelerationReading


@dataclass(frozen=True, eq=False)
class SpatialRecording:
    """All readings of one run in the order in which they came in, which need not be that of their stamps.

    mounts: frame → T_base_frame of frames fixed to the base. origins: frame → T_world_frame of frames fixed to the
    world. remarks: what the reader left out, a sentence each.
    """

    name: str
    readings: tuple[Reading, ...]
    commands: tuple[Command, ...] = ()
    mounts: Mapping[str, Float[np.ndarray, "4 4"]] = field(default_factory=dict)
    origins: Mapping[str, Float[np.ndarray, "4 4"]] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
