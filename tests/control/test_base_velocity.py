"""The base velocity controller: limits, ramps, the timeout, and what is not finite."""

import numpy as np
import pytest

from longreach.control import base_velocity
from longreach.control.base_velocity import BaseVelocityConfig

PERIOD = 0.02


def run(wishes, config=None):
    """The twists sent for a row of wishes at 50 Hz."""
    state, sent = base_velocity.init(config or BaseVelocityConfig(), 0.0), [np.zeros(3)]
    for k, wish in enumerate(wishes):
        state, twist = base_velocity.step(state, wish, (k + 1) * PERIOD)
        sent.append(twist)
    return np.array(sent)


def test_a_step_becomes_a_ramp_up_to_the_wish():
    sent = run([np.array([0.5, 0.0, 0.0])] * 20)
    np.testing.assert_allclose(sent[:12, 0], np.minimum(np.arange(12) * 0.05, 0.5), atol=1e-12)


def test_too_much_is_held_to_the_limits_in_its_direction():
    sent = run([np.array([4.0, 2.0, 0.0])] * 60)
    np.testing.assert_allclose(sent[-1], [1.1, 0.55, 0.0])
    np.testing.assert_allclose(sent[:, 0], 2.0 * sent[:, 1], atol=1e-12)


def test_whatever_is_wished_for_velocity_and_ramp_are_kept(rng):
    drawn = [rng.normal(size=3) * 10 ** rng.uniform(-2, 2) for _ in range(100)]
    wishes = [drawn[k // 20] if rng.random() < 0.8 else None for k in range(2000)]
    sent = run(wishes)
    assert np.all(np.abs(sent) <= np.array([1.1, 1.1, 2.0]) + 1e-12)
    assert np.all(np.abs(np.diff(sent, axis=0)) <= np.array([2.5, 2.5, 1.0]) * PERIOD + 1e-9)
    assert np.abs(sent).max() > 0.5


@pytest.mark.parametrize("silence", [None, np.array([np.nan, 0.0, 0.0]), np.array([0.0, np.inf, 0.0])])
def test_after_a_quarter_of_a_second_of_silence_the_base_ramps_down(silence):
    sent = run([np.array([0.5, 0.0, 0.2])] * 30 + [silence] * 60)
    np.testing.assert_allclose(sent[30 + 12], [0.5, 0.0, 0.2])
    assert sent[30 + 13, 0] < 0.5
    np.testing.assert_array_equal(sent[-1], 0.0)
    assert np.all(np.abs(np.diff(sent, axis=0)) <= np.array([2.5, 2.5, 1.0]) * PERIOD + 1e-9)


def test_the_state_says_whether_a_wish_was_held_back():
    state = base_velocity.init(BaseVelocityConfig(), 0.0)
    assert base_velocity.step(state, np.array([1.0, 0.0, 0.0]), PERIOD)[0].limited
    assert not base_velocity.step(state, np.array([0.01, 0.0, 0.0]), PERIOD)[0].limited
