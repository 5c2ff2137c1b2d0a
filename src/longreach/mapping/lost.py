"""Whether a base that is localised in a map is still where it is said to be: one p-value, by the last fits.

    surprise   −ln(share of the beams that the map explains) + NIS, each over what it usually is; a fit that is refused
               for its beams counts with the NIS at the gate
    window     the mean logarithm of the last 8 surprises, of fits to what the map covers
    p          chance of one as large: it is normal, with mean and variance of this run's windows so far
    lost       p < 1e-4, and most of the window's fits were not taken

What is usual is learned while the base is not lost, from where it starts on: worlds differ, and so do lasers. A window
lasts 2 s at 0.4 m/s and 4 s at rest, so that an hour has up to 1800 that do not overlap: a false alarm in five hours.
"""

import math
from dataclasses import dataclass, replace

WINDOW = 8  # fits
ALARM = 1e-4
# Usual values before any fit: −ln(share), NIS moving and at rest; mean and variance of windows. They count as much as
# one fit or two windows. They, and how long is remembered, are of 24 simulated drives in three worlds.
_AT_FIRST, _MEAN, _VARIANCE, _WINDOWS = (0.015, 0.12, 0.05), 0.6, 0.04, 2.0
_REMEMBERED = 15.0  # fits, or windows: older ones fade
_DOF = 7.0  # beside the windows': so many of Student's law at first
_LEAST, _MOST = 0.05, 50.0  # of a surprise's parts, in what is usual: beyond it all is as bad
_RARE, _FARTHEST = 5.0, 3.0  # in what is usual, and deviations of a window: what is learned at most


@dataclass(frozen=True)
class LostTest:
    """surprises (logarithms), taken: of the last fits, oldest first. usual: mean −ln(share), and NIS moving and at
    rest, each with how many fits it counts for. mean, variance, windows: of the windows, and how many they count for.
    since: fits since the last window that was learned. p: now.
    """

    surprises: tuple[float, ...] = ()
    taken: tuple[bool, ...] = ()
    usual: tuple[tuple[float, float], ...] = tuple((value, 1.0) for value in _AT_FIRST)
    mean: float = _MEAN
    variance: float = _VARIANCE
    windows: float = _WINDOWS
    since: int = 0
    p: float = 1.0

    @property
    def is_lost(self) -> bool:
        """Whether the base is no longer where it is said to be."""
        return len(self.taken) == WINDOW and self.p < ALARM and 2 * sum(self.taken) <= WINDOW


UNTESTED = LostTest()


def step(test: LostTest, share: float, nis: float, moving: bool, taken: bool) -> LostTest:
    """Take a fit: the share of beams that the map explains, its NIS, and whether it was taken."""
    from scipy.special import stdtr  # here, for it takes long to import

    values, at = (-math.log(share), nis), (0, 1 if moving else 2)
    surprise = sum(min(v / max(test.usual[a][0], 1e-6), _MOST) for v, a in zip(values, at, strict=True))
    usual = list(test.usual)
    if taken:
        for value, a in zip(values, at, strict=True):
            usual[a] = _learned(usual[a], min(value, _RARE * usual[a][0]))
    recent = (*test.surprises, math.log(max(surprise, _LEAST)))[-WINDOW:]
    window = math.fsum(recent) / len(recent)
    deviation = math.sqrt(test.variance * (WINDOW / len(recent) + 1.0 / test.windows))
    p = float(stdtr(test.windows + _DOF, (test.mean - window) / deviation))
    test = replace(
        test, surprises=recent, taken=(*test.taken, taken)[-WINDOW:], usual=tuple(usual), since=test.since + 1, p=p
    )
    if test.since < WINDOW or 4 * sum(test.taken) < 3 * WINDOW or not moving:
        return test
    window = min(window, test.mean + _FARTHEST * deviation)
    mean, count = _learned((test.mean, test.windows), window)
    variance, _ = _learned((test.variance, test.windows), (window - test.mean) * (window - mean))
    return replace(test, mean=mean, variance=variance, windows=count, since=0)


def _learned(before: tuple[float, float], value: float) -> tuple[float, float]:
    """Return a mean, and how many values it counts for, after one more value."""
    mean, count = before
    count = min(count + 1.0, _REMEMBERED)
    return mean + (value - mean) / count, count
