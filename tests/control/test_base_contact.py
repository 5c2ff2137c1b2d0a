"""A base that pushes, or is held, is seen; one that drives, lags, slips or stands is not."""

import numpy as np
import pytest

from longreach.control import base_contact, safety
from longreach.control.hardware import Readings
from longreach.control.safety_checks import Health
from longreach.control.safety_config import BaseLimits, SafetyConfig
from longreach.measurement import Imu

_CONFIG = SafetyConfig(base=BaseLimits(velocity=(1.0, 1.0, 2.0), acceleration=(2.0, 2.0, 2.0)), stale_after={})


def _drive(asked, turned, moved, duration=3.0):
    """The reason after a drive along x, from speeds [m/s] over time."""
    state, x = base_contact.NOTHING, np.zeros(3)
    for k in range(round(duration / 0.008)):
        t = 0.008 * k
        x = x + 0.008 * np.array([f(t) for f in (asked, turned, moved)])
        poses = [np.array([value, 0.0, 0.0]) for value in x]
        state = base_contact.step(state, t, *poses)
        if state.reason:
            return t, state.reason
    return None, ""


def test_wheels_that_turn_while_the_base_stands_are_seen_within_two_seconds():
    t, reason = _drive(lambda t: 0.3, lambda t: 0.3, lambda t: 0.0)
    assert "pushes against something" in reason
    assert t < 2.0


def test_wheels_that_stand_while_they_are_commanded_are_seen_within_two_seconds():
    t, reason = _drive(lambda t: 0.3, lambda t: 0.0, lambda t: 0.0)
    assert "held by something" in reason
    assert t < 2.0


@pytest.mark.parametrize(
    ("turned", "moved"),
    [
        (lambda t: 0.5, lambda t: 0.5),
        (lambda t: 0.5 if t > 0.3 else 0.0, lambda t: 0.5 if t > 0.3 else 0.0),  # a driver's lag
        (lambda t: 0.5, lambda t: min(0.4 * t, 0.35)),  # slips as it starts
        (lambda t: 0.02, lambda t: 0.0),  # nearly stands
    ],
)
def test_what_is_usual_is_no_contact(turned, moved):
    asked = (lambda t: 0.5) if turned(1.0) > 0.1 else (lambda t: 0.02)
    assert _drive(asked, turned, moved) == (None, "")


def _gate(accelerations, gravity):
    state = safety.init(_CONFIG, 0.0)
    for k, level in enumerate(accelerations):
        now = 0.01 * (k + 1)
        imu = Imu(now, np.zeros(3), gravity + np.asarray(level))
        state, _ = safety.step(state, None, Readings(now, imu=(imu,)), Health(), now)
    return state.stop


@pytest.mark.parametrize("gravity", [np.array([0.0, 0.0, 9.8]), np.array([0.0, 9.8, 0.0])])  # however it is mounted
def test_a_jolt_across_gravity_is_a_contact_that_latches(gravity, rng):
    shaking = 1.5 * rng.standard_normal((100, 3))
    level = np.array([30.0, 0.0, 0.0])
    assert _gate(shaking, gravity).cause == "silence"  # nobody commands it, and nothing was hit
    stop = _gate([*shaking, level], gravity)
    assert stop.cause == "contact"
    assert stop.latched
    assert "hit something" in stop.reason


def test_a_bump_along_gravity_is_no_contact(rng):
    gravity = np.array([0.0, 0.0, 9.8])
    assert _gate([*(0.1 * rng.standard_normal((100, 3))), [0.0, 0.0, 30.0]], gravity).cause == "silence"
