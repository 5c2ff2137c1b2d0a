"""What matching one scan gives, whichever way it was matched."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.measurement import RelativePoseMeasurement


@dataclass(frozen=True, eq=False)
class ScanMatch:
    """What one scan gave: the base's pose relative to the reference scan, or None and the reason why not.

    rows: beams that took part.
    degenerate: directions of ξ (k, 3), of length 1 [m, m, rad], along which the scan says nothing, as in a corridor:
    there the pose is the guess's and its covariance wide.
    keyframe: this scan is what the next ones are matched against.
    keyframe_noise (3, 3): of a keyframe, the part of its match's covariance that the matches to it have in common.
    motion: pose of the base seen from where it was at the last scan, whatever the reference is; None: not known.
    """

    stamp: float
    measurement: RelativePoseMeasurement | None
    reason: str
    rows: int
    degenerate: Float[np.ndarray, "k 3"] = field(default_factory=lambda: np.zeros((0, 3)))
    keyframe: bool = False
    motion: Float[np.ndarray, "3"] | None = None
    keyframe_noise: Float[np.ndarray, "3 3"] | None = None

    @property
    def twist(self) -> Float[np.ndarray, "3"] | None:
        """Mean body twist of the base [m/s, m/s, rad/s] between the two scans."""
        if self.measurement is None or not self.stamp > self.measurement.stamp_reference:
            return None
        return se2.log(self.measurement.pose) / (self.stamp - self.measurement.stamp_reference)
