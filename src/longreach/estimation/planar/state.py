"""What the filter holds after an event: mean, covariance, pose clones, and what it has learned of its sources."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.errors import EstimationError
from longreach.estimation.planar import _ekf_kernels as kernels
from longreach.estimation.planar.measurement_models import Measurement
from longreach.estimation.planar.noise_adaptation import NO_SLIP, Noise, Slip, velocity
from longreach.estimation.replay_buffer import Key
from longreach.measurement import RelativePoseMeasurement, _Stamped, frozen_array


@dataclass(frozen=True, eq=False)
class Belief(_Stamped):
    """Pose [x, y, θ], body twist [v_x, v_y, ω], its derivative in body axes, and the gyro's bias [rad/s] at `stamp`.

    covariance (10, 10): of the error in that order; the pose's is ξ = log(mean⁻¹ · truth), in the body frame.
    """

    stamp: float
    pose: Float[np.ndarray, "3"]
    twist: Float[np.ndarray, "3"]
    acceleration: Float[np.ndarray, "3"]
    gyro_bias: float
    covariance: Float[np.ndarray, "10 10"]
    _shapes: ClassVar = {"pose": (3,), "twist": (3,), "acceleration": (3,), "covariance": (10, 10)}

    @property
    def pose_covariance(self) -> Float[np.ndarray, "3 3"]:
        """Covariance of ξ, order x y θ [m², m rad, rad²]."""
        return self.covariance[:3, :3]


@dataclass(frozen=True, slots=True)
class PoseClone:
    """From here on, relative poses of `source` refer to the pose at `stamp`, which the filter remembers."""

    stamp: float
    source: str

    def __post_init__(self) -> None:
        if not np.isfinite(self.stamp):
            raise EstimationError(f"A {type(self).__name__} has the stamp {self.stamp}; a stamp is a finite number.")


@dataclass(frozen=True, slots=True)
class Keyframe(PoseClone):
    """From here on, matches are relative to the scan at `stamp`: a pose clone, and in time the local reference.

    match: the pose of the scan relative to the keyframe before, where there is one. noise (3, 3): the part of its
    covariance that the matches to come have in common; None: all of it.
    """

    match: RelativePoseMeasurement | None = None
    noise: Float[np.ndarray, "3 3"] | None = None

    def __post_init__(self) -> None:
        PoseClone.__post_init__(self)
        if self.match is not None and (self.match.stamp, self.match.source) != (self.stamp, self.source):
            raise EstimationError("The match of a Keyframe must be of the same stamp and source.")


Event = Measurement | PoseClone


class Tally(NamedTuple):
    """What became of one source's measurements; `used` counts the `inflated` ones too."""

    used: int = 0
    inflated: int = 0
    gated: int = 0
    refused: int = 0
    streak: int = 0  # beyond the gate in a row


class Correction(NamedTuple):
    """What became of one event. A pose clone has dof 0; so has what was refused before it was compared (nis 0)."""

    stamp: float
    source: str
    status: Literal["used", "gated", "refused"]
    reason: str = ""
    innovation: Float[np.ndarray, " k"] = frozen_array(np.zeros(0), (0,), "innovation")
    nis: float = 0.0
    dof: int = 0


class Clone(NamedTuple):
    """A pose clone: where it is in the mean, its stamp [s], which part (3, 3) of its covariance is its scan's noise.

    keyframe: whether scans are matched to it. changed: stamp of the wheels' last reading that was a new one [s].
    """

    at: int
    stamp: float
    own: np.ndarray | None = None
    keyframe: bool = False
    changed: float = math.inf


class Streak(NamedTuple):
    """How many times in a row a source has said that the pose is off by much the same ξ (3,)."""

    times: int
    xi: np.ndarray


class Link(NamedTuple):
    """How errors before are errors after, M (m, n), and what was learned in between: H (k, n), S⁻¹ r (k,), S⁻¹ (k, k).

    With them a smoother goes back over what the filter did. H is None where nothing was measured.
    """

    M: np.ndarray
    H: np.ndarray | None = None
    weighed: np.ndarray | None = None
    information: np.ndarray | None = None


class Snapshot(NamedTuple):
    """The filter after one event, or at the start: mean (16 + 3m,), P, and by source clones, tallies, noise.

    steps: by source of wheel odometry, what its steps have added (2, 3, 3) to the covariance of the pose since another
    source observed it, through translations and through turns. streaks: by source, what it has said beyond the gate
    without a break. slip: of the wheels. drift: cumulative sum of the innovations of headings, each over its deviation.
    links: what led here from the snapshot before, where a smoother will want to know, else None.
    """

    key: Key
    mean: np.ndarray
    P: np.ndarray
    clones: Mapping[str, Clone] = {}
    tallies: Mapping[str, Tally] = {}
    noise: Mapping[str, Noise] = {}
    steps: Mapping[str, np.ndarray] = {}
    streaks: Mapping[str, Streak] = {}
    slip: Slip = NO_SLIP
    drift: float = 0.0
    links: tuple[Link, ...] | None = None

    @property
    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """The base's pose (3,) in the world, and the covariance (3, 3) of its ξ."""
        pose, covariance = kernels.compound(self.mean, self.P)
        return pose, covariance[:3, :3].copy()  # a view would keep more alive

    @property
    def belief(self) -> Belief:
        """What is believed, with the pose in the world."""
        stamp, mean, twist = self.key[0], self.mean, self.mean[3:6]
        pose, covariance = kernels.compound(mean, self.P)
        if self.slip.rate.any():  # which the pose goes with, and wheels do not count
            twist = twist + velocity(self.slip, float(np.hypot(twist[0], twist[1])), stamp)
        return Belief(stamp, pose, twist, mean[6:9], float(mean[9]), covariance)
