"""Lateness of a loop's ticks, on a clock that the tests turn."""

import numpy as np
import pytest

from longreach.control import ticker
from longreach.errors import ControlError


class Clock:
    """Time that passes only when told to, or when slept."""

    def __init__(self):
        self.now, self.slept = 50.0, []

    def __call__(self):
        return self.now

    def sleep(self, seconds):
        self.slept.append(seconds)
        self.now += seconds


def test_a_loop_that_computes_in_time_is_never_late():
    clock = Clock()
    loop = ticker.tick(ticker.init(0.008, clock()), clock())
    for _ in range(1000):
        clock.now += 0.002
        loop = ticker.wait(loop, clock, clock.sleep)
    assert clock.now == pytest.approx(50.0 + 1000 * 0.008)
    assert loop.ticks == 1001
    assert loop.late == 0
    assert loop.busy.percentile(99) == pytest.approx(0.002, rel=0.05)
    assert loop.lateness.percentile(99) == pytest.approx(0.0, abs=2e-6)


def test_ticks_that_compute_too_long_are_counted_and_the_rhythm_is_kept():
    clock = Clock()
    loop = ticker.tick(ticker.init(0.008, clock()), clock())
    for k in range(1, 101):
        clock.now += 0.011 if k % 10 == 0 else 0.002
        loop = ticker.wait(loop, clock, clock.sleep)
    assert loop.late == 10
    assert loop.lateness.worst == pytest.approx(0.003)
    assert clock.now == pytest.approx(50.0 + 100 * 0.008 + 0.003)  # what one lost, the next sleeps less
    assert loop.busy.worst == pytest.approx(0.011)


def test_after_a_pause_the_loop_does_not_race():
    clock = Clock()
    loop = ticker.tick(ticker.init(0.008, clock()), clock())
    clock.now += 1.0
    loop = ticker.wait(loop, clock, clock.sleep)
    assert clock.slept == []
    assert loop.lateness.worst == pytest.approx(0.992)
    loop = ticker.wait(loop, clock, clock.sleep)
    assert clock.slept == [pytest.approx(0.008)]


def test_percentiles_are_those_of_numpy_within_a_bin(rng):
    seconds, count = rng.lognormal(-7.0, 1.0, 2000), ticker.no_durations()
    assert count.percentile(99) == 0.0
    for s in seconds.tolist():
        count = ticker.counted(count, s)
    for p in (10, 50, 90, 99):
        assert count.percentile(p) == pytest.approx(np.percentile(seconds, p, method="inverted_cdf"), rel=0.05)
    assert count.percentile(100) == seconds.max()
    assert count.total == 2000


def test_a_period_that_is_none_is_refused():
    for period in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ControlError, match="give it a positive number"):
            ticker.init(period, 0.0)
