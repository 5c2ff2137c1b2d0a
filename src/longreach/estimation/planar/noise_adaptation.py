"""What the filter learns of its sources while it runs: how noisy each really is, and how fast wheels slip.

**Noise.** A covariance R that is stated is taken as D R D with D² = diag of two factors, one for translations and one
for turns. Their logarithms follow the likelihood of the innovations, r ~ N(0, H P Hᵀ + D R D), by steps of the score
over the information gathered (stochastic approximation: Robbins & Monro 1951; Titterington 1984), which is forgotten
over `noise_memory` measurements; so a source that the prediction cannot judge, H P Hᵀ being larger, moves its factors
little. Wheels have two factors more, for the steps that add up: others judge them by what they say of the pose.

Innovations show what changes from one to the next. What stays for a while, as a scanner's bias does on a surface, they
do not; so only wheels, whose noise is described for all robots alike, are ever taken for better than stated.

**Slip.** A floor that slips does so for a while: what a scan corrects, the next corrects again, in the same direction.
Taken for white noise, as errors of the wheels' steps are, that leaves the pose behind between scans. So slip is a
velocity that wheels do not count, axis by axis a first-order Gauss-Markov process: its variance is what the rates seen
have in common with those before (Mehra 1970: the innovations of a filter that is right have nothing in common), the
rest is noise. On a floor that holds there is none, and nothing is changed.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.estimation.planar import _measurement_kernels as kernels
from longreach.estimation.planar.ekf import frozen
from longreach.measurement import frozen_array

_FIRST = 20.0  # information that the stated covariance itself counts for, in measurements of one component


class Noise(NamedTuple):
    """Logarithms of the factors on translations and on turns, the information gathered about them, `deviations`."""

    row: Float[np.ndarray, "7"]

    @property
    def log(self) -> Float[np.ndarray, "2"]:
        """The logarithms of the factors on the variances of translations and of turns (2,)."""
        return self.row[:2]

    @property
    def deviations(self) -> Float[np.ndarray, "3"]:
        """What the factors make of the standard deviations of x, y and θ (3,)."""
        return self.row[kernels.DEVIATIONS :]


NOMINAL = Noise(frozen(np.repeat([0.0, _FIRST, 1.0], [2, 2, 3])))


def process_noise(source: str) -> str:
    """Return the name under which the noise of the wheels' steps is kept; that of their readings has the source's."""
    return f"{source}, steps"


def inflated(noise: Noise, factors: Float[np.ndarray, "2"]) -> Noise:
    """Return a noise whose variances are these factors larger, as far as they may, and soon judged anew."""
    log = np.minimum(noise.log + np.log(factors), kernels.HIGHEST)
    information = np.where(factors > 1.0, _FIRST, noise.row[2:4])
    return Noise(frozen(np.concatenate([log, information, np.exp(0.5 * log)[[0, 0, 1]]])))


def scaled(covariance: Float[np.ndarray, "k k"], deviations: Float[np.ndarray, " k"]) -> Float[np.ndarray, "k k"]:
    """Return D R D."""
    return covariance * (deviations[:, None] * deviations)


class Slip(NamedTuple):
    """The velocity ξ [m/s, m/s, rad/s] that wheels do not count, its variance, and what it is learned from, as rows.

    Rows (7, 3): the rate, its variance; means of the products of a rate seen with the one before the last, and with
    itself; the last two rates, and what the last correction left. What one correction leaves is seen again with the
    next, so that neighbours share an error; those apart do not.
    seen [s]: when that was. rhythm (2,): mean time between corrections, and how far off it they are [s].
    slips: whether the variance is more than zero.
    """

    rows: Float[np.ndarray, "7 3"]
    seen: float = -math.inf
    rhythm: tuple[float, float] = (0.0, 0.0)
    slips: bool = False

    @property
    def rate(self) -> Float[np.ndarray, "3"]:
        """The velocity ξ (3,)."""
        return self.rows[kernels.RATE]


NO_SLIP = Slip(frozen_array(np.zeros((7, 3)), (7, 3), "Slip.rows"))


def corrected(
    slip: Slip, r: Float[np.ndarray, "3"], before: Float[np.ndarray, " n"], after: Float[np.ndarray, " m"],
    stamp: float, coupled: Float[np.ndarray, "3"],
) -> Slip:  # fmt: skip
    """Return what is known where a source has shown the pose to be off by r (3,), and it was moved for that.

    before, after: that pose, of a mean. coupled (3,): 1 in the axes in which the pose follows the wheels, else 0.
    """
    rows = np.empty((7, 3))
    rhythm = kernels.correct(slip.rows, slip.seen, *slip.rhythm, r, before, after, stamp, coupled, rows)
    rows.flags.writeable = False
    return Slip(rows, max(stamp, slip.seen), rhythm, bool(rows[kernels.VARIANCE].any()))


def way(slip: Slip, speed: float, begin: float, end: float) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return ξ (3,) that is slipped from one time to another [s], and its variance; a base that stands does not slip.

    speed [m/s]: of the base, as its wheels count.
    """
    xi, variance = np.empty(3), np.empty(3)
    kernels.way(slip.rows, slip.seen, *slip.rhythm, speed, begin, end, xi, variance)
    return xi, variance


def velocity(slip: Slip, speed: float, stamp: float) -> Float[np.ndarray, "3"]:
    """Return the velocity (3,) that wheels do not count at a time [s], where they count a speed [m/s]."""
    part = kernels.fading(max(stamp - slip.seen, 0.0)) * kernels.possible(slip.rows, speed)
    return part * slip.rate
