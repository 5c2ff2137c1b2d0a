"""Readings that are wrong while they come are said in the sentences of a recording, counted, and nothing stops."""

from dataclasses import replace

import numpy as np
import pytest

import longreach as lr
from longreach.app import robot_side
from longreach.app.goals import VelocityGoal
from longreach.app.readings_check import ReadingsCheck, finding
from longreach.app.robot_side import Orders
from longreach.app.tracker import TrackerConfig
from longreach.control.hardware import Command
from longreach.control.safety_config import SafetyConfig
from longreach.measurement import WheelTicks
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot

_G = np.array([0.0, 0.0, 9.80665])


@pytest.fixture(scope="module")
def thing():
    return lr.load_robot("thing")


class Spoiled(KinematicRobot):
    """A robot whose readings are spoiled, from their kind to a function of one."""

    def __init__(self, thing, spoil):
        super().__init__(thing, seed=5, config=KinematicConfig(present=("wheels", "imu", "joints", "lidar")))
        self._spoil = spoil

    def read(self):
        return _spoiled(super().read(), self._spoil)


def _spoiled(readings, spoil):
    return replace(readings, **{kind: tuple(map(wrong, getattr(readings, kind))) for kind, wrong in spoil.items()})


def _run(thing, spoil, publish, duration, drives=False):
    body = Spoiled(thing, spoil)

    def orders(now):
        command = Command(now, np.zeros(6), base=np.array([0.3, 0.0, 0.6 + 0.4 * np.sin(now)]))
        return Orders(goal=VelocityGoal(command, now) if drives else None)

    robot_side.run(
        body, lambda stamp: body.advance(max(stamp - body.stamp, 0.0)), thing, np.zeros(3), orders, publish,
        lambda: "over" if body.stamp >= duration else "", TrackerConfig(safety=SafetyConfig(obstacles=False)),
    )  # fmt: skip


def _said(thing, taken):
    """What is said of what was read and given."""
    check = ReadingsCheck(thing.description)
    for readings, given in taken:
        check.take(readings, given)
    check._looks.join(20.0)
    return check.remarks


@pytest.fixture(scope="module")
def standing(thing):
    """All that a robot reads that stands for ten seconds, since 1970."""
    taken, since = [], 1.6e9
    _run(thing, {}, lambda record: taken.append(record.readings), 10.2)

    def later(one):
        return replace(one, stamp=one.stamp + since)

    kinds = dict.fromkeys(("wheels", "imu", "scans"), later)
    return [replace(_spoiled(one, kinds), stamp=one.stamp + since) for one in taken]


def _every(n, wrong):
    """Spoil every n-th reading."""
    count = iter(range(10**9))
    return lambda one: wrong(one) if next(count) % n == n - 1 else one


WRONG = {
    "no gyro": ({"imu": lambda one: replace(one, angular_velocity=np.zeros(3))}, "so there is no gyro"),
    "degrees": ({"imu": lambda one: replace(one, angular_velocity=one.angular_velocity + 30.0)}, "which no base does"),
    "upside down": ({"imu": lambda one: replace(one, acceleration=-one.acceleration)}, "feels gravity downwards"),
    "in g": ({"imu": lambda one: replace(one, acceleration=one.acceleration / 9.80665)}, "acceleration is 1.00"),
    "NaN": (
        {"imu": _every(50, lambda one: replace(one, angular_velocity=np.full(3, np.nan)))},
        "messages of imu cannot be used and were left out: each has an angular velocity that is not finite",
    ),
    "wheels of NaN": ({"wheels": _every(50, lambda one: replace(one, ticks=np.full(4, np.nan)))}, "each is not finite"),
    "wrong length": (
        {"wheels": _every(50, lambda one: WheelTicks(one.stamp, one.ticks[:3]))},
        "each has 3 numbers for 4 wheels",
    ),
    "mm": (
        {"scans": lambda one: replace(one, ranges=1e3 * one.ranges, range_max=1e5)},
        "Half of the ranges are beyond",
    ),
    "1970": ({"imu": _every(9, lambda one: replace(one, stamp=0.0))}, "have no stamp"),
    "another clock": ({"imu": lambda one: replace(one, stamp=one.stamp + 1e5)}, "imu is on another clock"),
    "backwards": ({"imu": _every(9, lambda one: replace(one, stamp=one.stamp - 0.2))}, "stamps of imu run backwards"),
}


@pytest.mark.parametrize(("spoil", "words"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_said_as_of_a_recording(thing, standing, spoil, words):
    remarks = _said(thing, [(_spoiled(readings, spoil), None) for readings in standing])
    assert any(words in remark for remark in remarks), remarks
    assert all(remark.endswith(".") and "; " not in remark for remark in remarks)


@pytest.mark.parametrize("spoil", [spoil for spoil, _ in WRONG.values()], ids=WRONG)
def test_whatever_is_wrong_the_robot_goes_on(thing, spoil):
    ticks = []
    _run(thing, spoil, ticks.append, 1.0)
    assert len(ticks) > 120
    assert np.isfinite(ticks[-1].tick.q).all()


def test_of_a_robot_that_stands_as_it_should_there_is_nothing_to_say(thing, standing):
    assert _said(thing, [(readings, None) for readings in standing]) == ()


@pytest.mark.parametrize(("sign", "words"), [(1.0, ""), (-1.0, "gyro turns -1")])
def test_a_gyro_of_the_wrong_sign_is_named_while_the_robot_drives(thing, sign, words):
    taken = []
    spoil = {"imu": lambda one: replace(one, angular_velocity=sign * one.angular_velocity)}
    _run(thing, spoil, lambda record: taken.append((record.readings, record.state.given)), 10.4, drives=True)
    assert words in "".join(_said(thing, taken))
    assert bool(words) == bool(_said(thing, taken))


def test_what_was_done_about_a_finding_is_not_said_where_nothing_was_done():
    assert finding("The scans' angles span 360 rad; they were taken as degrees.") == "The scans' angles span 360 rad."
