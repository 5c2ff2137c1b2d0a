"""What the filter holds after an event: mean, covariance, pose clones, and what it has learned of its sources."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.errors import EstimationError
from longreach.estimation import ekf
from longreach.estimation.gaussian import Belief
from longreach.estimation.noise import Noise
from longreach.estimation.observation import Measurement
from longreach.estimation.slip import NO_SLIP, Slip, velocity
from longreach.measurement import RelativePoseMeasurement

_NOTHING = np.zeros(0)
_NOTHING.flags.writeable = False


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
    innovation: Float[np.ndarray, " k"] = _NOTHING
    nis: float = 0.0
    dof: int = 0


class Clone(NamedTuple):
    """A pose clone: its number, its stamp [s], and which part (3, 3) of its covariance is its own scan's noise.

    keyframe: whether scans are matched to it. changed: stamp of the wheels' last reading that was a new one [s].
    """

    number: int
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
    """The filter after one event (None: the start): mean (16 + 3m,), P, and by source clones, tallies, noise.

    steps: by source of wheel odometry, what its steps have added (2, 3, 3) to the covariance of the pose since another
    source observed it, through translations and through turns. streaks: by source, what it has said beyond the gate
    without a break. slip: of the wheels. drift: cumulative sum of the innovations of headings, each over its deviation.
    links: what led here from the snapshot before, where a smoother will want to know, else None.
    """

    key: tuple[float, int, str]
    event: Event | None
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

    def place(self, number: int) -> int:
        """Return where in the mean the pose clone of that number is."""
        return ekf.CLONES + 3 * number

    @property
    def spare(self) -> int:
        """The number of the next pose clone."""
        return (len(self.mean) - ekf.CLONES) // 3

    @property
    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        """The base's pose (3,) in the world, and the covariance (3, 3) of its ξ."""
        pose, covariance = ekf.compound(self.mean, self.P)
        return pose, covariance[:3, :3].copy()  # a view would keep more alive

    @property
    def belief(self) -> Belief:
        """What is believed, with the pose in the world."""
        (stamp, *_), mean = self.key, self.mean
        pose, covariance = ekf.compound(mean, self.P)
        twist = mean[3:6]
        if self.slip.rate.any():  # which the pose goes with, and wheels do not count
            twist = twist + velocity(self.slip, float(np.hypot(twist[0], twist[1])), stamp)
        return Belief(stamp, pose, twist, mean[6:9], float(mean[9]), covariance)
