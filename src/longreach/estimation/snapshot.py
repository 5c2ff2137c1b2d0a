"""What the filter holds after an event: mean, covariance, anchors, and what it has learned of its sources."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.errors import EstimationError
from longreach.estimation.noise import Noise
from longreach.estimation.observation import Measurement
from longreach.estimation.slip import NO_SLIP, Slip
from longreach.measurement import RelativePoseMeasurement

_NOTHING = np.zeros(0)
_NOTHING.flags.writeable = False


@dataclass(frozen=True, slots=True)
class Anchor:
    """From here on, relative poses of `source` refer to the pose at `stamp`, which the filter remembers (a clone).

    match: what the scan at `stamp`, a keyframe from now on, says relative to the anchor before, where it does.
    """

    stamp: float
    source: str
    match: RelativePoseMeasurement | None = None

    def __post_init__(self) -> None:
        if not np.isfinite(self.stamp):
            raise EstimationError(f"An Anchor has the stamp {self.stamp}; a stamp is a finite number of seconds.")
        if self.match is not None and (self.match.stamp, self.match.source) != (self.stamp, self.source):
            raise EstimationError("The match of an Anchor must be of the same stamp and source.")


Event = Measurement | Anchor


class Tally(NamedTuple):
    """What became of one source's measurements; `used` counts the `inflated` ones too."""

    used: int = 0
    inflated: int = 0
    gated: int = 0
    refused: int = 0
    streak: int = 0  # beyond the gate in a row


class Correction(NamedTuple):
    """What became of one event. An Anchor alone has dof 0; so has what was refused before it was compared (nis 0)."""

    stamp: float
    source: str
    status: Literal["used", "gated", "refused"]
    reason: str = ""
    innovation: Float[np.ndarray, " k"] = _NOTHING
    nis: float = 0.0
    dof: int = 0


class Placed(NamedTuple):
    """An anchor: its number, its stamp [s], and which part (3, 3) of its covariance is its own scan's noise."""

    number: int
    stamp: float
    own: np.ndarray | None = None


class Doubt(NamedTuple):
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
    """The filter after one event (None: the start): mean (13 + 3m,), P, and by source anchors, tallies, noise.

    steps: by counter, what its steps have added (2, 3, 3) to the covariance of the pose since another source told it,
    through translations and through turns. doubts: by source, what it has said beyond the gate without a break.
    slip: of the wheels. drift: cumulative sum of the innovations of headings, each over its deviation.
    links: what led here from the snapshot before, where a smoother will want to know, else None.
    """

    key: tuple[float, int, str]
    event: Event | None
    mean: np.ndarray
    P: np.ndarray
    anchors: Mapping[str, Placed] = {}
    tallies: Mapping[str, Tally] = {}
    noise: Mapping[str, Noise] = {}
    steps: Mapping[str, np.ndarray] = {}
    doubts: Mapping[str, Doubt] = {}
    slip: Slip = NO_SLIP
    drift: float = 0.0
    links: tuple[Link, ...] | None = None
