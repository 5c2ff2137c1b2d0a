"""PID: textbook responses, an integral that does not wind up, a derivative that is filtered."""

import numpy as np
import pytest

from longreach.control import pid
from longreach.control.pid import PidConfig


def run(config, errors, dt=0.01):
    """Outputs for a row of errors of one joint."""
    state, outputs = pid.init(1), []
    for error in errors:
        state, u = pid.step(config, state, np.array([error]), dt)
        outputs.append(u[0])
    return np.array(outputs)


def test_each_gain_multiplies_its_own_part():
    errors, dt = 0.1 * np.arange(101) * 0.01, 0.01  # growing by 0.1 a second, for a second
    free = {"p": (0.0,), "output_limit": (np.inf,), "derivative_time": 0.0}
    assert run(PidConfig(**{**free, "p": (3.0,)}), errors, dt)[-1] == pytest.approx(0.3)
    assert run(PidConfig(i=(2.0,), **free), errors, dt)[-1] == pytest.approx(2.0 * 0.1 / 2, rel=0.02)
    assert run(PidConfig(d=(4.0,), **free), errors, dt)[-1] == pytest.approx(0.4)


def test_the_derivative_is_a_first_order_lag():
    out = run(PidConfig(p=(0.0,), d=(1.0,), derivative_time=0.1), 0.5 * np.arange(1001) * 1e-4, 1e-4)
    np.testing.assert_allclose(out[1000], 0.5 * (1 - np.exp(-1.0)), rtol=2e-3)  # after one time constant


def test_a_saturated_output_does_not_wind_up_the_integral():
    config = PidConfig(p=(1.0,), i=(1.0,), output_limit=(0.5,))
    out = run(config, np.concatenate([np.full(1000, 2.0), np.full(10, -0.1)]))
    np.testing.assert_array_equal(out[:1000], 0.5)
    assert out[1000] < 0.0  # with windup it would stay at the limit for many seconds


def test_an_integral_still_fills_up_to_the_limit_and_removes_a_constant_disturbance():
    config, x, state = PidConfig(p=(2.0,), i=(4.0,), output_limit=(1.0,)), 0.0, pid.init(1)
    for _ in range(2000):
        state, u = pid.step(config, state, np.array([1.0 - x]), 0.01)
        x += 0.01 * (u[0] - 0.3)
    assert x == pytest.approx(1.0, abs=1e-3)


def test_an_error_that_is_no_number_is_taken_as_none():
    out = run(PidConfig(p=(1.0,), i=(1.0,), d=(0.1,)), [0.1, np.nan, np.inf, 0.1, 0.1])
    assert np.all(np.isfinite(out))


def test_gains_may_differ_from_joint_to_joint():
    _, u = pid.step(PidConfig(p=(1.0, 2.0)), pid.init(2), np.array([0.1, 0.1]), 0.01)
    np.testing.assert_allclose(u, [0.1, 0.2])
