"""The robot's side on the network: says what the robot does, and hears what it shall do."""

import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from longreach.app.goals import Follow
from longreach.app.readings_check import ReadingsCheck
from longreach.app.robot_side import Orders, TickRecord
from longreach.app.tracker import TrackerConfig
from longreach.io import messages
from longreach.io.bag_recorder import Recorder
from longreach.live.protocol import topics
from longreach.live.protocol.message_header import pack_header
from longreach.live.protocol.topics import TYPES, Sensed, Topic
from longreach.live.protocol.transport import OPERATOR, ROLE_KEYS, WATCHER, open_server, zenoh
from longreach.live.server import publisher
from longreach.live.server.authentication import Authentication
from longreach.live.server.listener import Listener
from longreach.live.server.ros_graph import announced
from longreach.measurement import JointState
from longreach.rejection_counts import RejectionCounts
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.simulated import Truth

HEARTBEAT_TIMEOUT = 0.24  # so that a client that vanishes stops the robot within 0.25 s
_STATUS_EVERY, _FRAMES_EVERY = 0.1, 0.04  # [s]


@dataclass(frozen=True)
class ServerConfig:
    """Where a server listens, and whom it lets in."""

    address: str = "127.0.0.1:7447"
    token: str | None = None
    certificates: Path | None = None
    watcher_token: str | None = None

    def role_keys(self) -> dict[str, str]:
        """Return what each role signs with: its token, else one that is drawn now; nothing where all may command."""
        if self.token is None:
            return {role: secrets.token_hex(16) for role in (OPERATOR, WATCHER)} if self.certificates else {}
        return {OPERATOR: self.token} | ({WATCHER: self.watcher_token} if self.watcher_token is not None else {})


class Server:
    """A robot on the network; `take` and `publish` are what `robot_side.run` needs.

    Arguments: description: the robot's YAML and its URDF; truth: tells what really is, where that is known;
    recorder: is given all that is said.
    """

    def __init__(
        self,
        robot: MobileManipulator,
        description: tuple[str, str],
        config: ServerConfig,
        tracker: TrackerConfig,
        truth: Callable[[], Truth] | None = None,
        recorder: Recorder | None = None,
        rejections: RejectionCounts | None = None,
    ) -> None:
        self._robot, self._truth, self._recorder = robot, truth, recorder
        self._nonce = secrets.token_bytes(16)
        self._sensed = Sensed.of(robot.description)
        streams = (*topics.STREAMS, *self._sensed)
        self._senders = {
            topic: secrets.token_bytes(16) for topic in streams
        }  # each publisher has an identity, as in ROS
        self._numbers = dict.fromkeys(streams, 0)
        self._record: TickRecord | None = None
        self._joints: tuple[JointState, ...] = ()
        self._published = time.monotonic()
        self._progress, self._plans = 0.0, 0
        self._status, self._status_due, self._frames_due = "", 0.0, 0.0
        lidar = robot.description.lidar
        self._check = ReadingsCheck(robot.description, lidar is not None and lidar.mount is not None)
        self.rejections = rejections or RejectionCounts()
        keys = config.role_keys()
        self._session = open_server(config.address, config.token, config.certificates, config.watcher_token)
        authentication = Authentication(keys, self._nonce, self.rejections)
        self._listener = Listener(self._session, robot, authentication, lambda: self._record, lambda: self.now, tracker)
        z = zenoh()
        self._publishers = {
            topic: self._session.declare_publisher(
                topic.key, congestion_control=z.CongestionControl.DROP, priority=z.Priority.REAL_TIME
            )
            for topic in streams
        }
        String = TYPES["std_msgs/msg/String"]
        lasting = {
            topics.DESCRIPTION: lambda: String(description[0]),
            topics.URDF: lambda: String(description[1]),
            topics.TF_STATIC: lambda: publisher.static_frames(robot, self.now),
            topics.PLAN: self._plan,
            topics.CLOCK: self._clock,
        }
        self._declared = [
            self._session.declare_queryable(topic.key, partial(self._tell, topic, say))
            for topic, say in lasting.items()
        ]

        self._declared += announced(self._session, streams)
        if config.token is None:
            self._declared += [
                self._session.declare_queryable(f"{ROLE_KEYS}/{role}", partial(_give, f"{ROLE_KEYS}/{role}", key))
                for role, key in keys.items()
            ]

    @property
    def now(self) -> float:
        """The time of the robot's clock [s]."""
        record = self._record
        return 0.0 if record is None else record.tick.stamp + time.monotonic() - self._published

    def take(self, now: float) -> Orders:
        """Return what clients have asked for since the last call."""
        return self._listener.take(now)

    def publish(self, record: TickRecord) -> None:
        """Say what one tick knew and did."""
        self._check.take(record.readings, record.state.given)
        if self._record is None:
            self._say(topics.TF_STATIC, publisher.static_frames(self._robot, record.tick.stamp), record.tick.stamp)
        if record.readings.joints:
            self._joints = record.readings.joints[-1:]
        else:  # what only these tell, where the fingers are, is said at each tick all the same
            record = record._replace(readings=replace(record.readings, joints=self._joints))
        self._record, self._published = record, time.monotonic()
        now, truth = record.tick.stamp, None if self._truth is None else self._truth()
        if isinstance(record.state.goal, Follow):
            self._progress = record.state.goal.progress
        if self._plans != self._listener.plans:
            self._plans, self._progress = self._listener.plans, 0.0
            self._say(topics.PLAN, self._plan(), now)
        self._say_status(record, now)
        for topic, message in publisher.state(self._robot, self._sensed, record, truth):
            self._say(topic, message, now)
        for topic, message in (*publisher.sensors(self._robot, self._sensed, record), *publisher.settled(record)):
            self._say(topic, message, now)
        if now >= self._frames_due:
            self._frames_due = now + _FRAMES_EVERY - 1e-6
            self._say(topics.TF, publisher.moving_frames(self._robot, record), now)

    def _say_status(self, record: TickRecord, now: float) -> None:
        """Say how the loop is, from time to time, and at once where something else than a number has changed."""
        holder, stop = self._listener.holder, record.tick.stop
        around, ended = record.state.gate.obstacles, record.state.why
        limited = around is not None and around.nearest is not None
        halted, remarks = stop and (stop.cause, stop.since), "\n".join(self._check.remarks)
        what = f"{publisher.goal_name(record)} {self._plans} {holder.sender.hex()} {halted} {ended} {limited} {remarks}"
        if what == self._status and now < self._status_due:
            return
        self._status, self._status_due = what, now + _STATUS_EVERY - 1e-6
        values = {
            "holder": holder.name,
            "holder_id": holder.sender.hex(),
            "plan": str(self._plans),
            "progress": f"{self._progress:.6f}",
            "by": self._listener.stopped_by if stop is not None and stop.reason == self._listener.stopped else "",
            "refused": str(self.rejections.total),
            "remarks": remarks,
        }
        self._say(topics.STATUS, publisher.status(record, values), now)

    def _say(self, topic: Topic, message: Any, now: float) -> None:
        publisher = self._publishers[topic]
        listens = publisher.matching_status.matching
        if not listens and self._recorder is None:
            return
        payload = topic.pack(message)
        if self._recorder is not None:
            self._recorder.write(topic.name, topic.type, payload, now)
        if listens:
            self._numbers[topic] += 1
            publisher.put(payload, attachment=pack_header(self._numbers[topic], self._senders[topic]))

    def _tell(self, topic: Topic, say: Callable[..., Any], query: Any) -> None:
        """Answer with what lasts; with the nonce of this server where the header of a message has its sender."""
        with query:
            message = say(query) if topic is topics.CLOCK else say()
            if message is not None:
                query.reply(topic.key, topic.pack(message), attachment=pack_header(0, self._nonce))

    def _plan(self) -> Any:
        plan = self._listener.plan
        return None if plan is None else messages.joint_trajectory(TYPES, self.now, plan)

    def _clock(self, query: Any) -> Any:
        """Answer the time of the robot's clock, and give back the client's own."""
        payload = b"" if query.payload is None else bytes(query.payload)
        if len(payload) > topics.CLOCK.limit:
            self.rejections.count("too large", topics.CLOCK.name)
            return None
        try:
            asked = topics.CLOCK.unpack(payload)
        except Exception:
            self.rejections.count("malformed", topics.CLOCK.name)
            return None
        header = messages.header(TYPES, self.now, "")
        return TYPES["sensor_msgs/msg/TimeReference"](header, asked.time_ref, "longreach")

    def close(self) -> None:
        """Hang up, also where the network has gone and does not answer."""
        self.rejections.log_all()
        with suppress(zenoh().ZError):
            self._session.close()


def _give(key_expression: str, key: str, query: Any) -> None:
    """Answer with the key of a role; zenoh's access control lets only those have it whose certificate says so."""
    with query:
        query.reply(key_expression, key)
