"""What a client hears: messages become a `LiveState`, frames, readings; what is lost on the way is counted."""

import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from queue import SimpleQueue
from threading import Condition, Thread
from typing import Any, TypeVar

import numpy as np

from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import Readings
from longreach.io import records
from longreach.live import keys, orders
from longreach.live.frames import Frames
from longreach.live.keys import Sensed, Topic, attached
from longreach.live.link import zenoh
from longreach.live.state import LiveState
from longreach.measurement import LaserScan
from longreach.robot.mobile_manipulator import MobileManipulator

_WAITING = 10_000  # messages that are not looked at yet
_KEPT = 1000  # readings of a kind that nobody has asked for

_T = TypeVar("_T")
_LOG = logging.getLogger("longreach.live")


def _call(callbacks: list[Callable[[_T], None]], value: _T) -> None:
    """Call back; one that fails is logged, and the others are called all the same."""
    for callback in tuple(callbacks):
        try:
            callback(value)
        except Exception:
            _LOG.exception("A callback has failed.")


class Ears:
    """Hears all that a robot says on a session."""

    def __init__(self, session: Any, robot: MobileManipulator) -> None:
        self.robot, self.frames = robot, Frames(robot)
        self.state: LiveState | None = None
        self.scan: LaserScan | None = None
        self.plan: ConfigurationTrajectory | None = None
        self.status: dict[str, str] = {}
        self.heard = 0.0  # when the newest state came, by time.monotonic() [s]
        self.lost, self.malformed = 0, 0
        self.delays: deque[float] = deque(maxlen=10_000)
        self.changed = Condition()
        self.on_state: list[Callable[[LiveState], None]] = []
        self.on_scan: list[Callable[[LaserScan], None]] = []
        self._numbers: dict[bytes, int] = {}
        self._parts: dict[Topic, Any] = {}
        self._new: dict[str, deque[Any]] = {
            name: deque(maxlen=_KEPT) for name in ("wheels", "scans", "imu", "joints", "wrenches")
        }
        self._topics = topics = Sensed.of(robot.description)
        takes = {
            keys.ESTIMATE: partial(self._parts.__setitem__, keys.ESTIMATE),
            keys.WHEELS_ALONE: partial(self._parts.__setitem__, keys.WHEELS_ALONE),
            topics.truth: partial(self._parts.__setitem__, topics.truth),
            keys.TOOL_TRUTH: partial(self._parts.__setitem__, keys.TOOL_TRUTH),
            keys.REFERENCE: partial(self._parts.__setitem__, keys.REFERENCE),
            keys.STATUS: self._take_status,
            topics.arm: self._take_arm,
            topics.scans: self._take_scan,
            keys.PLAN: self._take_plan,
        }
        self._session, self._senses = session, False
        self._waiting: SimpleQueue[Any] = SimpleQueue()
        Thread(target=self._hear, name="hearing", daemon=True).start()
        self._declared = [self._subscribe(topic, take) for topic, take in takes.items()]

    def _subscribe(self, topic: Topic, take: Callable[[Any], None]) -> Any:
        arrived = partial(self._arrived, topic, take)
        return self._session.declare_subscriber(topic.key, zenoh().handlers.Callback(arrived, indirect=False))

    def sense(self) -> None:
        """Hear what wheels, IMU and wrench say, too, from now on; most clients need not."""
        if self._senses:
            return
        self._senses, robot = True, self.robot.description
        takes = {
            self._topics.wheels: lambda m: self._keep("wheels", m, (records.wheels(m, robot) or (False, None))[1]),
            self._topics.imu: lambda m: self._keep("imu", m, records.imu(m)),
            self._topics.wrench: lambda m: self._keep("wrenches", m, records.wrench(m)),
        }
        self._declared += [self._subscribe(topic, take) for topic, take in takes.items()]

    def _arrived(self, topic: Topic, take: Callable[[Any], None], sample: Any) -> None:
        """Put what has arrived in the queue, in zenoh's own thread; where nobody keeps up with it, it is lost."""
        if self._waiting.qsize() < _WAITING:
            self._waiting.put((time.time_ns(), topic, take, sample))

    def _hear(self) -> None:
        """Take what has arrived in its order, whatever topic it is of, until the line is closed."""
        while (item := self._waiting.get()) is not None:
            came, topic, take, sample = item
            try:
                self._take(came, topic, take, sample)
            except Exception:
                self.malformed += 1
                _LOG.debug("A message on %s cannot be used.", topic.name, exc_info=True)

    def _take(self, came: int, topic: Topic, take: Callable[[Any], None], sample: Any) -> None:
        """Take a message. Whatever it raises: it is none, too large, or does not say what it should."""
        if len(sample.payload) > topic.limit or sample.attachment is None:
            raise ValueError("too large, or without an attachment")
        about, _ = attached(bytes(sample.attachment))
        take(topic.unpack(bytes(sample.payload)))
        self.delays.append(1e-9 * (came - about.sent_ns))
        before = self._numbers.get(about.sender)
        if before is not None:
            self.lost += max(about.number - before - 1, 0)
        self._numbers[about.sender] = about.number

    def close(self) -> None:
        """Hear no more."""
        self._waiting.put(None)

    def _take_status(self, message: Any) -> None:
        one = message.status[0]
        self.status = {item.key: item.value for item in one.values} | {"stop": one.message}
        with self.changed:
            self.changed.notify_all()

    def _take_arm(self, message: Any) -> None:
        """Put a state together: the arm's message is the last of its tick."""
        stamp, robot = orders.stamp_of(message), self.robot
        joints = dict(zip(message.name, message.position.tolist(), strict=True))
        speeds = dict(zip(message.name, message.velocity.tolist(), strict=False))
        arm = robot.joint_names[robot.arm]
        q = np.array([joints[name] for name in arm])
        v = np.array([speeds.get(name, 0.0) for name in arm])
        pose, covariance, wheels = np.zeros(3), np.zeros((3, 3)), np.zeros(3)
        if robot.base.stop:
            estimate, alone = self._part(keys.ESTIMATE, stamp), self._part(keys.WHEELS_ALONE, stamp)
            if estimate is None or alone is None:  # lost on the way, or we have just begun to listen
                return
            said = self._made(records.odometry(estimate), stamp)
            pose, covariance = said.pose, said.pose_covariance
            covariance = np.zeros((3, 3)) if covariance is None else covariance
            wheels = self._made(records.odometry(alone), stamp).pose
            q, v = np.concatenate([pose, q]), np.concatenate([said.twist, v])
        truth, tool = self._part(self._topics.truth, stamp), self._part(keys.TOOL_TRUTH, stamp)
        known = None if truth is None else records.stamped_pose(truth)
        truth, tool = None if known is None else known[0], None if tool is None else orders.tool(tool)
        planned, status = self._part(keys.REFERENCE, stamp), self.status
        reference = q if planned is None else np.array(planned.position)
        self.frames.add(stamp, tuple(message.name), np.array(message.position), pose, wheels)
        self._keep("joints", message, records.joints(message, robot.description))
        self._tell(LiveState(
            stamp, q, v, covariance, wheels, truth, tool, joints, reference,
            progress=float(status.get("progress") or 0.0), plan=int(status.get("plan") or 0),
            goal=status.get("goal", "hold"), loop_time=float(status.get("loop_time") or 0.0),
            stop=status.get("stop", ""), latched=status.get("latched") == "1",
            holder=status.get("holder", ""), refused=int(status.get("refused") or 0),
        ))  # fmt: skip

    def _part(self, topic: Topic, stamp: float) -> Any:
        """Return what was said on a topic at the same tick, or None."""
        message = self._parts.get(topic)
        return message if message is not None and orders.stamp_of(message) == stamp else None

    @staticmethod
    def _made(make: Callable[..., Any] | None, stamp: float) -> Any:
        if make is None:
            raise ValueError("a message that says nothing")
        return make(stamp=stamp)

    def _tell(self, state: LiveState) -> None:
        with self.changed:
            self.state, self.heard = state, time.monotonic()
            self.changed.notify_all()
        _call(self.on_state, state)

    def _take_scan(self, message: Any) -> None:
        make = records.laser_scan(message, self.robot.description.lidar)
        if make is not None:
            self.scan = scan = make(stamp=orders.stamp_of(message))
            self._new["scans"].append(scan)
            _call(self.on_scan, scan)

    def _take_plan(self, message: Any) -> None:
        self.plan = orders.trajectory(message, self.robot)

    def _keep(self, kind: str, message: Any, make: Callable[..., Any] | None) -> None:
        if make is not None:
            self._new[kind].append(make(stamp=orders.stamp_of(message)))

    def readings(self, stamp: float) -> Readings:
        """Return what has come since the last call."""
        taken = {kind: tuple(new.popleft() for _ in range(len(new))) for kind, new in self._new.items()}
        return replace(Readings(stamp), **taken)

    def wait(self, ready: Callable[[], _T | None], timeout: float) -> _T | None:
        """Return what `ready` returns as soon as that is something, or None after a time [s]."""
        until = time.monotonic() + timeout
        with self.changed:
            while not (found := ready()) and (left := until - time.monotonic()) > 0.0:
                self.changed.wait(left)
            return found or None
