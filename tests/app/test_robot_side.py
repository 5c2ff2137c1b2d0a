"""The robot's side: it does what it is asked for, as long as whoever asked is there, and stops within its limits."""

import numpy as np
import pytest

import longreach as lr
from longreach.app import robot_side, tracker
from longreach.app.configuration import EstimateConfig
from longreach.app.estimate import estimate
from longreach.app.goals import Follow, Hold, ServoGoal, VelocityGoal
from longreach.app.robot_side import Orders
from longreach.app.tracker import TrackerConfig
from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import Command, GripperCommand
from longreach.control.safety_config import SafetyConfig
from longreach.measurement import Recording
from longreach.sim.kinematic_robot import KinematicRobot

_CONFIG = TrackerConfig(
    estimate=EstimateConfig(sources=("wheels", "imu")),
    safety=SafetyConfig(stale_after={"joints": 0.1, "wheels": 0.2}, heartbeat_timeout=0.24),
)
_TWIST = np.array([0.3, 0.1, 0.2])


@pytest.fixture(scope="module")
def thing():
    return lr.load_robot("thing")


def _serve(thing, orders, duration):
    """Serve a simulated robot, whose time costs nothing; orders: from the time [s] to `Orders`."""
    body, records = KinematicRobot(thing, seed=2), []
    robot_side.run(
        body, lambda stamp: body.advance(max(stamp - body.stamp, 0.0)), thing, np.zeros(3), orders, records.append,
        lambda: "over" if body.stamp >= duration else "", _CONFIG,
    )  # fmt: skip
    return body, records


def _speeds(records):
    return np.array([m.tick.command.arm for m in records]), np.array([m.state.gate.twist for m in records])


def _within_limits(thing, records):
    arm, base = _speeds(records)
    hardest = thing.limits.acceleration * 0.008 + 1e-9
    assert np.all(np.abs(np.diff(arm, axis=0)) <= hardest[thing.arm])
    assert np.all(np.abs(np.diff(base, axis=0)) <= hardest[thing.base])


def test_a_robot_that_is_asked_for_nothing_stands(thing):
    body, records = _serve(thing, lambda now: Orders(), 0.2)
    arm, base = _speeds(records)
    assert not arm.any()
    assert not base.any()
    assert all(m.tick.stop is None for m in records)
    assert body.stopped == "over"


def test_it_drives_as_it_is_told_and_stands_when_nobody_tells_it_any_more(thing):
    def orders(now):
        told = VelocityGoal(Command(now, np.full(6, 0.1), base=_TWIST), now) if 0.1 < now < 0.6 else None
        return Orders(goal=told, heartbeat=now)

    _, records = _serve(thing, orders, 1.2)
    arm, base = _speeds(records)
    t = np.array([m.tick.stamp for m in records])
    assert np.allclose(base[(t > 0.4) & (t < 0.6)], _TWIST)
    assert np.allclose(arm[(t > 0.4) & (t < 0.6)], 0.1)
    assert np.abs(base[t > 0.6 + 0.25 + 0.25]).max() == 0.0
    assert isinstance(records[-1].state.goal, Hold)
    assert records[-1].tick.stop is None  # it is not stopped, it stands
    _within_limits(thing, records)


def test_a_tool_is_pulled_to_its_pose_while_the_base_stands(thing):
    T = thing.forward(thing.home)
    T[:3, 3] += [0.05, -0.04, 0.06]
    _, records = _serve(thing, lambda now: Orders(goal=ServoGoal(T) if now < 0.05 else None), 1.8)
    reached = thing.forward(np.concatenate([np.zeros(3), records[-1].tick.q[3:]]))
    assert np.linalg.norm(reached[:3, 3] - T[:3, 3]) < 1e-3
    assert not _speeds(records)[1].any()
    J = thing.forward_and_jacobian_batch(np.array([m.tick.q for m in records]))[1]
    speed = np.linalg.norm(np.einsum("nij,nj->ni", J[:, :3, thing.arm], _speeds(records)[0]), axis=1)
    assert 0.2 < speed.max() < 0.26
    _within_limits(thing, records)


def _turn(thing, by=0.3, time=1.0):
    goal = thing.home.copy()
    goal[3] += by
    return ConfigurationTrajectory(np.array([0.0, time]), np.stack([thing.home, goal]), (), np.zeros((2, 9)))


def test_a_plan_is_followed_to_its_end_as_the_tracker_follows_it_and_then_the_robot_stands(thing):
    plan, body, ticks = _turn(thing, 0.1, 0.4), KinematicRobot(thing, seed=2), []
    config = _CONFIG.model_copy(update={"before": 0.1, "after": 0.3})
    tracker.run(
        body, lambda stamp: body.advance(max(stamp - body.stamp, 0.0)), thing, plan, np.zeros(3),
        config, lambda tick, part: ticks.append(tick), lambda: body.stamp,
    )  # fmt: skip
    begun = ticks[0].stamp
    _, records = _serve(
        thing, lambda now: Orders(goal=Follow(plan, -0.1) if now <= begun else None), ticks[-1].stamp + 0.3
    )
    ours = {m.tick.stamp: m.tick.q for m in records}
    assert all(np.array_equal(tick.q, ours[tick.stamp]) for tick in ticks)
    assert records[-1].tick.q[3] == pytest.approx(0.1, abs=2e-3)
    assert max(m.state.goal.progress for m in records if isinstance(m.state.goal, Follow)) == 1.0
    assert isinstance(records[-1].state.goal, Hold)


def test_a_stop_brakes_within_the_limits_and_holds_until_the_reset(thing):
    def orders(now):
        asked = VelocityGoal(Command(now, np.full(6, 0.3), base=_TWIST), now)
        return Orders(goal=asked, stop="Stop!" if 0.5 < now < 0.51 else "", reset=1.0 < now < 1.01, heartbeat=now)

    _, records = _serve(thing, orders, 1.5)
    t = np.array([m.tick.stamp for m in records])
    _, base = _speeds(records)
    stopped = [m for m in records if m.tick.stop is not None]
    assert {m.tick.stop.reason for m in stopped} == {"Stop!"}
    assert stopped[0].tick.stamp - 0.5 < 0.02  # at the tick after it came
    assert np.abs(base[(t > 0.9) & (t < 1.0)]).max() == 0.0
    assert np.allclose(base[-1], _TWIST)
    _within_limits(thing, records)


def test_a_client_that_vanishes_stops_the_robot_and_ends_its_plan_in_the_same_tick(thing):
    plan, begin, back = _turn(thing, 0.5, 1.6), 0.4, 1.0

    def orders(now):
        heard = begin if begin < now < back else now
        return Orders(goal=Follow(plan, 0.0) if now < 0.01 else None, heartbeat=heard)

    _, records = _serve(thing, orders, 1.8)
    first = next(m for m in records if m.tick.stop is not None)
    assert first.tick.stop.cause == "client gone"
    assert first.tick.stamp - begin < 0.25
    assert isinstance(first.state.goal, Hold)
    arm, _ = _speeds(records)
    t = np.array([m.tick.stamp for m in records])
    assert np.abs(arm[t > begin + 0.45]).max() == 0.0
    assert records[-1].tick.stop is None
    assert 0.05 < records[-1].tick.q[3] < 0.45
    _within_limits(thing, records)


def test_a_halt_of_the_loop_is_no_contact_of_the_base(thing):
    """What the base was commanded last counts for as long as its driver goes on with it."""
    body, records, halted = KinematicRobot(thing, seed=2), [], []

    def wait_until(stamp):
        body.advance(max(stamp - body.stamp, 0.0))
        if stamp > 0.5 and not halted:
            halted.append(stamp)
            body.advance(10.0)

    robot_side.run(
        body, wait_until, thing, np.zeros(3),
        lambda now: Orders(VelocityGoal(Command(now, np.zeros(6), base=_TWIST), now)),
        records.append, lambda: "over" if body.stamp > 12.0 else "", _CONFIG,
    )  # fmt: skip
    assert {r.tick.stop.cause for r in records if r.tick.stop is not None} == {"late tick"}
    assert np.allclose(records[-1].state.gate.twist, _TWIST)


def test_the_pose_by_the_wheels_alone_is_the_one_of_an_estimate_from_the_recording(thing):
    def orders(now):
        return Orders(goal=VelocityGoal(Command(now, base=_TWIST), now), heartbeat=now)

    _, records = _serve(thing, orders, 1.0)
    wheels = tuple(w for m in records for w in m.readings.wheels)
    imu = tuple(i for m in records for i in m.readings.imu)
    path = estimate(Recording("again", wheels=wheels, imu=imu), thing).trajectories["wheels"]
    assert np.allclose(records[-1].wheels, path.poses[-1], atol=2e-3)  # the first reading belongs to the start


def test_the_fingers_do_what_they_are_told(thing):
    wish = GripperCommand("position", 0.3)
    _, records = _serve(thing, lambda now: Orders(gripper=wish if now < 0.01 else None), 1.0)
    assert records[-1].readings.gripper.closed == pytest.approx(0.3, abs=0.02)
