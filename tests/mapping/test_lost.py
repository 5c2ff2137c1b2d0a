"""The test whether a base is lost: uniform while it is not, small soon after, and not taught by what it refuses."""

import numpy as np
import pytest
from scipy.stats import kstest

from longreach.mapping import lost

SHARE, NIS = 0.03, 1.0


def fits(rng, count, share=SHARE, nis=NIS):
    """Shares and NIS of good fits: what is not explained is gamma distributed, and NIS is χ² with 3 degrees."""
    unexplained = share * rng.gamma(4.0, 0.25, count)
    return zip(np.exp(-unexplained).tolist(), (nis * rng.chisquare(3, count) / 3.0).tolist(), strict=True)


def after(test, some, moving=True, taken=True):
    ps = []
    for share, nis in some:
        test = lost.step(test, share, nis, moving, taken)
        ps.append(test.p)
    return test, np.array(ps)


@pytest.mark.parametrize(("share", "nis"), [(0.03, 1.0), (0.2, 0.2), (0.01, 4.0)])
def test_p_values_a_window_apart_are_uniform_whatever_is_usual(rng, share, nis):
    ps = []
    for _ in range(4):
        test, _ = after(lost.UNTESTED, fits(rng, 40, share, nis))  # until it knows what is usual
        ps.append(after(test, fits(rng, 800, share, nis))[1][lost.WINDOW - 1 :: lost.WINDOW])
    assert kstest(np.concatenate(ps), "uniform").pvalue > 0.01


def test_good_fits_never_raise_an_alarm(rng):
    test = lost.UNTESTED
    for share, nis in fits(rng, 3000):
        test = lost.step(test, share, nis, True, True)
        assert not test.is_lost


@pytest.mark.parametrize("known", [0, 8, 400])
def test_fits_that_are_refused_raise_an_alarm_within_a_window_however_little_was_learned(rng, known):
    test, _ = after(lost.UNTESTED, fits(rng, known))
    for _ in range(lost.WINDOW):
        test = lost.step(test, 0.15, 16.0, False, False)
    assert test.is_lost


def test_a_few_fits_that_are_refused_are_no_alarm(rng):
    test, _ = after(lost.UNTESTED, fits(rng, 400))
    for share, nis in fits(rng, 400):
        bad = rng.random() < 0.05
        test = lost.step(test, 0.2 if bad else share, 16.0 if bad else nis, True, not bad)
        assert not test.is_lost


def test_what_is_refused_is_not_learned_as_usual(rng):
    test, _ = after(lost.UNTESTED, fits(rng, 400))
    later, _ = after(test, [(0.2, 16.0)] * 200, taken=False)
    assert later.is_lost
    assert later.usual == test.usual
    assert later.mean == pytest.approx(test.mean, abs=0.3)
