"""Commands drawn at random, most of them beyond all reason: what leaves the gate is always within every limit."""

import os
from dataclasses import replace

import numpy as np
import pytest
from control.recorded import readings

from longreach.control import _limit_kernels, safety
from longreach.control._limit_kernels import limit
from longreach.control.hardware import Command
from longreach.control.safety_checks import Health, Innovation
from longreach.control.safety_config import SafetyConfig, limits_of
from longreach.io.robots import load_robot
from longreach.kernels import kernel
from longreach.measurement import Wrench
from longreach.robot.chain import JointLimits
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.sensors import JointTiming, SensorConfig, Timing

HOLD = 0.04
SLACK = 1e-9
RUNS = 15  # of the whole gate, each way of driving it
SIMULATED_RUNS = int(os.environ.get("LONGREACH_FUZZ_RUNS", "40"))  # of gate and simulated robot; 10 000 take minutes
THING = load_robot("thing")


def wishes(rng, v_max, count):
    """Velocities that stay for a while: nothing, reasonable ones, and far too much."""
    sizes = np.repeat(rng.choice([0.0, 0.3, 1.0, 5.0, 1e6], (count // 10 + 1, len(v_max))), 10, axis=0)[:count]
    ways = np.repeat(rng.uniform(-1, 1, (count // 5 + 1, len(v_max))), 5, axis=0)[:count]
    against = rng.choice([-1.0, 1.0], len(v_max))  # half of them always towards the same limit
    return sizes * v_max * np.where(rng.random(len(v_max)) < 0.5, ways, against * np.abs(ways))


@kernel
def drive(wish, dt, v_max, a_max, reach, sent, path):
    """The compiled clamp alone, before joints that do as they are told: rows 1, 2, … of sent and path, run by run."""
    for run in range(len(wish)):
        for k in range(dt.shape[1]):
            path[run, k + 1] = path[run, k] + sent[run, k] * dt[run, k]
            below, above = path[run, k + 1] + reach[run], reach[run] - path[run, k + 1]
            before, after = sent[run, k], sent[run, k + 1]
            limit(wish[run, k], before, dt[run, k], HOLD, v_max[run], a_max[run], below, above, after)


def test_ten_thousand_runs_keep_position_velocity_and_acceleration(rng):
    runs, ticks, n = 10_000, 50, 6
    v_max, a_max, reach = (rng.uniform(low, high, (runs, n)) for low, high in ((0.1, 3.0), (0.3, 20.0), (0.01, 1.5)))
    dt = rng.uniform(0.0, HOLD, (runs, ticks)) * rng.choice([0.0, 0.2, 1.0, 1.0], (runs, ticks))
    wish = wishes(rng, np.ones(runs * n), ticks).reshape(ticks, runs, n).swapaxes(0, 1) * v_max[:, None]
    sent, path = np.zeros((runs, ticks + 1, n)), np.zeros((runs, ticks + 1, n))
    path[:, 0] = rng.uniform(-1, 1, (runs, n)) * reach
    drive(np.ascontiguousarray(wish), dt, v_max, a_max, reach, sent, path)
    assert np.all(np.abs(sent) <= v_max[:, None] + SLACK)
    assert np.all(np.abs(np.diff(sent, axis=1)) <= dt[:, :, None] * a_max[:, None] + SLACK)
    assert np.all(np.abs(path) <= reach[:, None] + SLACK)
    assert np.mean(np.abs(sent[:, -1]) > 0.01) > 0.2


def surroundings(rng, now, q, quiet):
    """What the robot says and what is known of the estimate: mostly nothing special."""
    changes = {}
    if not quiet and rng.random() < 0.1:
        changes["joints"] = ()
    if not quiet and rng.random() < 0.3:
        changes["wheels"] = ()
    if rng.random() < 0.004:
        changes["emergency_stop"] = True
    if rng.random() < 0.004:
        changes["wrenches"] = (Wrench(now, rng.normal(size=3) * 100, np.zeros(3)),)
    heard = now if rng.random() < 0.98 else now - 1.0
    return readings(now, q, **changes), Health((Innovation("lidar", rng.choice([1.0, 1.0, 1.0, 60.0]), 3),), heard)


def drawn(rng, now, mode, wish, q):
    """A command, or none, or one that is broken."""
    draw = rng.random()
    if draw < 0.1:
        return None
    base = rng.uniform(-3, 3, 3)
    step = np.sign(wish) * rng.choice([0.01, 0.1, 0.25, 0.25, 0.25, 0.5])
    arm = q + step if mode == "position" else wish.copy()
    if draw < 0.12:
        arm[rng.integers(2)] = rng.choice([np.nan, np.inf, -np.inf])
    if draw > 0.97:
        base[rng.integers(3)] = np.nan
    return Command(now - (1.0 if rng.random() < 0.02 else 0.01), arm, mode, base)


def driven(rng, config, mode, ticks):
    """Rows of dt, position, velocity and twist that left the gate, one a tick, of a robot that does as it is told."""
    lower, upper, v_max, _ = config.arm_arrays
    now, q, v = 0.0, rng.uniform(lower, upper), np.zeros(2)
    state, rows, quiet = safety.init(config, now, q), [], rng.random() < 0.5
    wish, steps = wishes(rng, v_max, ticks), np.where(np.arange(ticks) % 3, rng.uniform(0.0, HOLD, ticks), 0.008)
    for k, dt in enumerate(steps.tolist()):
        now += dt
        if state.desired.arm_mode == "velocity":
            q = q + v * dt
        came, health = surroundings(rng, now, q, quiet)
        wanted = ("velocity", "position")[(k // 7) % 2] if mode == "either" else mode
        state, out = safety.step(state, drawn(rng, now, wanted, wish[k], q), came, health, now)
        if out.arm_mode == "position":
            v, q = (out.arm - q) / min(dt, config.arm.period), out.arm
        else:
            v = out.arm
        rows.append((dt, q, v, out.base))
        if state.stop is not None and state.stop.latched and rng.random() < 0.2:
            state = safety.reset(state)
    return (np.array(column) for column in zip(*rows, strict=True))


@pytest.mark.parametrize("mode", ["velocity", "position", "either"])
def test_whatever_is_commanded_and_whatever_happens_the_whole_gate_keeps_every_limit(rng, capabilities, mode):
    sources = {"joints": 0.1, "wheels": 0.1}
    config = limits_of(capabilities, SafetyConfig(stale_after=sources, heartbeat_timeout=0.5, divergence_streak=4))
    lower, upper, v_max, a_max = config.arm_arrays
    moved = 0.0
    for _ in range(RUNS):
        dt, q, v, twist = driven(rng, config, mode, 60)
        assert np.all(np.abs(v) <= v_max + 1e-6)
        assert np.all(np.abs(np.diff(v, axis=0)) <= np.outer(dt[1:], a_max) + 1e-6)
        assert np.all((q >= lower - SLACK) & (q <= upper + SLACK))
        assert np.all(np.abs(twist) <= config.base_arrays[0] + SLACK)
        assert np.all(np.abs(np.diff(twist, axis=0)) <= np.outer(dt[1:], config.base_arrays[1]) + SLACK)
        moved = max(moved, np.abs(v).max())
    assert moved > 0.5  # it was not a gate that is always shut


def simulated(rng, capabilities, config, mode, ticks):
    """Rows of dt, command sent, and where the robot then really was, of a simulated robot whose sensors fail a lot."""
    sensors = SensorConfig(
        wheels=Timing(rate=50.0, dropout=0.05), joints=JointTiming(rate=125.0, dropout=rng.choice([0.0, 0.1]))
    )
    robot = KinematicRobot(
        THING, seed=int(rng.integers(1 << 30)), config=KinematicConfig(sensors=sensors, present=("wheels", "joints"))
    )
    v_max, rows = config.arm_arrays[2], []
    state, wish = safety.init(config, 0.0, THING.home[THING.arm]), wishes(rng, v_max, ticks)
    for k in range(ticks):
        dt = 0.001 * rng.choice([4, 8, 8, 8, 20])
        robot.advance(dt)
        came, now = robot.read(), robot.stamp
        if rng.random() < 0.004:
            came = replace(came, emergency_stop=True)
        health = Health((Innovation("lidar", rng.choice([1.0, 1.0, 1.0, 60.0]), 3),), now - rng.choice([0.0, 0.0, 0.3]))
        wanted = ("velocity", "position")[(k // 7) % 2] if mode == "either" else mode
        q = robot.truth().q[THING.arm]
        state, out = safety.step(state, drawn(rng, now, wanted, wish[k], q), came, health, now)
        rows.append((dt, out, q))
        robot.write(out)
        if state.stop is not None and state.stop.latched and rng.random() < 0.2:
            state = safety.reset(state)
    return rows


@pytest.mark.parametrize("mode", ["velocity", "position", "either"])
def test_no_command_beyond_a_limit_leaves_the_gate_of_a_simulated_robot(rng, mode):
    home, all_of = THING.home[THING.arm], THING.limits
    limits = JointLimits(  # narrower than the robot's own, which would hold it by itself
        home - 0.4, home + 0.4, all_of.velocity[3:], all_of.acceleration[3:], all_of.effort[3:]
    )
    capabilities = replace(KinematicRobot(THING).capabilities, arm_limits=limits)
    config = limits_of(capabilities, SafetyConfig(stale_after={"joints": 0.1, "wheels": 0.2}, divergence_streak=4))
    moved, farthest = 0.0, 0.0
    for _ in range(SIMULATED_RUNS // 3):
        rows = simulated(rng, capabilities, config, mode, 40)
        dt, q = np.array([row[0] for row in rows]), np.array([row[2] for row in rows])
        twist = np.array([row[1].base for row in rows])
        assert np.all(np.abs(twist) <= config.base_arrays[0] + SLACK)
        assert np.all(np.abs(np.diff(twist, axis=0)) <= np.outer(dt[1:], config.base_arrays[1]) + SLACK)
        speeds = np.array([row[1].arm for row in rows if row[1].arm_mode == "velocity"]).reshape(-1, 6)
        angles = np.array([row[1].arm for row in rows if row[1].arm_mode == "position"]).reshape(-1, 6)
        assert np.all(np.abs(speeds) <= limits.velocity + 1e-6)
        assert np.all((angles >= limits.lower - SLACK) & (angles <= limits.upper + SLACK))
        if mode == "velocity":
            assert np.all(np.abs(np.diff(speeds, axis=0)) <= np.outer(dt[1:], limits.acceleration) + 1e-6)
        farthest = max(farthest, np.abs(q - home).max())
        moved = max(moved, np.abs(np.diff(q, axis=0)).max())
    assert farthest <= 0.4 + 1e-3
    assert moved > 0.005


def test_the_clamp_finds_the_largest_part_of_a_wish_that_can_be_done(rng):
    """Two roads: the closed form, and trying many parts."""
    n = 3
    for _ in range(300):
        v_max, a_max, wish = rng.uniform(0.5, 2.0, n), rng.uniform(1.0, 9.0, n), rng.normal(size=n)
        before, dt, room = rng.normal(size=n) * 0.1, 0.04, np.full(n, np.inf)
        out = np.empty(n)
        changed = _limit_kernels.limit(wish, before, dt, HOLD, v_max, a_max, room, room, out)
        parts = np.linspace(0.0, 1.0, 2001)
        tried = parts[:, None] * wish
        good = np.all((np.abs(tried) <= v_max) & (np.abs(tried - before) <= a_max * dt), axis=1)
        if good.any():
            np.testing.assert_allclose(out, parts[good].max() * wish, atol=2e-3)
            assert changed == (not good[-1])


def test_braking_speed_is_the_root_of_the_braking_distance(rng):
    for room, a, hold in rng.uniform(0.01, 5.0, (100, 3)).tolist():
        v = _limit_kernels.braking_speed(room, a, hold)
        assert v * v / (2 * a) + v * hold == pytest.approx(room)
    assert _limit_kernels.braking_speed(-0.1, 1.0, 0.1) == 0.0
    assert _limit_kernels.braking_speed(np.inf, 1.0, 0.1) == np.inf
