"""The robot's side after its client is gone, and after every kind of stop: it holds until it is commanded anew."""

from types import SimpleNamespace

import numpy as np
import pytest

import longreach as lr
from longreach.app import robot_side
from longreach.app.configuration import EstimateConfig
from longreach.app.goals import Hold
from longreach.app.tracker import TrackerConfig
from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import GripperCommand
from longreach.control.safety_config import SafetyConfig
from longreach.io import messages
from longreach.live.protocol import commands, topics
from longreach.live.protocol.message_header import pack_header
from longreach.live.protocol.topics import TYPES
from longreach.live.server import listener
from longreach.live.server.authentication import Authentication, RejectionCounts
from longreach.live.server.listener import Listener
from longreach.live.server.server import HEARTBEAT_TIMEOUT
from longreach.sim.kinematic_robot import KinematicRobot

_CONFIG = TrackerConfig(
    estimate=EstimateConfig(sources=("wheels", "imu")),
    safety=SafetyConfig(stale_after={"joints": 0.1, "wheels": 0.2}, heartbeat_timeout=HEARTBEAT_TIMEOUT),
)
_SENDER, _PERIOD, _BRAKING = bytes(range(16)), 0.02, 0.5  # how often a client sends, and within what it stands [s]


@pytest.fixture(scope="module")
def thing():
    return lr.load_robot("thing")


class _Session:
    """Takes the place of a network: what is sent is heard at once."""

    def __init__(self):
        self.heard, self.asked, self.number = {}, {}, 0

    def declare_subscriber(self, key, take):
        self.heard[key] = take

    def declare_queryable(self, key, answer):
        self.asked[key] = answer

    def send(self, topic, message, sender=_SENDER):
        self.number += 1
        return SimpleNamespace(payload=topic.pack(message), attachment=pack_header(self.number, sender))

    def deliver(self, topic, sample):
        if topic.key in self.heard:
            self.heard[topic.key](sample)
        else:
            self.asked[topic.key](_Query(sample))


class _Query(SimpleNamespace):
    def __init__(self, sample):
        super().__init__(payload=sample.payload, attachment=sample.attachment)

    def reply(self, key, payload, attachment=None):
        self.answer = topics.ORDER.unpack(payload).data

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


class _Robot:
    """A simulated robot behind a server's listener, in time that costs nothing; `script` acts before each tick."""

    def __init__(self, thing, script, seed=0):
        self.body, self.session, self.records, self.script = KinematicRobot(thing, seed=seed), _Session(), [], script
        self.thing = thing
        newest = lambda: self.records[-1] if self.records else None  # noqa: E731
        authentication = Authentication({}, b"", RejectionCounts())
        self.listener = Listener(self.session, thing, authentication, newest, lambda: self.body.stamp, _CONFIG)
        self.delayed = None  # a list: what is sent is on its way until it is delivered

    def send(self, topic, message):
        sample = self.session.send(topic, message)
        if self.delayed is None:
            self.session.deliver(topic, sample)
        else:
            self.delayed.append((topic, sample))

    def deliver(self):
        late, self.delayed = self.delayed or [], None
        for topic, sample in late:
            self.session.deliver(topic, sample)

    def order(self, words):
        self.send(topics.ORDER, TYPES["std_msgs/msg/String"](words))

    def beat(self):
        self.send(topics.HEARTBEAT, messages.header(TYPES, 0.0, ""))

    def ask_for(self, kind, now):
        """Send what a client of a kind sends at once, or again and again."""
        q = self.records[-1].tick.q if self.records else self.thing.home
        if kind == "velocity":
            self.send(topics.TWIST, commands.twist_message(now, np.array([0.4, 0.1, 0.3])))
        elif kind == "servo":
            T = self.thing.forward(self.thing.home)
            T[:3, 3] += [0.1, 0.1, 0.1]
            self.send(topics.TOOL, messages.tool_pose(TYPES, now, T))
        elif kind == "gripper":
            self.send(topics.GRIPPER, commands.gripper_message(now, GripperCommand("velocity", 0.2)))
        else:
            goal = q + np.array([1.0, 0.0, 0.3, 0.5, 0.2, 0.0, 0.0, 0.0, 0.0])
            plan = ConfigurationTrajectory(
                np.array([0.0, 5.0]), np.stack([q, goal]), self.thing.joint_names, np.zeros((2, 9))
            )
            self.send(topics.EXECUTE, messages.joint_trajectory(TYPES, now, plan))

    def run(self, duration):
        def take(now):
            self.script(self, now)
            return self.listener.take(now)

        robot_side.run(
            self.body, lambda stamp: self.body.advance(max(stamp - self.body.stamp, 0.0)), self.thing, np.zeros(3),
            take, self.records.append, lambda: "over" if self.body.stamp >= duration else "", _CONFIG,
        )  # fmt: skip

    def moved(self, since):
        """How fast base and arm were commanded at most after a time, and by how much the fingers were moved."""
        after = [r for r in self.records if r.tick.stamp >= since]
        assert after
        speeds = [np.concatenate([r.state.gate.twist, r.tick.command.arm]) for r in after]
        closed = [r.readings.gripper.closed for r in after if r.readings.gripper is not None]
        return np.abs(speeds).max(), np.ptp(closed)


_KINDS = ("plan", "servo", "velocity", "gripper")


def _client(kind, at, fault, lasts):
    """Return the script of a client that holds the robot, and has a fault from `at` on for as long as `lasts` [s].

    killed: it is silent for ever; halted: it is silent, and lives on; cut: what it sends arrives when the fault ends.
    """
    due, begun = [0.1], [False]

    def script(robot, now):
        gone = at <= now < at + lasts
        if fault == "killed" and now >= at:
            return
        if fault == "cut" and gone and robot.delayed is None:
            robot.delayed = []
        if fault == "cut" and not gone and robot.delayed is not None:
            robot.deliver()
        if now < due[0] or (fault == "halted" and gone):
            return
        due[0] = now + _PERIOD
        if not begun[0]:
            robot.order("take me")
        robot.beat()
        commands_still = now < at + (0.5 * lasts if fault == "cut" else 0.0)  # it learns of a cut later
        if (not begun[0] or kind in ("velocity", "servo")) and commands_still:
            robot.ask_for(kind, now)
        begun[0] = True

    return script


@pytest.mark.parametrize("count", [12, pytest.param(200, marks=pytest.mark.long)])
@pytest.mark.usefixtures("unchecked")
def test_a_client_that_is_gone_leaves_a_robot_that_never_moves_again_by_itself(thing, count):
    rng = np.random.default_rng(14)
    for case in range(count):
        kind, fault = _KINDS[case % 4], rng.choice(["killed", "halted", "cut"])
        lasts = float(rng.choice([0.1, 0.3, 1.0, 1.9, 2.1, 4.0, 60.0], p=[0.15, 0.2, 0.2, 0.2, 0.2, 0.04, 0.01]))
        lasts = lasts if count > 100 else min(lasts, 2.1)
        at = rng.uniform(0.5, 1.5)
        robot = _Robot(thing, _client(kind, at, fault, lasts), seed=case)
        robot.run(at + lasts + 1.0)
        moving, fingers = robot.moved(at - 0.1)
        assert max(moving, fingers) > 0.01, (kind, at)
        if lasts < HEARTBEAT_TIMEOUT and fault != "killed":
            continue  # nobody was missed
        held = next(r.tick.stamp for r in robot.records if r.tick.stop is not None)
        assert held - at < HEARTBEAT_TIMEOUT + 0.05
        moving, fingers = robot.moved(held + _BRAKING)
        assert moving == 0.0, (case, kind, fault, lasts)
        assert fingers < 1e-3, (case, kind, fault, lasts)
        assert isinstance(robot.records[-1].state.goal, Hold)


@pytest.mark.parametrize(
    "kind", ["plan", "velocity", *(pytest.param(kind, marks=pytest.mark.long) for kind in ("servo", "gripper"))]
)
@pytest.mark.parametrize("stop", ["by a client", "button", "contact", "short", "long"])
@pytest.mark.usefixtures("unchecked")
def test_after_a_stop_and_its_reset_only_a_new_command_moves_the_robot(thing, kind, stop):
    sent, due = [], [0.1]

    def script(robot, now):
        if now < due[0]:
            return
        due[0] = now + _PERIOD
        robot.beat()
        if not sent:
            robot.order("take me")
            robot.beat()
        if not sent or (kind in ("velocity", "servo") and now < 1.0):
            robot.ask_for(kind, now)
            sent.append(now)
        if stop == "by a client" and 1.0 <= now < 1.0 + _PERIOD:
            robot.order("stop That is enough.")
        if 2.0 <= now < 2.0 + _PERIOD:
            robot.order("reset")

    robot = _Robot(thing, script)
    silent = {"short": 0.15, "long": 0.6}.get(stop, 0.0)
    read = robot.body.read

    def read_with_trouble():
        readings, now = read(), robot.body.stamp
        if 1.0 <= now < 1.0 + silent:
            return lr.Readings(readings.stamp, readings.wheels, readings.scans, readings.imu)
        force = np.array([150.0 if stop == "contact" and 1.0 <= now < 1.1 else 0.0, 0.0, 0.0])
        wrench = lr.measurement.Wrench(readings.stamp, force, np.zeros(3))
        pressed = stop == "button" and 1.0 <= now < 1.1
        return lr.Readings(
            readings.stamp, readings.wheels, readings.scans, readings.imu, readings.joints, (wrench,),
            readings.gripper, pressed,
        )  # fmt: skip

    robot.body.read = read_with_trouble
    robot.run(2.6)
    assert max(robot.moved(0.7)) > 0.01
    moving, fingers = robot.moved(1.9)
    if stop == "short" and kind == "plan":
        assert moving > 0.01  # a short halt ends nothing
    elif stop != "short":
        assert moving == 0.0
        assert fingers < 1e-3


@pytest.mark.parametrize("order", ["hold", "reset", "release"])
@pytest.mark.parametrize("kind", _KINDS)
@pytest.mark.usefixtures("unchecked")
def test_a_command_that_was_sent_before_an_order_moves_nothing_though_it_is_read_after_it(thing, kind, order):
    """Each topic is read in a thread of its own."""

    def script(robot, now):
        if asked:
            robot.beat()
        if now < 0.3 or asked:
            return
        asked.append(now)
        robot.order("take me")
        robot.delayed = []
        robot.ask_for(kind, now)
        (late,) = robot.delayed
        robot.delayed = None
        robot.order(order)
        if order == "release":
            robot.order("take me again")
        robot.session.deliver(*late)

    asked = []
    robot = _Robot(thing, script)
    robot.run(0.8)
    assert robot.moved(0.0)[0] == 0.0
    assert robot.moved(0.0)[1] < 1e-3
    refused = robot.listener._authentication.rejections.counts
    assert refused == {"sent before its client has asked for something else": 1}


@pytest.mark.parametrize("meanwhile", ["hold", "reset", "release", "another takes it"])
@pytest.mark.usefixtures("unchecked")
def test_a_plan_is_not_begun_where_the_robot_was_asked_for_something_else_while_it_was_looked_at(
    thing, monkeypatch, meanwhile
):
    def script(robot, now):
        if asked:
            robot.beat()
        elif now >= 0.3:
            asked.append(now)
            robot.order("take me")
            robot.ask_for("plan", now)

    def check_slowly(*_):
        if meanwhile == "another takes it":
            robot.order("release")
            robot.session.deliver(
                topics.ORDER, robot.session.send(topics.ORDER, TYPES["std_msgs/msg/String"]("take other"), bytes(16))
            )
        else:
            robot.order(meanwhile)

    asked = []
    monkeypatch.setattr(listener, "check_plan", check_slowly)
    robot = _Robot(thing, script)
    robot.run(0.9)
    assert robot.moved(0.0)[0] == 0.0
    assert robot.listener.plan is None


@pytest.mark.usefixtures("unchecked")
def test_a_reset_that_was_on_its_way_while_somebody_pressed_stop_anew_is_refused(thing):
    stops = []

    def script(robot, now):
        if len(robot.records) % 30 or now > 1.8:
            return
        step = len(robot.records) // 30
        if step == 0:
            robot.order("take me")
        elif step in (1, 2):  # a stop, and another one
            robot.order(f"stop That is number {step}.")
        elif step == 3:
            stops.extend(r.tick.stop.since for r in (robot.records[-31], robot.records[-1]))
            robot.order(f"reset {stops[0]:.6f}")
        elif step == 4:
            assert robot.records[-1].tick.stop.reason == "That is number 2."
            robot.order(f"reset {stops[1]:.6f}")
        elif step == 5:
            assert robot.records[-1].tick.stop is None

    robot = _Robot(thing, script)
    robot.run(1.4)
    assert stops[0] < stops[1]
    assert len(robot.records) > 150
    (reason,) = robot.listener._authentication.rejections.counts
    assert reason == "The robot was stopped anew: That is number 2. Look why, then reset it."
