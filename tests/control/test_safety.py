"""The last gate, told by what leaves it: every reason to stop, every limit, and that nothing beyond one ever leaves."""

import re
from dataclasses import replace

import numpy as np
import pytest
from control.recorded import NAMES, NOTHING, PERIOD, readings

from longreach.control import safety
from longreach.control.hardware import Command, GripperCommand
from longreach.control.safety_checks import Health, Innovation
from longreach.control.safety_config import SafetyConfig, limits_of
from longreach.measurement import JointState, WheelSpeeds, Wrench

CRUISE, TWIST = np.array([0.5, -0.2]), np.array([0.6, 0.0, 0.3])


@pytest.fixture
def config(capabilities):
    return limits_of(capabilities, SafetyConfig(stale_after={"joints": 0.1, "wheels": 0.2}, heartbeat_timeout=0.5))


class Run:
    """The gate before a robot that does perfectly what it is told; keeps what left."""

    def __init__(self, config, q=(0.0, 0.0)):
        self.now, self.q, self.state, self.left = 0.0, np.array(q), safety.init(config, 0.0), []
        self.mode, self.speed = "velocity", np.zeros(2)

    def tick(self, command="cruise", dt=PERIOD, health=None, **changes):
        if self.mode == "velocity":
            self.q = self.q + self.speed * dt
        self.now += dt
        if isinstance(command, str):
            command = Command(self.now, CRUISE, "velocity", TWIST)
        came = readings(self.now, self.q, **changes)
        self.state, out = safety.step(self.state, command, came, health or Health((), self.now), self.now)
        self.mode = out.arm_mode
        if out.arm is not None and self.mode == "position":
            self.speed, self.q = (out.arm - self.q) / min(dt, self.state.config.arm.period), out.arm
        elif out.arm is not None:
            self.speed = out.arm
        self.left.append((self.now, self.speed, out.base))
        return out

    def ticks(self, count, **arguments):
        for _ in range(count):
            out = self.tick(**arguments)
        return out

    def assert_accelerations_are_kept(self):
        config = self.state.config
        for part, limits in ((1, config.arm), (2, config.base)):
            values = np.array([row[part] for row in self.left])
            dt = np.diff([row[0] for row in self.left])
            assert np.all(np.abs(np.diff(values, axis=0)) <= (np.outer(dt, limits.acceleration) + 1e-9))
            assert np.all(np.abs(values) <= np.array(limits.velocity) + 1e-9)


@pytest.fixture
def moving(config):
    """A robot in the midst of a motion, watched by a healthy gate."""
    run = Run(config)
    out = run.ticks(100)
    np.testing.assert_array_equal(out.arm, CRUISE)
    np.testing.assert_allclose(out.base, TWIST)
    assert run.state.stop is None
    return run


def faulty(run, kind):
    """Arguments of a tick in which something is wrong."""
    bad = np.array([0.1, np.nan])
    return {
        "emergency stop": {"emergency_stop": True},
        "contact": {"wrenches": (Wrench(run.now, np.array([0.0, 80.0, 80.0]), np.zeros(3)),)},
        "torque": {"wrenches": (Wrench(run.now, np.zeros(3), np.array([0.0, 0.0, -16.0])),)},
        "divergence": {"health": Health((Innovation("lidar", 60.0, 3),), run.now + PERIOD)},
        "NaN in the NIS": {"health": Health((Innovation("lidar", np.nan, 3),), run.now + PERIOD)},
        "joints gone": {"joints": ()},
        "joints are NaN": {"joints": (JointState(run.now, NAMES, bad, NOTHING, NOTHING),)},
        "wheels gone": {"wheels": ()},
        "wheels stuck": {"wheels": (WheelSpeeds(0.5, np.zeros(4)),)},
        "wheels in the future": {"wheels": (WheelSpeeds(run.now + 9.0, np.zeros(4)),)},
        "client gone": {"health": Health((), 0.1)},
        "no heartbeat": {"health": Health()},
        "arm is NaN": {"command": Command(run.now, bad, "velocity", TWIST)},
        "base is infinite": {"command": Command(run.now, CRUISE, "velocity", np.array([0.1, np.inf, 0.0]))},
        "gripper is NaN": {"command": Command(run.now, CRUISE, gripper=GripperCommand("force", np.nan))},
        "too many joints": {"command": Command(run.now, np.zeros(3))},
        "far position": {"command": Command(run.now, np.array([0.95, 0.0]), "position", TWIST)},
        "stamp is NaN": {"command": Command(np.nan, CRUISE, "velocity", TWIST)},
        "silence": {"command": None},
        "old command": {"command": Command(run.now - 1.0, CRUISE, "velocity", TWIST)},
        "late tick": {"dt": 0.06},
    }[kind]


REASONS = {
    "emergency stop": "The emergency stop is pressed.",
    "contact": "touches something: 113 N, the limit is 100 N",
    "torque": "touches something: 16.0 N·m, the limit is 15 N·m",
    "divergence": "diverged: 15 measurements of lidar in a row",
    "NaN in the NIS": "diverged: 15 measurements of lidar in a row",
    "joints gone": "newest of joints is 0.104 s old; 0.1 s are allowed",
    "joints are NaN": "newest of joints is 0.104 s old",
    "wheels gone": "newest of wheels is 0.20. s old",
    "wheels stuck": "newest of wheels is 0.308 s old",
    "wheels in the future": "newest of wheels is -8.9",
    "client gone": "The client was not heard for 0.7",
    "no heartbeat": "The client was not heard for 0.8",
    "arm is NaN": "a number that is not finite",
    "base is infinite": "a number that is not finite",
    "gripper is NaN": "a number that is not finite",
    "too many joints": "arm has 3 numbers, but the arm has 2 joints",
    "far position": "position is 0.5. rad away; 0.3 rad are allowed",
    "stamp is NaN": "a number that is not finite",
    "silence": "There was no command for 0.26 s",
    "old command": "There was no command for 0.26 s",
    "late tick": "0.060 s went by since the last tick; 0.04 s are allowed",
}
LATCHED = {"emergency stop", "contact", "torque", "divergence", "NaN in the NIS"}


@pytest.mark.parametrize("kind", REASONS)
def test_every_reason_brakes_to_standstill_within_the_accelerations_and_says_why(moving, kind):
    for _ in range(40):
        moving.tick(**faulty(moving, kind))
        if moving.state.stop is not None:
            break
    assert re.search(REASONS[kind], moving.state.stop.reason), moving.state.stop.reason
    assert moving.state.stop.latched == (kind in LATCHED)
    since = moving.state.stop.since
    for _ in range(90):
        out = moving.tick(**faulty(moving, kind))
    np.testing.assert_array_equal(out.arm if out.arm_mode == "velocity" else moving.speed, 0.0)
    np.testing.assert_array_equal(out.base, 0.0)
    assert moving.state.stop.since == since
    moving.assert_accelerations_are_kept()


@pytest.mark.parametrize("kind", REASONS)
def test_a_grave_stop_holds_until_it_is_reset_and_every_other_ends_with_its_cause(moving, kind):
    for _ in range(50):
        moving.tick(**faulty(moving, kind))
    out = moving.ticks(100)
    if kind in LATCHED:
        np.testing.assert_array_equal(out.arm, 0.0)
        np.testing.assert_array_equal(out.base, 0.0)
        moving.state = safety.reset(moving.state)
        out = moving.ticks(100)
    np.testing.assert_allclose(out.arm, CRUISE)
    np.testing.assert_allclose(out.base, TWIST)
    assert moving.state.stop is None
    moving.assert_accelerations_are_kept()


def test_a_reset_while_the_button_is_still_pressed_stops_again(moving):
    moving.ticks(100, emergency_stop=True)
    moving.state = safety.reset(moving.state)
    out = moving.ticks(5, emergency_stop=True)
    np.testing.assert_array_equal(out.arm, 0.0)
    assert moving.state.stop.cause == "emergency stop"


@pytest.mark.parametrize("kind", sorted(REASONS.keys() - {"silence", "old command", "divergence", "NaN in the NIS"}))
def test_after_a_stop_only_a_new_command_moves_the_robot_again(moving, kind):
    while moving.state.stop is None:
        moving.tick(**faulty(moving, kind))
    moving.ticks(3, **faulty(moving, kind))
    moving.state = safety.reset(moving.state)
    sizes = [np.abs(moving.tick(command=None).base).max() for _ in range(20)]
    assert np.all(np.diff(sizes) < 0.0) or sizes[-1] == 0.0
    assert moving.state.stop is None or moving.state.stop.cause == "silence"


def test_a_streak_is_of_one_source_and_in_a_row(moving):
    far, near, nothing = (Innovation("lidar", nis, dof) for nis, dof in ((60.0, 3), (1.0, 3), (0.0, 0)))
    other = Innovation("wheels", 60.0, 3)
    for count in range(60):
        innovations = (near,) if count % 14 == 13 else (far, nothing)
        moving.tick(health=Health((*innovations, *((other,) if count % 6 == 0 else ())), moving.now))
    assert moving.state.stop is None


def test_a_command_that_stays_away_for_a_few_ticks_goes_on(moving):
    out = moving.ticks(30, command=None)
    np.testing.assert_array_equal(out.arm, CRUISE)
    out = moving.tick(command=Command(moving.now, base=np.zeros(3)))  # of the arm it says nothing
    np.testing.assert_array_equal(out.arm, CRUISE)
    assert moving.state.stop is None


def test_where_only_the_arm_falls_silent_the_base_goes_on(moving):
    for _ in range(90):
        out = moving.tick(command=Command(moving.now, base=TWIST))
    np.testing.assert_array_equal(out.arm, 0.0)
    np.testing.assert_allclose(out.base, TWIST)
    for _ in range(90):
        out = moving.tick(command=Command(moving.now, CRUISE))
    np.testing.assert_array_equal(out.base, 0.0)
    np.testing.assert_allclose(out.arm, CRUISE)
    assert moving.state.stop is None
    moving.assert_accelerations_are_kept()


def test_a_command_that_was_overtaken_by_a_newer_one_is_not_taken(moving):
    out = moving.tick(command=Command(moving.now - 0.1, -CRUISE, "velocity", -TWIST))
    np.testing.assert_array_equal(out.arm, CRUISE)
    np.testing.assert_allclose(out.base, TWIST)


def test_noise_of_the_joint_states_moves_no_arm_across_its_limit(config, rng):
    run = Run(config)
    for _ in range(400):
        noisy = JointState(
            run.now + PERIOD, NAMES, run.q + run.speed * PERIOD + 0.002 * rng.normal(size=2), *2 * [NOTHING]
        )
        run.tick(command=Command(run.now, np.array([2.0, 3.0])), joints=(noisy,))
        assert np.all(run.q <= [1.0, 2.0])
    assert np.all(run.q >= [0.97, 1.97])
    run.assert_accelerations_are_kept()


def test_an_arm_of_which_nothing_is_known_does_not_move(config):
    run = Run(config)
    out = run.ticks(5, joints=())
    np.testing.assert_array_equal(out.arm, 0.0)
    out = run.ticks(5, joints=(), command=Command(run.now, np.array([0.1, 0.1]), "position"))
    np.testing.assert_array_equal(out.arm, 0.0)
    assert run.tick().arm.any()


def test_a_wish_beyond_the_limits_keeps_its_direction(config):
    run, wish = Run(config), Command(0.0, np.array([4.0, 1.0]), "velocity", np.array([3.0, 1.0, 0.0]))
    for _ in range(25):
        out = run.tick(command=replace(wish, stamp=run.now))
        assert out.arm[0] == pytest.approx(4.0 * out.arm[1], abs=1e-12)
        np.testing.assert_allclose(np.cross(out.base, wish.base), 0.0, atol=1e-12)
    np.testing.assert_allclose(out.arm, [2.0, 0.5])
    assert run.state.limited
    for _ in range(40):
        out = run.tick(command=Command(run.now, np.zeros(2), "velocity", wish.base))
    np.testing.assert_allclose(out.base, [1.1, 1.1 / 3, 0.0])


def test_an_arm_driven_against_its_limit_comes_to_rest_there(config):
    run = Run(config)
    for _ in range(400):
        run.tick(command=Command(run.now, np.array([2.0, 0.0])))
        assert run.q[0] <= 0.99 + 1e-9  # the limit less the margin
    assert run.q[0] == pytest.approx(0.99, abs=1e-3)
    run.tick(command=Command(run.now, np.array([-1.0, 0.0])))
    assert run.speed[0] < 0.0  # away from it is free


@pytest.mark.parametrize("late", [1, 3])
def test_an_arm_whose_states_come_late_does_not_cross_its_limit(config, late):
    run, past = Run(config), []
    for _ in range(400):
        past.append(JointState(run.now, NAMES, run.q, NOTHING, NOTHING))
        run.tick(command=Command(run.now, np.array([2.0, 0.0])), joints=(past[-min(late, len(past))],))
        assert run.q[0] <= 1.0
    assert run.q[0] == pytest.approx(0.99, abs=2e-3)


def test_a_state_that_comes_late_is_carried_on_to_now(moving):
    past = [JointState(moving.now, NAMES, moving.q, NOTHING, NOTHING)]
    for _ in range(10):
        moving.tick(joints=tuple(past[-3:][:1]))
        np.testing.assert_allclose(moving.state.q, moving.q, atol=1e-12)
        past.append(JointState(moving.now, NAMES, moving.q, NOTHING, NOTHING))


@pytest.mark.parametrize("ticks", range(8, 24))
def test_from_positions_to_velocities_in_the_least_favourable_rhythm_no_limit_is_crossed(config, ticks):
    run, dt = Run(config.model_copy(update={"position_margin": 0.0, "position_lag": 9.0})), 0.0399
    for _ in range(ticks):
        run.tick(command=Command(run.now, np.array([3.0, 0.0]), "position"), dt=dt)
    run.tick(command=Command(run.now, np.array([9.0, 0.0])), dt=1e-4)
    for _ in range(30):
        run.tick(command=Command(run.now, np.array([9.0, 0.0])), dt=dt)
        assert run.q[0] <= 1.0 + 1e-9
    run.assert_accelerations_are_kept()


def test_beyond_its_limit_an_arm_can_only_come_back(config):
    run = Run(config, q=(1.2, 0.0))
    out = run.ticks(5, command=Command(0.0, np.array([1.0, 0.0])))
    np.testing.assert_array_equal(out.arm, 0.0)
    assert run.ticks(5, command=Command(0.0, np.array([-1.0, 0.0]))).arm[0] < 0.0


def test_positions_that_the_robot_can_follow_pass_unchanged(config):
    run = Run(config)
    for _ in range(300):
        t = run.now + PERIOD
        wish = np.array([0.4 * (1 - np.cos(t)), -0.2 * (1 - np.cos(2 * t))])
        np.testing.assert_allclose(run.tick(command=Command(t, wish, "position")).arm, wish, atol=1e-12)
    assert not run.state.limited


def test_a_step_of_the_commanded_position_is_followed_without_overshoot(config):
    run, goal = Run(config), np.array([0.25, -0.2])
    for _ in range(200):
        out = run.tick(command=Command(run.now, goal, "position"))
        assert np.all(np.abs(out.arm) <= np.abs(goal) + 1e-9)
    np.testing.assert_allclose(out.arm, goal, atol=1e-6)
    run.assert_accelerations_are_kept()


def test_a_clock_that_gives_no_number_or_runs_back_lets_nothing_new_leave(moving):
    for now in (np.nan, np.inf, -np.inf, 0.1):
        state, out = safety.step(moving.state, Command(0.8, CRUISE * 2), readings(0.8), Health((), 0.8), now)
        assert state.stop.cause == "late tick"
        assert np.isfinite(state.stamp)
        assert np.all(np.abs(out.arm) <= np.abs(CRUISE))
    assert safety.step(state, Command(0.108, CRUISE), readings(0.108), Health((), 0.108), 0.108)[0].stop is None


def test_the_gripper_is_held_to_its_limits_and_is_left_alone_in_a_stop(moving):
    cases = [("position", 1.3, 1.0), ("position", -1.0, 0.0), ("force", 90.0, 60.0), ("velocity", -3.0, -1.0)]
    for mode, wish, safe in cases:
        command = Command(moving.now, CRUISE, "velocity", TWIST, GripperCommand(mode, wish))
        assert moving.tick(command=command).gripper == GripperCommand(mode, safe)
    assert moving.tick(command=command, emergency_stop=True).gripper is None


def test_what_leaves_cannot_be_changed_by_who_gets_it(moving):
    out = moving.tick()
    with pytest.raises(ValueError, match="read-only"):
        out.arm[0] = 9.0


def test_a_base_without_an_arm_and_an_arm_without_a_base_have_a_gate(config):
    still = SafetyConfig(stale_after={})
    base = safety.init(still.model_copy(update={"base": config.base}), 0.0)
    _, out = safety.step(base, Command(PERIOD, base=TWIST), readings(PERIOD), Health(), PERIOD)
    assert out.arm is None
    assert out.base[0] == pytest.approx(0.02 * 0.6 / 0.6, abs=0.02)
    arm = safety.init(still.model_copy(update={"arm": config.arm}), 0.0)
    _, out = safety.step(arm, Command(PERIOD, CRUISE), readings(PERIOD), Health(), PERIOD)
    assert out.base is None
    assert out.arm.any()
    state, _ = safety.step(arm, Command(PERIOD, base=TWIST), readings(PERIOD), Health(), PERIOD)
    assert state.stop.reason == "The command moves a base, but there is none."
