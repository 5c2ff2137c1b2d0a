"""How late each tick of a loop is and how long it computes: counted, not kept, so that a loop may run for days.

A tick that is due while the one before still computes is late; after a whole lost period the rhythm starts anew from
now, so that a loop never races to make good what is gone.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from longreach.errors import ControlError

TOLERANCE = 1e-3  # so late is not late yet [s]
_SHORTEST, _GROWTH, _BINS = 1e-6, 1.05, 380  # from a microsecond to two minutes in steps of 5 %


@dataclass(frozen=True, slots=True, eq=False)
class Durations:
    """Counts of durations by size, in bins that grow by 5 %; worst: the longest [s]."""

    counts: Int[np.ndarray, " bins"]
    worst: float = 0.0

    @property
    def total(self) -> int:
        """How many there are."""
        return int(self.counts.sum())

    def percentile(self, p: float | int) -> float:
        """Return the duration [s] that p of 100 do not exceed, 5 % too long at most; 0 where there is none."""
        below = np.cumsum(self.counts)
        if below[-1] == 0:
            return 0.0
        place = int(np.searchsorted(below, math.ceil(below[-1] * p / 100.0)))
        return 0.0 if place == 0 else min(_SHORTEST * _GROWTH**place, self.worst)


def no_durations() -> Durations:
    """Return a count of nothing."""
    return Durations(np.zeros(_BINS, dtype=np.int64))


def counted(durations: Durations, seconds: float) -> Durations:
    """Return the count with one more; what is below a microsecond is in the first bin, which stands for 0."""
    place = 0
    if seconds > _SHORTEST:
        place = min(math.ceil(math.log(seconds / _SHORTEST) / math.log(_GROWTH)), _BINS - 1)
    counts = durations.counts.copy()
    counts[place] += 1
    return Durations(counts, max(durations.worst, seconds))


@dataclass(frozen=True, slots=True, eq=False)
class Ticker:
    """A loop's rhythm: `due` is the time of the next tick [s], `tolerance` how late is not late yet [s].

    lateness: of each tick after its time; busy: from a tick's begin to the wait for the next one.
    """

    period: float
    due: float
    tolerance: float
    began: float
    late: int
    lateness: Durations
    busy: Durations

    @property
    def ticks(self) -> int:
        """How many ticks there were."""
        return self.lateness.total


def init(period: float, now: float, tolerance: float = TOLERANCE) -> Ticker:
    """Start: the first tick is due now.

    Raises:
        ControlError: a period that is not positive.
    """
    if not 0.0 < period < math.inf:
        raise ControlError(f"The period of a loop is {period} s; give it a positive number.")
    return Ticker(period, now, tolerance, now, 0, no_durations(), no_durations())


def tick(ticker: Ticker, now: float) -> Ticker:
    """Begin a tick at `now` [s]: its lateness is counted, and the next one is due a period after this one was."""
    lateness = max(now - ticker.due, 0.0)
    due = ticker.due + ticker.period
    if due <= now:
        due = now + ticker.period
    late = ticker.late + (lateness > ticker.tolerance)
    return replace(ticker, due=due, began=now, late=late, lateness=counted(ticker.lateness, lateness))


def rest(ticker: Ticker, now: float) -> tuple[Ticker, float]:
    """End a tick's computing at `now` [s]; return how long to wait for the next one [s]."""
    busy = counted(ticker.busy, max(now - ticker.began, 0.0))
    return replace(ticker, busy=busy), max(ticker.due - now, 0.0)


def wait(ticker: Ticker, clock: Callable[[], float], sleep: Callable[[float], None]) -> Ticker:
    """End this tick's computing, sleep until the next is due, and begin it; clock and sleep are the caller's."""
    ticker, remaining = rest(ticker, clock())
    if remaining > 0.0:
        sleep(remaining)
    return tick(ticker, clock())
