"""What a robot's ROS topics say, as the records that everything else works with."""

import threading
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple

from longreach.control.hardware import Readings
from longreach.errors import ConfigError
from longreach.io import clocks, records
from longreach.io.bag_topics import JOINT_STATE, ODOMETRY
from longreach.io.records import Read
from longreach.measurement import PoseMeasurement
from longreach.robot.description import RobotDescription
from longreach.ros import wire

_REASONS = 50  # that are counted one by one: some hold a number, and there is no end of those; ours
Role = Literal["wheels", "lidar", "imu", "fixes", "joints", "wrench"]
_KINDS: dict[Role, tuple[str, ...]] = {
    "wheels": (JOINT_STATE, ODOMETRY),
    "lidar": ("sensor_msgs/msg/LaserScan",),
    "imu": ("sensor_msgs/msg/Imu",),
    "fixes": (
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "geometry_msgs/msg/TransformStamped",
        ODOMETRY,
    ),
    "joints": (JOINT_STATE,),
    "wrench": ("geometry_msgs/msg/WrenchStamped",),
}
_USUAL: dict[Role, str] = {
    "wheels": "/joint_states",
    "lidar": "/scan",
    "imu": "/imu/data",
    "fixes": "/fixes",
    "joints": "/joint_states",
    "wrench": "/wrench",
}


class Heard(NamedTuple):
    """All that is new: readings, and absolute poses of the base, which no robot says of itself."""

    readings: Readings
    fixes: tuple[PoseMeasurement, ...]


def topic_of(robot: RobotDescription, role: Role) -> str:
    """Return the topic of a sensor: as the description says, else the usual one."""
    usual = "/odom" if role == "wheels" and robot.base is None else _USUAL[role]
    return getattr(robot.topics, role) or usual


class Sensors:
    """A node's subscriptions to a robot's sensors; what came in waits until it is taken.

    left_out: how many messages could not be used, by topic and why, as the end of a sentence that starts with "each".
    """

    def __init__(self, robot: RobotDescription, roles: Sequence[Role]) -> None:
        self.left_out: Counter[tuple[str, str]] = Counter()
        self._robot, self._lock, self._named = robot, threading.Lock(), False
        self._waiting: dict[str, list[Any]] = {role: [] for role in roles}
        self._newest: dict[str, float] = {}
        self._offsets: dict[str, float] = {}
        readers: dict[str, Callable[[Any], Read | None]] = {
            "wheels": self._wheels,
            "lidar": lambda message: records.laser_scan(message, robot.lidar),
            "imu": records.imu,
            "fixes": _fix,
            "joints": lambda message: records.joints(message, robot),
            "wrench": records.wrench,
        }
        self._subscriptions = [
            wire.listen(
                self.topic(role), _KINDS[role], partial(self._take, role, readers[role]), partial(self._no, role)
            )
            for role in roles
        ]

    def take(self) -> Heard:
        """Return what came in since the last call, and when that is."""
        with self._lock:
            new = {role: tuple(waiting) for role, waiting in self._waiting.items()}
            for waiting in self._waiting.values():
                waiting.clear()
        readings = Readings(
            wire.now(),
            wheels=new.get("wheels", ()),
            scans=new.get("lidar", ()),
            imu=new.get("imu", ()),
            joints=new.get("joints", ()),
            wrenches=new.get("wrench", ()),
            remarks=self.remarks,
        )
        return Heard(readings, new.get("fixes", ()))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What could not be used so far, a sentence each: those of a bag with these messages."""
        with self._lock:
            return tuple(records.left_out(n, topic, why) for (topic, why), n in self.left_out.items())

    def speaks(self, role: Role) -> bool:
        """Whether anything usable has come of a sensor."""
        return role in self._newest

    def topic(self, role: Role) -> str:
        """Return the topic that a sensor is heard on."""
        return topic_of(self._robot, role)

    def close(self) -> None:
        """Listen no more."""
        for subscription in self._subscriptions:
            subscription.unregister()

    def _take(self, role: Role, read: Callable[[Any], Read | None], message: Any) -> None:
        stamp = (message.header.stamp.sec * 10**9 + message.header.stamp.nanosec) / 10**9
        if stamp == 0.0:
            return self._no(role, "has no stamp; let its driver say when it measured")
        make = read(message)
        if make is None:  # several nodes share a topic, each with its own joints
            return None
        if isinstance(make, str):
            return self._no(role, make)
        offset = self._offsets.setdefault(role, stamp - wire.now())
        usual = clocks.common_offset(self._offsets)
        if clocks.is_another(offset, usual):
            off = clocks.seconds(offset - usual)
            return self._no(role, f"is on another clock: its stamps are {off} off those of the other topics")
        record = make(stamp=stamp)
        with self._lock:
            newest = self._newest.get(role, -1.0)
            if stamp > newest:
                self._newest[role] = stamp
                self._waiting[role].append(record)
                return None
        return self._no(role, "has a stamp that is not after the one before")

    def _no(self, role: Role, why: str) -> None:
        key = self.topic(role), why
        with self._lock:
            if key not in self.left_out and len(self.left_out) >= _REASONS:
                key = "other topics", "for another reason"
            self.left_out[key] += 1

    def _wheels(self, message: Any) -> Read | None:
        """Read wheels; where some messages name them, those that do not are somebody else's."""
        if message.__msgtype__ == ODOMETRY:
            return records.odometry(message)
        if self._robot.base is None:
            return None
        found = records.wheels(message, self._robot)
        if isinstance(found, str):
            return found
        if found is None or (self._named and not found[0]):
            return None
        self._named = found[0]
        return found[1]


def _fix(message: Any) -> Read:
    found = records.fix(message)
    return "has a pose that is not finite" if found is None else found[1]


def with_topics(robot: RobotDescription, topics: Sequence[str]) -> RobotDescription:
    """Return a description with other topics, each given as ROLE=TOPIC.

    Raises:
        ConfigError: there is no such role, or no topic.
    """
    named = {}
    for given in topics:
        role, _, topic = given.partition("=")
        if role not in _KINDS or not topic:
            raise ConfigError(f"{given!r} names no topic; give ROLE=TOPIC, where ROLE is one of {', '.join(_KINDS)}.")
        named[role] = topic
    return robot.model_copy(update={"topics": robot.topics.model_copy(update=named)})
