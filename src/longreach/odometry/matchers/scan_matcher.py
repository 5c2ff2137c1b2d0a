"""What every scan matcher offers, what it is given and gives, and what LIDAR odometry makes of it."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from longreach.measurement import LaserScan, RelativePoseMeasurement
from longreach.odometry.scan_geometry import ScanGeometry


@dataclass(frozen=True, eq=False)
class Features:
    """What a matcher takes from a scan: rows of numbers (k, m), a column a return, beside what it needs of the whole.

    count: returns. noise [m]: deviation of a range. reach [m]: the median range.
    """

    values: Float[np.ndarray, "k m"]
    count: int
    noise: float
    reach: float


class Prior(NamedTuple):
    """Where the base is expected, in the frame of the reference, before the scan is looked at.

    pose (3,), sigma (3,): deviations [m, m, rad] in the frame of the pose. free (3,): variances [m², m², rad²] along
    directions of ξ that the scan does not show; astray (3,): how far the pose itself may be off along them.
    """

    pose: Float[np.ndarray, "3"]
    sigma: Float[np.ndarray, "3"]
    free: Float[np.ndarray, "3"]
    astray: Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Fit:
    """A pose (3,) of the base in the frame of the reference, with its covariance, and how well it explains the scan.

    shared (3, 3): the part of the covariance that is the reference's noise. directions (k, 3): of ξ, along which the
    scan shows nothing: there the pose is the prior's. inlier_ratio: share of the returns that agree but for noise.
    """

    pose: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    shared: Float[np.ndarray, "3 3"]
    rows: int
    scale: float
    inlier_ratio: float
    directions: Float[np.ndarray, "k 3"]


Reference = Any  # what a matcher makes of earlier scans, its own; it is never changed, only replaced


@runtime_checkable
class ScanMatcher(Protocol):
    """A way of matching scans."""

    def features(self, scan: LaserScan, geometry: ScanGeometry, motion: np.ndarray, share: float) -> Features:
        """Take the features of a scan; motion (3,): the base's, from scan to scan, share: of it from beam to beam."""
        ...

    def extended(self, reference: Reference | None, features: Any, fit: Any) -> tuple[Reference, np.ndarray]:
        """Make a scan that was matched, or the first one, a keyframe; return the reference, and its pose there."""
        ...

    def followed(self, reference: Reference, features: Any, fit: Any) -> Reference:
        """Return the reference after a scan that is no keyframe."""
        ...

    def match(self, features: Any, reference: Reference, geometry: ScanGeometry, prior: Prior) -> Fit | str:
        """Match features under a prior, or say why that is not possible."""
        ...

    def is_far(self, fit: Any, features: Any, geometry: ScanGeometry, reference: Reference) -> bool:
        """Whether a match is so far from every keyframe that the scan has to become one."""
        ...


@dataclass(frozen=True, eq=False)
class ScanMatch:
    """What one scan gave: the base's pose relative to the reference scan, or None and the reason why not.

    rows: beams that took part. degenerate: directions of ξ (k, 3), of length 1 [m, m, rad], along which the scan says
    nothing: there the pose is the guess's and its covariance wide. keyframe: the next scans are matched against it.
    motion: pose of the base seen from where it was at the last scan, whatever the reference is; None: not known.
    keyframe_noise (3, 3): of a keyframe, the part of its match's covariance that the matches to it have in common.
    """

    stamp: float
    measurement: RelativePoseMeasurement | None
    reason: str
    rows: int
    degenerate: Float[np.ndarray, "k 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    keyframe: bool = False
    motion: Float[np.ndarray, "3"] | None = None
    keyframe_noise: Float[np.ndarray, "3 3"] | None = None
