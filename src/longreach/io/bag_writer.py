"""Write a Recording, or any standard messages, as a ROS bag that ROS can play: .mcap, .bag, or a ROS 2 folder."""

import heapq
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from longreach.configuration import ConfigurationTrajectory
from longreach.errors import RecordingError
from longreach.io import messages
from longreach.io.bag_topics import ESTIMATE, PLAN, TOOL, USUAL
from longreach.io.mcap_file import McapWriter
from longreach.io.messages import Types, nanoseconds
from longreach.measurement import Odometry, Recording, Wheels, WheelSpeeds, WheelTicks
from longreach.reference import Reference
from longreach.robot.description import RobotDescription
from longreach.trajectory import PoseTrajectory

_STATIC, _MOVING = "/tf_static", "/tf"
_TELL_EVERY = 500  # messages
_ROS2_VERSION: Literal[8] = 8  # what ROS 2 Jazzy writes; older ones read it too
_FOREVER = QosTime(9223372036, 854775807)
# So that a late listener still gets it, as with ROS's own static broadcaster.
_LATCHED = Qos(
    history=QosHistory.KEEP_LAST,
    depth=1,
    reliability=QosReliability.RELIABLE,
    durability=QosDurability.TRANSIENT_LOCAL,
    deadline=_FOREVER,
    lifespan=_FOREVER,
    liveliness=QosLiveliness.AUTOMATIC,
    liveliness_lease_duration=_FOREVER,
    avoid_ros_namespace_conventions=False,
)


@cache
def type_store(is_ros1: bool) -> Any:
    """Return rosbags' types of ROS 1 Noetic or ROS 2 Humble; to make them takes a while, but only once."""
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    if is_ros1:  # rosbags' ROS 1 types lack it
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    return store


class BagWriter:
    """An open bag to write messages of the classes in `types` to."""

    def __init__(self, writer: Ros1Writer | Ros2Writer | McapWriter) -> None:
        self._writer = writer
        self._is_ros1 = isinstance(writer, Ros1Writer)
        self._store = type_store(self._is_ros1)
        self.types: Types = self._store.types
        self._connections: dict[str, Any] = {}

    def write(self, topic: str, message: Any, stamp: float) -> None:
        """Write one message at the time of recording `stamp` [s]."""
        type = message.__msgtype__
        serialize = self._store.serialize_ros1 if self._is_ros1 else self._store.serialize_cdr
        self._write(topic, type, serialize(message, type), stamp)

    def write_cdr(self, topic: str, type: str, payload: bytes, stamp: float) -> None:
        """Write one message of ROS 2 that is serialized already."""
        self._write(topic, type, self._store.cdr_to_ros1(payload, type) if self._is_ros1 else payload, stamp)

    def _write(self, topic: str, type: str, payload: bytes | memoryview, stamp: float) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._connect(topic, type)
        self._writer.write(self._connections[topic], nanoseconds(stamp), payload)

    def _connect(self, topic: str, type: str) -> Any:
        static = topic == _STATIC
        if isinstance(self._writer, Ros1Writer):
            latching = 1 if static else None
            return self._writer.add_connection(topic, type, typestore=self._store, latching=latching)
        profiles = (_LATCHED,) if static else ()
        return self._writer.add_connection(topic, type, typestore=self._store, offered_qos_profiles=profiles)


@contextmanager
def new_bag(path: Path) -> Iterator[BagWriter]:
    """Open a new bag whose suffix says its kind: .mcap, .bag (ROS 1), or none for a ROS 2 folder with sqlite3.

    It is written beside its place and moved there when all went well. A file that is there is replaced; a folder is
    not, for it may hold other things.

    Raises:
        RecordingError: the suffix is another, the folder is there already, or it cannot be written.
    """
    if path.suffix not in (".mcap", ".bag", ""):
        raise RecordingError(
            f"{path} cannot be written: end it with .mcap or .bag, or with nothing for a ROS 2 folder."
        )
    if path.is_dir():
        raise RecordingError(f"The folder {path} is there already; remove it or give another name.")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        workplace = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
        try:
            written = workplace / path.name
            if path.suffix == ".bag":
                writer = Ros1Writer(written)
            elif path.suffix == ".mcap":
                writer = McapWriter(written)
            else:
                writer = Ros2Writer(written, version=_ROS2_VERSION)
            with writer:
                yield BagWriter(writer)
            os.replace(written, path)
        finally:
            shutil.rmtree(workplace, ignore_errors=True)
    except OSError as error:
        raise RecordingError(f"{path} cannot be written: {error.strerror or error}.") from error


def write_bag(
    path: Path,
    recording: Recording,
    robot: RobotDescription,
    progress: Callable[[float], None] | None = None,
    *,
    plan: ConfigurationTrajectory | None = None,
    estimate: PoseTrajectory | None = None,
    tool: Mapping[str, Reference] | None = None,
) -> None:
    """Write a recording as a bag on the topics of the robot's description, or the usual ones where it names none.

    Headers carry the stamps as recorded; the time of recording is the repaired one. `read_bag` gives the same records
    again (ranges as float32), if the description names the topics of truth and fixes. Of the truth the poses are
    written, not their covariance.

    Arguments: plan: what was to be done, as one JointTrajectory. estimate: where the base was thought to be, as
        Odometry on /odometry/filtered, and what /tf says of base_link in map; without it, /tf says the truth. tool:
        what the tool's poses are called (truth, estimate, reference) → these, as PoseStamped on /tool/….

    Raises:
        RecordingError: wheels without a base that names them, stamps before 1970, or a path that cannot be written.
    """
    streams = _streams(recording, robot) + _results(recording, plan, estimate, tool or {})
    total = max(sum(stream.count for stream in streams), 1)
    with new_bag(path) as bag:
        merged = heapq.merge(*(stream.messages(bag.types) for stream in streams), key=lambda item: item[0])
        for i, (stamp, topic, message) in enumerate(merged):
            if progress is not None and i % _TELL_EVERY == 0:
                progress(i / total)
            bag.write(topic, message, stamp)
    if progress is not None:
        progress(1.0)


@dataclass(frozen=True, eq=False)
class _Stream:
    """What goes to one topic: (time of recording, stamp of the header, record), and what makes a message of them."""

    topic: str
    count: int
    rows: Iterable[tuple[float, float, Any]]
    make: Callable[[Types, float, Any], Any]

    def messages(self, types: Types) -> Iterator[tuple[float, str, Any]]:
        return ((clock, self.topic, self.make(types, stamp, record)) for clock, stamp, record in self.rows)


def _streams(recording: Recording, robot: RobotDescription) -> list[_Stream]:
    topics, as_recorded = robot.topics, recording.recorded_stamps

    def of(topic: str, sensor: tuple[Any, ...], make: Callable[[Types, float, Any], Any]) -> _Stream:
        return _Stream(topic, len(sensor), ((r.stamp, as_recorded.get(r.stamp, r.stamp), r) for r in sensor), make)

    is_driver = bool(recording.wheels) and isinstance(recording.wheels[0], Odometry)
    streams = [
        of(topics.wheels or "/odom", recording.wheels, messages.odometry)
        if is_driver
        else of(topics.wheels or "/joint_states", recording.wheels, partial(_wheels, robot)),
        of(topics.lidar or "/scan", recording.scans, messages.laser_scan),
        of(topics.imu or "/imu/data", recording.imu, messages.imu),
        of(topics.fixes or "/fixes", recording.fixes, messages.pose_with_covariance),
        of(topics.joints or USUAL["joints"], recording.joints, messages.joint_state_of),
        of(topics.wrench or USUAL["wrench"], recording.wrenches, messages.wrench),
    ]
    truth = recording.truth
    if truth is not None:
        make = partial(messages.pose_stamped, has_heading=truth.has_heading)
        streams.append(_path(topics.truth or "/truth", truth, truth.poses, make))
    if recording.mounts:
        first = _first(recording)
        streams.insert(0, _Stream(_STATIC, 1, [(first, first, recording.mounts)], messages.transforms))
    return streams


def _first(recording: Recording) -> float:
    firsts = [sensor[0].stamp for sensor in (recording.wheels, recording.scans, recording.imu) if sensor]
    return min(firsts, default=0.0)


def _path(topic: str, path: PoseTrajectory, rows: Iterable[Any], make: Callable[[Types, float, Any], Any]) -> _Stream:
    return _Stream(topic, len(path), zip(path.clock.tolist(), path.stamps.tolist(), rows, strict=True), make)


def _results(
    recording: Recording,
    plan: ConfigurationTrajectory | None,
    estimate: PoseTrajectory | None,
    tool: Mapping[str, Reference],
) -> list[_Stream]:
    """Return what was planned, thought and reached, which no sensor has measured."""
    streams = []
    if plan is not None:
        start = max(float(plan.stamps[0]), 0.0)
        streams.append(_Stream(PLAN, 1, [(start, start, plan)], messages.joint_trajectory))
    if estimate is not None:
        P = [None] * len(estimate) if estimate.covariance is None else estimate.covariance
        rows = (Odometry(0.0, pose, pose_covariance=C) for pose, C in zip(estimate.poses, P, strict=True))
        streams.append(_path(ESTIMATE, estimate, rows, partial(messages.odometry, frame="map")))
    base = estimate or recording.truth
    if base is not None and base.has_heading:
        streams.append(_path(_MOVING, base, base.poses, messages.base_transform))
    for name, poses in tool.items():
        if poses.tool is not None:
            rows = zip(poses.stamps.tolist(), poses.stamps.tolist(), poses.tool, strict=True)
            streams.append(_Stream(f"{TOOL}{name}", len(poses), rows, messages.tool_pose))
    return streams


def _wheels(robot: RobotDescription, types: Types, stamp: float, record: Wheels) -> Any:
    if robot.base is None:
        raise RecordingError(f"The description of {robot.name} has no base that names the wheels; describe its base.")
    names = robot.base.wheel_names
    if isinstance(record, WheelSpeeds):
        return messages.joint_state(types, stamp, names, velocity=record.speeds)
    if isinstance(record, WheelTicks):
        return messages.joint_state(types, stamp, names, position=record.ticks)
    raise RecordingError("The wheel records are of several kinds; use only ticks, only speeds or only odometry.")
