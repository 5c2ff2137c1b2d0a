"""How fast wheels slip, learned from where another source corrects the pose, one time after the other.

A floor that slips does so for a while: what a scan corrects, the next corrects again, in the same direction. Taken for
white noise, as errors of the wheels' steps are, that leaves the pose behind between scans. So slip is a velocity that
wheels do not count, axis by axis a first-order Gauss-Markov process: its variance is what the rates seen have in common
with those before (Mehra 1970: the innovations of a filter that is right have nothing in common), the rest is noise. On
a floor that holds there is none, and nothing is changed.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.estimation.planar import _wheel_slip_kernels as kernels
from longreach.measurement import frozen_array


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
