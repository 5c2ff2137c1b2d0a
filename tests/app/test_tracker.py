"""The loop: it follows a plan on its own estimate, and what goes wrong ends in a stop within the limits."""

from dataclasses import replace

import numpy as np
import pytest

import longreach as lr
from longreach.app import tracker
from longreach.app.configuration import EstimateConfig
from longreach.app.tracker import TrackerConfig
from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import Readings
from longreach.control.safety_config import SafetyConfig
from longreach.control.whole_body import WholeBodyConfig
from longreach.errors import ControlError
from longreach.measurement import Wrench
from longreach.planning.planner import plan
from longreach.planning.reference import dual_trajectory
from longreach.planning.timing import eased
from longreach.sim.kinematic_robot import KinematicRobot

_SILENCE = 1.0  # when what goes wrong does so [s]
_CONFIG = TrackerConfig(
    estimate=EstimateConfig(sources=("wheels", "imu")),
    safety=SafetyConfig(stale_after={"joints": 0.1, "wheels": 0.2}),
)


@pytest.fixture(scope="module")
def thing():
    return lr.load_robot("thing")


@pytest.fixture(scope="module")
def line(thing):
    """A plan of 0.2 m in 2 s, from rest to rest."""
    q0 = thing.home
    reference = dual_trajectory(thing.forward(q0), q0[:3], 0.2, 0.02, waypoints=21, duration=2.0)
    return eased(plan(thing, reference, q0, iterations=20), 0.5)


class Tampered:
    """A robot whose readings are changed on their way, and whose commands are kept."""

    def __init__(self, robot, change=lambda readings: readings):
        self.robot, self.change, self.capabilities = robot, change, robot.capabilities
        self.written, self.reasons = [], []

    def read(self):
        return self.change(self.robot.read())

    def write(self, command):
        self.written.append(command)
        self.robot.write(command)

    def stop(self, reason):
        self.reasons.append(reason)
        self.robot.stop(reason)

    def wait_until(self, stamp):
        self.robot.advance(max(stamp - self.robot.stamp, 0.0))


def _drive(thing, line, change=lambda readings: readings, config=_CONFIG, **more):
    hardware = Tampered(KinematicRobot(thing, seed=3), change)
    return hardware, tracker.run(hardware, hardware.wait_until, thing, line, np.zeros(3), config, **more)


def _after(stamp, **changes):
    return lambda readings: replace(readings, **changes) if readings.stamp >= stamp else readings


def _tools(thing, run):
    q, q_reference = (np.array([getattr(t, name) for t in run.ticks]) for name in ("q", "q_reference"))
    return thing.forward(q)[:, :3, 3], thing.forward(q_reference)[:, :3, 3]


def _within_limits(hardware):
    """Whether speeds and their changes from one command to the next are what the robot can do, base and arm."""
    capabilities = hardware.capabilities
    arm = np.array([c.arm for c in hardware.written])
    stamps = np.array([c.stamp for c in hardware.written])
    assert np.all(np.abs(arm) <= capabilities.arm_limits.velocity + 1e-9)
    dt = np.diff(stamps)[:, None]
    assert np.all(np.abs(np.diff(arm, axis=0)) <= capabilities.arm_limits.acceleration * dt + 1e-9)
    sent = [(c.stamp, c.base) for c in hardware.written if c.base is not None]
    base, dt = np.array([b for _, b in sent]), np.diff([s for s, _ in sent])[:, None]
    assert np.all(np.abs(base) <= capabilities.base_velocity + 1e-9)
    assert np.all(np.abs(np.diff(base, axis=0)) <= capabilities.base_acceleration * dt + 1e-9)


def test_the_tool_follows_its_plan_where_the_robot_thinks_it_is(thing, line):
    hardware, run = _drive(thing, line)
    tool, goal = _tools(thing, run)
    assert np.linalg.norm(tool - goal, axis=1).max() < 0.003
    assert run.reason == ""
    assert hardware.reasons == ["The plan has ended."]
    _within_limits(hardware)


def test_the_base_is_told_50_times_a_second_and_the_arm_125_times(thing, line):
    hardware, run = _drive(thing, line)
    told = sum(command.base is not None for command in hardware.written)
    assert all(command.arm is not None for command in hardware.written)
    assert told / len(hardware.written) == pytest.approx(50 / 125, abs=0.02)
    assert run.ticker.ticks == len(run.ticks)


def test_closed_on_the_estimate_the_hand_errs_less_than_open(thing, line):
    truth = {}
    for loop in ("open", "closed"):
        config = _CONFIG.model_copy(update={"whole_body": WholeBodyConfig(loop=loop)})
        hardware, run = _drive(thing, line, config=config)
        last = hardware.robot.truths()[-1].tool[:3, 3]
        truth[loop] = np.linalg.norm(last - thing.forward(line.q[-1])[:3, 3])
        estimate_error = np.linalg.norm(last - _tools(thing, run)[0][-1])
    assert truth["closed"] <= estimate_error + 0.001  # what is left is what the estimate does not know


@pytest.mark.parametrize(
    ("name", "change", "cause"),
    [
        ("stop pressed", _after(_SILENCE, emergency_stop=True), "emergency stop"),
        ("contact", _after(_SILENCE, wrenches=(Wrench(1.0, np.array([0.0, 0.0, 150.0]), np.zeros(3)),)), "contact"),
    ],
)
def test_what_must_hold_ends_the_run(thing, line, name, change, cause):
    hardware, run = _drive(thing, line, change)
    assert run.ticks[-1].stop.cause == cause
    assert run.reason == run.ticks[-1].stop.reason == hardware.reasons[0]
    assert run.ticks[-1].stamp == pytest.approx(_SILENCE, abs=0.02)
    _within_limits(hardware)


def test_an_estimate_that_diverges_ends_the_run(thing, line):
    def shaken(readings):
        if readings.stamp < _SILENCE:
            return readings
        imu = tuple(replace(m, angular_velocity=m.angular_velocity + 3.0) for m in readings.imu)
        return replace(readings, imu=imu)

    hardware, run = _drive(thing, line, shaken)
    assert run.ticks[-1].stop.cause == "divergence"
    _within_limits(hardware)


def test_numbers_that_are_none_stop_nothing_but_are_not_followed(thing, line):
    def spoilt(readings):
        if not 1.0 < readings.stamp < 1.05:
            return readings
        joints = tuple(replace(j, position=np.full(len(j.names), np.nan)) for j in readings.joints)
        return replace(readings, joints=joints)

    hardware, run = _drive(thing, line, spoilt)
    assert run.reason == ""
    assert all(np.isfinite(c.arm).all() for c in hardware.written)
    _within_limits(hardware)


@pytest.mark.parametrize(("silence", "ends"), [(0.35, False), (0.8, True)])
def test_stale_data_brakes_the_robot_and_the_plan_waits_for_a_short_time_alone(thing, line, silence, ends):
    def silent(readings):
        return replace(readings, wheels=()) if 1.0 < readings.stamp < 1.0 + silence else readings

    hardware, run = _drive(thing, line, silent)
    stopped = [tick for tick in run.ticks if tick.stop is not None]
    assert {tick.stop.cause for tick in stopped} == {"stale data"}
    tool, goal = _tools(thing, run)
    if ends:
        assert "The newest of wheels is" in run.reason
        assert run.ticks[-1].stamp < 1.0 + silence
    else:
        assert run.reason == ""  # and goes on afterwards
        assert run.ticks[-1].stamp > line.duration + 0.1
        assert np.linalg.norm(tool[-1] - goal[-1]) < 0.003
    _within_limits(hardware)


@pytest.mark.parametrize(("halt", "ends"), [(0.1, False), (0.3, True), (5.0, True)])
def test_a_loop_that_was_halted_itself_does_not_go_on_with_its_plan(thing, line, halt, ends):
    """A process may be stopped for a while, and the robot meanwhile stops by itself; its clock goes on."""
    body, halted = KinematicRobot(thing, seed=3), []

    def wait_until(stamp):
        body.advance(max(stamp - body.stamp, 0.0))
        if stamp > 1.0 and not halted:
            halted.append(stamp)
            body.advance(halt)

    run = tracker.run(body, wait_until, thing, line, np.zeros(3), _CONFIG)
    stops = [tick.stop for tick in run.ticks if tick.stop is not None]
    assert {stop.cause for stop in stops} == {"late tick"}
    if ends:
        assert "went by since the last tick" in run.reason
        assert run.ticks[-1].stamp == pytest.approx(1.0 + halt, abs=0.02)
    else:
        assert run.reason == ""


def test_a_client_that_vanishes_ends_the_run(thing, line):
    safety = _CONFIG.safety.model_copy(update={"heartbeat_timeout": 0.25})
    config = _CONFIG.model_copy(update={"safety": safety, "after": 0.0})
    hardware = Tampered(KinematicRobot(thing, seed=3))
    run = tracker.run(
        hardware, hardware.wait_until, thing, line, np.zeros(3), config,
        heartbeat=lambda: min(hardware.robot.stamp, 1.0),
    )  # fmt: skip
    last = run.ticks[-1]
    assert last.stop.cause == "client gone"
    assert last.stamp == pytest.approx(1.25, abs=0.02)
    assert hardware.reasons == [run.reason] == [last.stop.reason]
    _within_limits(hardware)


def test_a_plan_that_cannot_be_driven_is_refused_before_anything_moves(thing, line):
    hardware = Tampered(KinematicRobot(thing))
    with pytest.raises(ControlError, match=r"begins 1\.00 rad or m away"):
        tracker.run(hardware, hardware.wait_until, thing, line, np.array([1.0, 0.0, 0.0]))
    few = ConfigurationTrajectory(np.array([0.0, 1.0]), np.zeros((2, 6)))
    with pytest.raises(ControlError, match="6 joints, but thing has 9"):
        tracker.run(hardware, hardware.wait_until, thing, few, np.zeros(3))
    assert hardware.written == []


def test_a_robot_that_does_not_say_where_its_arm_is_is_not_driven(thing, line):
    hardware = Tampered(KinematicRobot(thing), lambda readings: Readings(readings.stamp))
    with pytest.raises(ControlError, match=r"has not said in 2 s where its arm is"):
        tracker.run(hardware, hardware.wait_until, thing, line, np.zeros(3))
