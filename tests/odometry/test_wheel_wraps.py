"""Angles and counters that start again: continued where that shows, at the same places for one record or many."""

import numpy as np
import pytest

from longreach.io.bag import read_bag
from longreach.io.robots import load_robot
from longreach.measurement import WheelTicks
from longreach.odometry import wheel
from longreach.robot.bases import DifferentialBase
from longreach.robot.description import Encoder, RobotDescription

DT = 0.05


def robot(**encoder):
    base = DifferentialBase(wheel_radius=0.1, track_width=0.5)
    limits = {"velocity_limits": (1.0, 1.0, 2.0)}  # a wheel turns by 0.75 rad in a step
    return RobotDescription(name="cart", base=base, encoder=Encoder(**encoder), **limits)


TICKS = {"signal": "ticks", "counts_per_revolution": 40000}


def angles(n=400):
    t = DT * np.arange(n)
    return np.column_stack([6.0 * t + np.sin(t), 5.0 * t - np.cos(t)])  # [rad]


def records(values, stamps=None):
    stamps = DT * np.arange(len(values)) if stamps is None else stamps
    return [WheelTicks(float(stamp), row) for stamp, row in zip(stamps, values, strict=True)]


def poses(found):
    return np.array([step.pose for step in found.measurements])


def wrapped(values, low, size):
    return (values - low) % size + low


@pytest.mark.parametrize("low", [-np.pi, 0.0])
def test_angles_that_wrap_are_continued(low):
    turned = angles()
    found = wheel.wheel_odometry(records(wrapped(turned, low, 2 * np.pi)), robot())
    plain = wheel.wheel_odometry(records(turned), robot())
    np.testing.assert_allclose(poses(found), poses(plain), atol=1e-12)
    wraps = np.count_nonzero(np.diff(np.floor((turned - low) / (2 * np.pi)), axis=0))
    assert (found.breaks, found.wraps, found.wrap_range) == (0, wraps, 2 * np.pi)
    assert (plain.breaks, plain.wraps, plain.wrap_range) == (0, 0, 0.0)


@pytest.mark.parametrize(("low", "size"), [(0, 2**16), (-(2**15), 2**16), (0, 2**32), (-(2**31), 2**32)])
def test_counters_that_start_again_are_continued(low, size):
    turned = np.rint(angles() / (2 * np.pi) * 40000) + (low + size - 3000)
    found = wheel.wheel_odometry(records(wrapped(turned, low, size)), robot(**TICKS))
    plain = wheel.wheel_odometry(records(turned - turned[0] + 10 * size), robot(**TICKS))
    np.testing.assert_allclose(poses(found), poses(plain), atol=1e-9)
    assert (found.breaks, found.wrap_range) == (0, size)
    assert found.wraps >= 2


def test_one_record_at_a_time_gives_the_same_to_the_last_bit():
    taken = records(wrapped(angles(), -np.pi, 2 * np.pi))
    state, steps = wheel.init(robot()), []
    for record in taken:
        state, more = wheel.step(state, [record])
        steps += more
    whole = wheel.wheel_odometry(taken, robot())
    np.testing.assert_array_equal([step.pose for step in steps], poses(whole))
    assert int(state.seen[3]) == whole.wraps


def test_where_a_wheel_may_turn_by_half_a_range_only_what_is_stated_is_continued():
    turned, slow = angles(60)[::10], DT * np.arange(60)[::10]  # a step of 3 rad and more
    stated = wheel.wheel_odometry(records(wrapped(turned, 0.0, 20.0), slow), robot(wrap_range=20.0))
    plain = wheel.wheel_odometry(records(turned, slow), robot())
    np.testing.assert_allclose(poses(stated), poses(plain), atol=1e-12)
    assert (stated.wraps, plain.wraps, len(plain.measurements)) == (0, 0, 5)


def test_nothing_is_taken_across_a_gap_that_a_wheel_may_turn_by_half_a_range_in():
    kept = [*range(100), *range(110, 200)]
    found = wheel.wheel_odometry(records(wrapped(angles(200), -np.pi, 2 * np.pi)[kept], DT * np.array(kept)), robot())
    assert (found.breaks, len(found.measurements)) == (1, len(kept) - 2)


def test_a_counter_that_is_reset_is_a_break():
    turned = angles(200) + 10.0
    turned[100:] -= turned[100]
    assert (
        wheel.wheel_odometry(records(turned), robot()).breaks,
        wheel.wheel_odometry(records(turned), robot()).wraps,
    ) == (1, 0)


def test_the_wheels_of_a_recording_with_wrapped_angles_are_within_a_millimetre(cases):
    case = cases / "a11_wheel_angle_wraps"
    description = load_robot(case / "robot.yaml").description
    recording = read_bag(case / "drive.mcap", description)
    found = wheel.wheel_odometry(recording.wheels, description)
    assert (found.breaks, found.wraps) == (0, 21)
    path = sum(float(np.hypot(*step.pose[:2])) for step in found.measurements)
    assert path == pytest.approx(5.164, abs=2e-3)
