"""What a client hears: messages become a `LiveState`, frames, readings; what is lost on the way is counted."""

import logging
import struct
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from queue import SimpleQueue
from threading import Condition, Lock, Thread, current_thread
from typing import Any, NamedTuple, TypeVar

import numpy as np

from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import Readings
from longreach.errors import LiveError
from longreach.io import records
from longreach.live.client.state import LiveState
from longreach.live.protocol import commands, topics
from longreach.live.protocol.frames import Frames
from longreach.live.protocol.message_header import unpack_header
from longreach.live.protocol.topics import Sensed, Topic
from longreach.live.protocol.transport import zenoh
from longreach.measurement import LaserScan
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator

_WAITING = 10_000  # messages that are not looked at yet
_STAMP = slice(4, 12)  # of a message with a header: where its stamp is in CDR, behind four bytes that say what it is
_KEPT = 1000  # readings of a kind that nobody has asked for
_REMARKS = 20  # on the robot's readings

_T = TypeVar("_T")
_LOG = logging.getLogger("longreach.live")


def _call(callbacks: list[Callable[[_T], None]], value: _T) -> None:
    """Call back; one that fails is logged, and the others are called all the same."""
    for callback in tuple(callbacks):
        try:
            callback(value)
        except Exception:
            _LOG.exception("A callback has failed.")


def _wheels(robot: RobotDescription, message: Any) -> Any:
    found = records.wheels(message, robot)
    return found[1] if isinstance(found, tuple) else found


def _stamp(payload: bytes) -> float:
    """Return the stamp [s] of a message with a header."""
    seconds, rest = struct.unpack("<iI", payload[_STAMP])
    return seconds + 1e-9 * rest


class _Said(NamedTuple):
    """What was said at one tick, not looked at yet: payloads by their topics, and the newest status."""

    payloads: Mapping[Topic, bytes]
    status: Mapping[str, str]


class Subscriber:
    """Hears all that a robot says on a session, in its order; a state is put together when somebody asks for it."""

    def __init__(self, session: Any, robot: MobileManipulator) -> None:
        self.robot, self.frames, self.sensed = robot, Frames(robot), Sensed.of(robot.description)
        self.scan: LaserScan | None = None
        self.plan: ConfigurationTrajectory | None = None
        self.status: dict[str, str] = {}
        self.heard = 0.0  # when the newest state came, by time.monotonic() [s]
        self.lost, self.malformed, self.closed = 0, 0, False
        self.delays: deque[float] = deque(maxlen=10_000)
        self.changed = Condition()
        self.on_state: list[Callable[[LiveState], None]] = []
        self.on_scan: list[Callable[[LaserScan], None]] = []
        self._numbers: dict[bytes, int] = {}
        self._parts: dict[Topic, bytes] = {}
        self._newest: _Said | None = None
        self._known: tuple[_Said | None, LiveState | None] = None, None
        self._new: dict[str, deque[Any]] = {
            name: deque(maxlen=_KEPT) for name in ("wheels", "scans", "imu", "joints", "wrenches")
        }
        self._session, self._senses, self._reading = session, False, Lock()
        self._taps: list[Callable[[str, str, bytes, float], None]] = []
        self._left_out: Counter[tuple[str, str]] = Counter()
        self._clock = 0.0  # the stamp of the newest tick [s]
        self._waiting: SimpleQueue[Any] = SimpleQueue()
        self._thread = Thread(target=self._hear, name="hearing", daemon=True)
        self._thread.start()
        parts = (topics.ESTIMATE, topics.WHEELS_ALONE, topics.TOOL_TRUTH, topics.REFERENCE, self.sensed.truth)
        takes = {topic: partial(self._parts.__setitem__, topic) for topic in parts}
        takes |= {
            topics.STATUS: self._take_status,
            topics.PLAN: self._take_plan,
            self.sensed.scans: self._take_scan,
            self.sensed.arm: self._take_arm,
        }
        self._of_tick = (topics.ESTIMATE, topics.WHEELS_ALONE, topics.STATUS, self.sensed.arm)
        self._takes: dict[Topic, Callable[[bytes], object]] = {}
        self._declared: dict[Topic, Any] = {}
        for topic, take in takes.items():
            self._subscribe(topic, take)

    def _subscribe(self, topic: Topic, take: Callable[[bytes], object]) -> None:
        self._takes[topic] = take
        if topic not in self._declared:
            arrived = zenoh().handlers.Callback(partial(self._arrived, topic), indirect=False)
            self._declared[topic] = self._session.declare_subscriber(topic.key, arrived)

    def tap(self, write: Callable[[str, str, bytes, float], None]) -> Callable[[], None]:
        """Call `write` with topic, type, payload and time [s] of all that the robot says; returns what ends that."""
        self._taps.append(write)
        for topic in (*topics.STREAMS, *self.sensed):
            if topic not in self._declared:
                self._subscribe(topic, lambda payload: None)
        return lambda: self._taps.remove(write)

    def sense(self) -> None:
        """Hear what wheels, IMU and wrench say, too, from now on; most clients need not."""
        if self._senses:
            return
        self._senses, robot, sensed = True, self.robot.description, self.sensed
        makes: dict[str, tuple[Topic, Callable[[Any], Any]]] = {
            "wheels": (sensed.wheels, partial(_wheels, robot)),
            "imu": (sensed.imu, records.imu),
            "wrenches": (sensed.wrench, records.wrench),
        }
        for kind, (topic, make) in makes.items():
            self._subscribe(topic, partial(self._take_reading, kind, topic, make))

    def _arrived(self, topic: Topic, sample: Any) -> None:
        """Put what has arrived in the queue, in zenoh's own thread; where nobody keeps up with it, it is lost."""
        if self._waiting.qsize() < _WAITING:
            self._waiting.put((time.time_ns(), topic, sample))

    def _hear(self) -> None:
        """Take what has arrived in its order, whatever topic it is of, until the connection is closed."""
        while (item := self._waiting.get()) is not None:
            came, topic, sample = item
            try:
                self._take(came, topic, sample)
            except Exception:
                self._cannot_use(topic)

    def _cannot_use(self, topic: Topic) -> None:
        self.malformed += 1
        _LOG.debug("A message on %s cannot be used.", topic.name, exc_info=True)

    def _take(self, came: int, topic: Topic, sample: Any) -> None:
        """Take a message. Whatever it raises: it is none, too large, or does not say what it should."""
        if len(sample.payload) > topic.limit or sample.attachment is None:
            raise ValueError("too large, or without a header")
        about, _ = unpack_header(bytes(sample.attachment))
        self.delays.append(1e-9 * (came - about.sent_ns))
        before = self._numbers.get(about.sender)
        if before is not None:
            self.lost += max(about.number - before - 1, 0)
        self._numbers[about.sender] = about.number
        payload = bytes(sample.payload)
        if topic in self._of_tick:
            self._clock = max(self._clock, _stamp(payload))
        if self._taps:
            topic.unpack(payload)  # what cannot be read would spoil a recording
            for write in tuple(self._taps):
                write(topic.name, topic.type, payload, self._clock)
        self._takes[topic](payload)

    def close(self) -> None:
        """Hear no more; who waits for something need not any longer."""
        self._waiting.put(None)
        with self.changed:
            self.closed = True
            self.changed.notify_all()

    def _take_status(self, payload: bytes) -> None:
        one = topics.STATUS.unpack(payload).status[0]
        status = {item.key: item.value for item in one.values} | {"stop": one.message}
        for name, kind in (("plan", int), ("progress", float)):
            kind(status.get(name) or 0)  # raises where it is no number
        with self.changed:
            self.status = status
            self.changed.notify_all()

    def _take_plan(self, payload: bytes) -> None:
        self.plan = commands.trajectory(topics.PLAN.unpack(payload), self.robot)

    def _take_scan(self, payload: bytes) -> None:
        self._take_reading(
            "scans", self.sensed.scans, lambda m: records.laser_scan(m, self.robot.description.lidar), payload
        )
        scan = self._new["scans"][-1] if self._new["scans"] else None
        if scan is not None and scan is not self.scan:
            self.scan = scan
            _call(self.on_scan, scan)

    def _take_reading(self, kind: str, topic: Topic, make: Callable[[Any], Any], payload: bytes) -> None:
        message = topic.unpack(payload)
        made = make(message)
        if isinstance(made, str):
            with self._reading:
                self._left_out[topic.name, made] += 1
        elif made is not None:
            self._new[kind].append(made(stamp=commands.stamp_of(message)))

    def _take_arm(self, payload: bytes) -> None:
        """Close a tick: the arm's message is the last of it. What was lost of it makes it none."""
        tick = {topic: part for topic, part in self._parts.items() if part[_STAMP] == payload[_STAMP]}
        if self.robot.base.stop and not {topics.ESTIMATE, topics.WHEELS_ALONE} <= tick.keys():
            return
        tick[self.sensed.arm] = payload
        said = _Said(tick, self.status)
        self.frames.add(_stamp(payload), lambda: self._made(said))
        with self.changed:
            self._newest, self.heard = said, time.monotonic()
            self.changed.notify_all()
        if self._senses:
            make = partial(records.joints, robot=self.robot.description)
            self._take_reading("joints", self.sensed.arm, make, payload)
        if self.on_state and (state := self.state) is not None:
            _call(self.on_state, state)

    @property
    def tick_status(self) -> Mapping[str, str]:
        """What the status said at the newest tick."""
        return {} if self._newest is None else self._newest.status

    @property
    def state(self) -> LiveState | None:
        """The newest state, or None before the first."""
        said, (known, state) = self._newest, self._known
        if said is not None and said is not known:
            try:
                state = self._made(said)
            except LiveError:
                self._cannot_use(self.sensed.arm)
            self._known = said, state
        return state

    def _made(self, said: _Said) -> LiveState:
        try:
            state = made_state(self.robot, self.sensed, said.payloads, said.status)
        except Exception as error:
            raise LiveError("What the robot said then cannot be read.") from error
        if not np.isfinite(np.concatenate([[state.stamp], state.q, state.velocity])).all():
            raise LiveError("What the robot said then has a number that is not finite.")
        return state

    def readings(self, stamp: float) -> Readings:
        """Return what has come since the last call; remarks: what could not be used since the start."""
        taken: dict[str, Any] = {}
        for kind, new in self._new.items():
            with self._reading:
                taken[kind] = tuple(new.popleft() for _ in range(len(new)))
        with self._reading:
            taken["remarks"] = tuple(records.left_out(n, topic, why) for (topic, why), n in self._left_out.items())
        return replace(Readings(stamp), **taken)

    def is_this_thread(self) -> bool:
        """Whether who asks is the thread that hears, and calls back."""
        return current_thread() is self._thread

    def wait(self, ready: Callable[[], _T | None], timeout: float) -> _T | None:
        """Return what `ready` returns as soon as that is something, or None after a time [s].

        A callback's thread does not wait: it is the one that hears.
        """
        until = time.monotonic() + (0.0 if self.is_this_thread() else timeout)
        with self.changed:
            while not (found := ready()) and (left := until - time.monotonic()) > 0.0:
                self.changed.wait(min(left, 1.0))  # it cannot wait for ever
            return found or None


def made_state(
    robot: MobileManipulator, sensed: Sensed, payloads: Mapping[Topic, bytes], status: Mapping[str, str]
) -> LiveState:
    """Return the state that the payloads of one tick, and the newest status, make; what is wrong raises something."""
    said = {topic: topic.unpack(payload) for topic, payload in payloads.items()}
    arm, names = said[sensed.arm], robot.joint_names[robot.arm]
    stamp = commands.stamp_of(arm)
    joints = dict(zip(arm.name, arm.position.tolist(), strict=True))
    speeds = dict(zip(arm.name, arm.velocity.tolist(), strict=True))
    q, v = (np.array([values[name] for name in names]) for values in (joints, speeds))
    covariance, wheels = np.zeros((3, 3)), np.zeros(3)
    if robot.base.stop:
        make, alone = records.odometry(said[topics.ESTIMATE]), records.odometry(said[topics.WHEELS_ALONE])
        if isinstance(make, str) or isinstance(alone, str):
            raise ValueError("an odometry that says nothing")
        odometry, wheels = make(stamp=stamp), alone(stamp=stamp).pose
        covariance = covariance if odometry.pose_covariance is None else odometry.pose_covariance
        q, v = np.concatenate([odometry.pose, q]), np.concatenate([odometry.twist, v])
    truth, tool, reference = (said.get(topic) for topic in (sensed.truth, topics.TOOL_TRUTH, topics.REFERENCE))
    known = None if truth is None else records.stamped_pose(truth)
    return LiveState(
        stamp, q, v, covariance, wheels,
        truth=None if known is None else known[0],
        tool_truth=None if tool is None else commands.tool(tool),
        joints=joints,
        reference=q if reference is None else np.array(reference.position),
        progress=float(status.get("progress") or 0.0), plan=int(status.get("plan") or 0),
        goal=status.get("goal", "hold"), loop_time=float(status.get("loop_time") or 0.0),
        stop=status.get("stop", ""), latched=status.get("latched") == "1", cause=status.get("cause", ""),
        stopped_by=status.get("by", ""), stopped_at=float(status.get("since") or 0.0),
        holder=status.get("holder", ""), refused=int(status.get("refused") or 0), why=status.get("why", ""),
        remarks=tuple(status.get("remarks", "").splitlines()[:_REMARKS]),
        limited=status.get("limit", ""), minds_obstacles=bool(status.get("obstacles")),
    )  # fmt: skip
