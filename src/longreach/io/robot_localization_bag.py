"""Read what a robot_localization node would have heard out of a bag, in the order in which it came in."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.errors import ConfigError, RecordingError
from longreach.io.bag_file import BagFile, Topic, open_bag
from longreach.io.bag_topics import ODOMETRY, TRANSFORMS, listed
from longreach.io.frames import FrameTree
from longreach.io.messages import NOT_MEASURED
from longreach.io.records import frame_name
from longreach.spatial_measurement import (
    AccelerationReading,
    Command,
    PoseReading,
    Reading,
    SpatialRecording,
    TwistReading,
)
from longreach.spatial_settings import SensorSettings, SpatialSettings

_TYPES = {
    "odom": ODOMETRY,
    "pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "twist": "geometry_msgs/msg/TwistWithCovarianceStamped",
    "imu": "sensor_msgs/msg/Imu",
}


def read_spatial_recording(
    path: Path,
    settings: SpatialSettings,
    transforms: Iterable[str] = (),
    progress: Callable[[float], None] | None = None,
) -> SpatialRecording:
    """Read the topics of the sensors that are fused, and where their frames are.

    Arguments: transforms: PARENT:CHILD=x,y,z,roll,pitch,yaw [m, rad], which go before those of the recording.

    Raises:
        ConfigError: a transform is not of that form.
        RecordingError: a topic is of another type, none is there, or a frame is not known.
    """
    tree = FrameTree()
    for text in transforms:
        tree.place(*parse_transform(text))
    with open_bag(path) as bag:
        chosen, remarks = _topics(bag, settings)
        readings, commands, empty = _read_all(bag, settings, chosen, tree, progress or (lambda fraction: None))
    mounts, origins = _frames(readings, settings, tree)
    remarks = (*bag.remarks, *remarks, *empty)
    return SpatialRecording(path.stem, tuple(readings), tuple(commands), mounts, origins, remarks)


def parse_transform(text: str) -> tuple[str, str, Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return parent, child, translation [m] and roll, pitch, yaw [rad] of PARENT:CHILD=x,y,z,roll,pitch,yaw.

    Raises:
        ConfigError: it is not of that form.
    """
    frames, _, numbers = text.partition("=")
    parent, _, child = (frame_name(name.strip()) for name in frames.partition(":"))
    try:
        values = np.array([float(number) for number in numbers.split(",")])
    except ValueError:
        values = np.zeros(0)
    if not parent or not child or parent == child or len(values) != 6 or not np.all(np.isfinite(values)):
        raise ConfigError(f"{text!r} is no transform; write PARENT:CHILD=x,y,z,roll,pitch,yaw in metres and radians.")
    return parent, child, values[:3], values[3:]


def _topics(bag: BagFile, settings: SpatialSettings) -> tuple[dict[str, Topic], list[str]]:
    """Return the topic of each sensor that has one, and `commands` where there is a control input."""
    wanted = {s.name: (s.topic, (_TYPES[s.kind],)) for s in settings.sensors if any(s.mask)}
    if settings.control is not None and any(settings.control.mask):
        kind = "geometry_msgs/msg/TwistStamped" if settings.control.stamped else "geometry_msgs/msg/Twist"
        wanted["commands"] = ("cmd_vel", (kind,))
    chosen: dict[str, Topic] = {}
    remarks = []
    for name, (topic, types) in wanted.items():
        there = [t for t in bag.topics if _same(t.name, topic)] or [t for t in bag.topics if _ends(t.name, topic)]
        right = [t for t in there if t.type in types]
        if len(right) == 1:
            chosen[name] = right[0]
        elif there:
            raise RecordingError(
                f"{bag.path}: {topic} for {name} must be one {types[0]}, but there is {listed(there)}."
            )
        else:
            remarks.append(f"The recording has no topic {topic}, so it is estimated without {name}.")
    if not chosen.keys() - {"commands"}:
        topics = ", ".join(topic for topic, _ in wanted.values())
        raise RecordingError(f"{bag.path} has none of the topics to fuse ({topics}); it has {listed(bag.topics)}.")
    return chosen, remarks


def _same(name: str, wanted: str) -> bool:
    return name.lstrip("/") == wanted.lstrip("/")


def _ends(name: str, wanted: str) -> bool:
    """Whether a topic is the wanted one in some namespace."""
    return not wanted.startswith("/") and name.endswith(f"/{wanted}")


def _read_all(
    bag: BagFile,
    settings: SpatialSettings,
    chosen: Mapping[str, Topic],
    tree: FrameTree,
    progress: Callable[[float], None],
) -> tuple[list[Reading], list[Command], list[str]]:
    readings: list[Reading] = []
    commands: list[Command] = []
    counts = dict.fromkeys(chosen, 0)
    sensors = {sensor.name: sensor for sensor in settings.sensors}
    taking: dict[tuple[str, str], list[Callable[[Any, int], None]]] = {}

    def take(name: str, message: Any, receive_ns: int) -> None:
        if name == "commands":
            found = _command(message, receive_ns)
            commands.extend(found)
        else:
            found = list(_READERS[sensors[name].kind](message, _stamp(message.header, receive_ns), sensors[name]))
            readings.extend(found)
        counts[name] += bool(found)

    for name, topic in chosen.items():
        taking.setdefault((topic.name, topic.type), []).append(partial(take, name))
    for topic in bag.topics:
        if topic.type in TRANSFORMS:
            taking.setdefault((topic.name, topic.type), []).append(lambda m, _: tree.take(m.transforms))
    bag.hand_out(taking, progress)
    empty = [
        f"No message of {chosen[name].name} says anything of what {name} fuses." for name in counts if not counts[name]
    ]
    if not readings:
        raise RecordingError(f"{bag.path}: no message holds anything that is fused; check the masks (…_config).")
    return readings, commands, empty


def _stamp(header: Any, receive_ns: int) -> float:
    """Return the header's stamp [s], or where it has none the time of recording."""
    return ((header.stamp.sec * 10**9 + header.stamp.nanosec) or receive_ns) / 10**9


def _vector(v: Any) -> list[float]:
    return [v.x, v.y, v.z]


def _rotation(q: Any) -> Float[np.ndarray, "3 3"]:
    """Return the rotation of a quaternion of any length; NaN where it has none."""
    n = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w
    s = 2.0 / n if n > 1e-12 else math.nan
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    )


def _block(covariance: np.ndarray) -> Float[np.ndarray, "6 6"]:
    out = np.zeros((6, 6))
    out[3:, 3:] = covariance.reshape(3, 3)
    return out


def _pose(message: Any, stamp: float, sensor: SensorSettings, child: str = "") -> Iterator[Reading]:
    if any(sensor.mask[:6]) and message.pose.covariance[0] != NOT_MEASURED:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = _rotation(message.pose.pose.orientation), _vector(message.pose.pose.position)
        covariance = message.pose.covariance.reshape(6, 6)
        yield PoseReading(stamp, T, covariance, frame_name(message.header.frame_id), sensor.name, child)


def _twist(message: Any, stamp: float, sensor: SensorSettings, frame: str | None = None) -> Iterator[Reading]:
    if any(sensor.mask[6:12]) and message.twist.covariance[0] != NOT_MEASURED:
        twist = np.array([*_vector(message.twist.twist.linear), *_vector(message.twist.twist.angular)])
        frame = frame_name(message.header.frame_id if frame is None else frame)
        yield TwistReading(stamp, twist, message.twist.covariance.reshape(6, 6), frame, sensor.name)


def _odometry(message: Any, stamp: float, sensor: SensorSettings) -> Iterator[Reading]:
    child = frame_name(message.child_frame_id)
    yield from _pose(message, stamp, sensor, child if sensor.child_frame else "")
    yield from _twist(message, stamp, sensor, child)


def _imu(message: Any, stamp: float, sensor: SensorSettings) -> Iterator[Reading]:
    frame, R = frame_name(message.header.frame_id), None
    if message.orientation_covariance[0] != NOT_MEASURED:
        T = np.eye(4)
        T[:3, :3] = R = _rotation(message.orientation)
        if any(sensor.mask[3:6]):
            yield PoseReading(stamp, T, _block(message.orientation_covariance), frame, sensor.name)
    if any(sensor.mask[9:12]) and message.angular_velocity_covariance[0] != NOT_MEASURED:
        twist = np.array([0.0, 0.0, 0.0, *_vector(message.angular_velocity)])
        yield TwistReading(stamp, twist, _block(message.angular_velocity_covariance), frame, sensor.name)
    if any(sensor.mask[12:]) and message.linear_acceleration_covariance[0] != NOT_MEASURED:
        acceleration = np.array(_vector(message.linear_acceleration))
        covariance = message.linear_acceleration_covariance.reshape(3, 3)
        yield AccelerationReading(stamp, acceleration, covariance, frame, sensor.name, R)


def _command(message: Any, receive_ns: int) -> list[Command]:
    stamped = message.__msgtype__ == "geometry_msgs/msg/TwistStamped"
    twist = message.twist if stamped else message
    values = np.array([*_vector(twist.linear), *_vector(twist.angular)])
    stamp = _stamp(message.header, receive_ns) if stamped else receive_ns / 10**9
    return [Command(stamp, values)] if np.all(np.isfinite(values)) else []


_READERS: Mapping[str, Callable[[Any, float, SensorSettings], Iterator[Reading]]] = {
    "odom": _odometry,
    "pose": _pose,
    "twist": _twist,
    "imu": _imu,
}


def _frames(
    readings: Sequence[Reading], settings: SpatialSettings, tree: FrameTree
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Return T_base_frame and T_world_frame of the frames that the readings are in; "" is the base, or the world."""
    kinds = {sensor.name: sensor for sensor in settings.sensors}
    mounts, origins = {"": np.eye(4)}, {"": np.eye(4)}
    for reading in readings:
        in_world = isinstance(reading, PoseReading) and kinds[reading.source].kind != "imu"
        if in_world and kinds[reading.source].differential:
            origins.setdefault(reading.frame, np.eye(4))  # only how the pose changes is fused
        for frame, known, root in (
            (reading.frame, origins if in_world else mounts, settings.world_frame if in_world else settings.base_frame),
            (reading.child if isinstance(reading, PoseReading) else "", mounts, settings.base_frame),
        ):
            if frame not in known:
                T = tree.between(root, frame)
                if T is None:
                    raise RecordingError(
                        f"{reading.source} is in the frame {frame}, which nothing in the recording fixes to {root}; "
                        f"say where it is by --transform {root}:{frame}=x,y,z,roll,pitch,yaw."
                    )
                known[frame] = T
    return mounts, origins
