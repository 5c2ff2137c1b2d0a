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

_LASTS = 1.0  # [s], time constant of the process: as long as a base takes to start or to stop
_MEMORY = 40.0  # corrections over which products are averaged; a second of a fast scanner
_CHANCE = 0.3  # correlation that may come by chance: two deviations
_FASTEST = 1.0  # [m/s, rad/s]: what is more is a bump
_GAP = 0.5  # [s] between corrections, after which the last has nothing to do with the next
_REGULAR = 0.1  # of the time between corrections, that stamps may be off by: rates over shorter times are noise


class Slip(NamedTuple):
    """The velocity ξ [m/s, m/s, rad/s] that wheels do not count (3,), its variance (3,), and what it is learned from.

    together, alone (3,): means of the products of a rate seen with the one before the last, and with itself. For what
    one correction leaves is seen again with the next, so that neighbours share an error; those apart do not.
    last (2, 3): the last two rates. left (3,): what the last correction left; seen [s]: when that was.
    rhythm (2,): mean time between corrections, and how far off it they are [s].
    """

    rate: Float[np.ndarray, "3"] = np.zeros(3)
    variance: Float[np.ndarray, "3"] = np.zeros(3)
    together: Float[np.ndarray, "3"] = np.zeros(3)
    alone: Float[np.ndarray, "3"] = np.zeros(3)
    last: Float[np.ndarray, "2 3"] = np.zeros((2, 3))
    left: Float[np.ndarray, "3"] = np.zeros(3)
    seen: float = -math.inf
    rhythm: tuple[float, float] = (0.0, 0.0)

    @property
    def lasting(self) -> Float[np.ndarray, "3"]:
        """The variance (3,) of the process: none where corrections are as white as they may be by chance."""
        if self.rhythm[1] > _REGULAR * self.rhythm[0]:
            return np.zeros(3)
        return np.maximum(self.together - _CHANCE * self.alone, 0.0)


NO_SLIP = Slip()


def corrected(
    slip: Slip, r: Float[np.ndarray, "3"], xi: Float[np.ndarray, "3"], stamp: float, coupled: Float[np.ndarray, "3"]
) -> Slip:
    """Return what is known where a source has shown the pose to be off by r (3,), and it was moved by ξ (3,) for that.

    coupled (3,): 1 in the axes in which the pose follows the wheels, else 0.
    """
    dt, left = stamp - slip.seen, r - xi
    if not 0.0 < dt <= _GAP:
        fading = math.exp(-dt / _LASTS) if 0.0 < dt < math.inf else 0.0
        return slip._replace(rate=fading * slip.rate, last=np.zeros((2, 3)), left=left, seen=max(stamp, slip.seen))
    fading = math.exp(-dt / _LASTS)
    before = fading * slip.rate
    rate = np.clip(coupled * ((r - slip.left) / dt + before), -_FASTEST, _FASTEST)
    together = slip.together + (rate * slip.last[0] - slip.together) / _MEMORY
    alone = slip.alone + (rate * rate - slip.alone) / _MEMORY
    mean, off = slip.rhythm
    rhythm = mean + (dt - mean) / _MEMORY, off + (abs(dt - mean) - off) / _MEMORY
    after = Slip(before, slip.variance, together, alone, np.stack([slip.last[1], rate]), left, stamp, rhythm)
    lasting = after.lasting
    if not lasting.any():
        return after._replace(rate=np.zeros(3), variance=np.zeros(3))
    variance = fading * fading * slip.variance + (1.0 - fading * fading) * lasting
    noise = np.maximum(alone - np.maximum(together, 0.0), 0.01 * alone)
    gain = np.divide(variance, variance + noise, out=np.zeros(3), where=lasting > 0.0)
    filtered = np.where(lasting > 0.0, before + gain * (rate - before), 0.0)
    return after._replace(rate=filtered, variance=(1.0 - gain) * variance)


def way(slip: Slip, speed: float, begin: float, end: float) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return ξ (3,) that is slipped from one time to another [s], and its variance; a base that stands does not slip.

    speed [m/s]: of the base, as its wheels count.
    """
    t0, t1 = max(begin - slip.seen, 0.0), max(end - slip.seen, 0.0)
    lasting = _LASTS * (math.exp(-t0 / _LASTS) - math.exp(-t1 / _LASTS))
    return lasting * _possible(slip, speed), _spread(slip, t1) - _spread(slip, t0)


def velocity(slip: Slip, speed: float, stamp: float) -> Float[np.ndarray, "3"]:
    """Return the velocity (3,) that wheels do not count at a time [s], where they count a speed [m/s]."""
    return math.exp(-max(stamp - slip.seen, 0.0) / _LASTS) * _possible(slip, speed)


def _possible(slip: Slip, speed: float) -> Float[np.ndarray, "3"]:
    most = math.hypot(slip.rate[0], slip.rate[1])
    return min(1.0, speed / most) * slip.rate if most > 0.0 else slip.rate


def _spread(slip: Slip, t: float) -> Float[np.ndarray, "3"]:
    """Return the variance (3,) of the way slipped in t [s] since the slip was seen."""
    variance = slip.variance + slip.lasting * min(1.0, 2.0 * t / _LASTS)
    return variance * t * t / (1.0 + 0.5 * t / _LASTS)
