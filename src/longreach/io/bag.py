"""Read a ROS bag (ROS 1, ROS 2 sqlite3 or MCAP) as a Recording, without ROS."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from longreach.errors import RecordingError
from longreach.io import records
from longreach.io.bag_file import BagFile, Topic, open_bag
from longreach.io.bag_topics import JOINT_STATE, TRANSFORMS, check_topics, choose_topics, listed, with_topics
from longreach.io.frames import FrameTree
from longreach.measurement import Recording
from longreach.robot.description import RobotDescription
from longreach.trajectory import PoseTrajectory, monotone_clock

_SINCE_1970 = 1e8  # [s]; a clock that is beyond this counts from 1970


@dataclass(eq=False)
class _Sensor:
    """What came in on one topic: stamps of the headers and of the recording [ns], and what was read.

    clock: record: the times of recording stand for the headers' stamps.
    """

    topic: Topic
    clock: Literal["header", "record"] = "header"
    header_ns: list[int] = field(default_factory=list)
    receive_ns: list[int] = field(default_factory=list)
    read: list[Any] = field(default_factory=list)
    left_out: int = 0

    def take(self, header: Any, receive_ns: int, value: Any) -> None:
        if value is None:
            self.left_out += 1
            return
        by_header = self.clock == "header"
        self.header_ns.append(header.stamp.sec * 10**9 + header.stamp.nanosec if by_header else receive_ns)
        self.receive_ns.append(receive_ns)
        self.read.append(value)

    def keep(self, rows: Sequence[bool]) -> None:
        """Leave out the messages whose row is False."""
        for values in (self.header_ns, self.receive_ns, self.read):
            values[:] = [value for value, kept in zip(values, rows, strict=True) if kept]


def read_bag(
    path: Path,
    robot: RobotDescription,
    progress: Callable[[float], None] | None = None,
    *,
    truth_topic: str | None = None,
    topics: Mapping[str, str] | None = None,
    clock: Literal["header", "record"] = "header",
) -> Recording:
    """Read the topics that the robot's description names, or the only one of a sensor's type.

    Messages stay in the order in which they were recorded. Where the stamps of a sensor's headers run backwards a
    repaired clock takes their place (`Recording.recorded_stamps`).

    Arguments: progress: called with how far it is, 0 to 1. truth_topic: in place of `robot.topics.truth`.
    topics: likewise of sensors, as {"lidar": "/scan"}; they must be there. clock: what stamps the readings: their
    headers, or the times of recording.

    Raises:
        RecordingError: the bag is damaged, or a topic is missing, ambiguous or of the wrong type.
    """
    robot = with_topics(robot, topics or {})
    with open_bag(path) as bag:
        if not bag.topics:
            raise RecordingError(f"{path} holds no messages; record it again.")
        check_topics(bag, topics or {})
        chosen, remarks = choose_topics(bag, robot, truth_topic)
        if not chosen.keys() & {"wheels", "lidar", "imu"}:
            raise RecordingError(f"{path} has neither wheels nor LIDAR nor IMU; it has {listed(bag.topics)}.")
        sensors = {role: _Sensor(topic, clock) for role, topic in chosen.items()}
        tree = _read_all(bag, sensors, robot, progress or (lambda fraction: None))
    if "wheels" in sensors:
        needed = robot.topics.wheels is not None or not sensors.keys() & {"lidar", "imu"}
        _keep_wheels(sensors["wheels"], robot, needed)
    guesses = _take_guesses(sensors["fixes"]) if "fixes" in sensors else ()
    truth, said = _truth(sensors.pop("truth", None))
    made, recorded, repairs = _records(sensors)
    frames = {record.frame for role in ("lidar", "imu") for record in made.get(role, ())}
    mounts, moving = tree.mounts(sorted(frames))
    lost = (f"{frame} moves in the base, so no mount is known of it." for frame in moving)
    return Recording(
        name=path.stem,
        wheels=made.get("wheels", ()),
        scans=made.get("lidar", ()),
        imu=made.get("imu", ()),
        fixes=made.get("fixes", ()),
        joints=made.get("joints", ()),
        wrenches=made.get("wrench", ()),
        truth=truth,
        mounts=mounts,
        recorded_stamps=recorded,
        remarks=(*bag.remarks, *remarks, *said, *guesses, *repairs, *lost),
    )


def _read_all(
    bag: BagFile, sensors: Mapping[str, _Sensor], robot: RobotDescription, progress: Callable[[float], None]
) -> FrameTree:
    """Read all messages of the sensors' topics, and the transforms if a sensor has a frame to look for."""
    tree = FrameTree()
    readers: dict[str, Callable[[Any], Any]] = {
        "wheels": partial(_read_wheels, robot=robot),
        "lidar": lambda message: records.laser_scan(message, robot.lidar),
        "imu": records.imu,
        "fixes": records.fix,
        "joints": lambda message: records.joints(message, robot),
        "wrench": records.wrench,
        "truth": records.stamped_pose,
    }
    taking: dict[tuple[str, str], list[Callable[[Any, int], None]]] = {}
    for role, sensor in sensors.items():
        take = (
            partial(_take_transforms, sensor)
            if sensor.topic.type in TRANSFORMS
            else partial(_take, sensor, readers[role])
        )
        taking.setdefault((sensor.topic.name, sensor.topic.type), []).append(take)
    if sensors.keys() & {"lidar", "imu"}:
        for topic in bag.topics:
            if topic.type in TRANSFORMS:
                taking.setdefault((topic.name, topic.type), []).append(lambda m, _: tree.take(m.transforms))
    bag.hand_out(taking, progress)
    return tree


def _take(sensor: _Sensor, read: Callable[[Any], Any], message: Any, receive_ns: int) -> None:
    sensor.take(message.header, receive_ns, read(message))


def _take_transforms(sensor: _Sensor, message: Any, receive_ns: int) -> None:
    for transform in message.transforms:
        child = records.frame_name(transform.child_frame_id)
        pose = records.stamped_pose(transform)
        sensor.take(transform.header, receive_ns, None if pose is None else (*pose, child))


def _read_wheels(message: Any, robot: RobotDescription) -> Any:
    if message.__msgtype__ == JOINT_STATE:
        return records.wheels(message, robot)
    make = records.odometry(message)
    return None if make is None else (True, make)


def _keep_wheels(sensor: _Sensor, robot: RobotDescription, needed: bool) -> None:
    """Where some messages name the wheels, leave out those that do not; that there are none may be an error."""
    if needed and not sensor.read:
        wanted = "a finite pose or twist"
        if robot.base is not None and sensor.topic.type == JOINT_STATE:
            signal = robot.encoder.signal if robot.encoder else "angle"
            wanted = f"the {'velocity' if signal == 'speed' else 'position'} of {', '.join(robot.base.wheel_names)}"
        raise RecordingError(f"No message of {sensor.topic.name} has {wanted}; name the wheels' topic and joints.")
    by_name = any(named for named, _ in sensor.read)
    sensor.keep([named or not by_name for named, _ in sensor.read])
    sensor.read[:] = [make for _, make in sensor.read]


def _take_guesses(sensor: _Sensor) -> tuple[str, ...]:
    """Say how many fixes do not tell how good they are."""
    guessed = sum(not known for known, _ in sensor.read)
    sensor.read[:] = [make for _, make in sensor.read]
    x, _, heading = records.FIX_DEVIATIONS
    say = (
        f"{guessed} fixes of {sensor.topic.name} have no covariance; they are taken to be good to {x} m, {heading} rad."
    )
    return (say,) if guessed else ()


def _truth(sensor: _Sensor | None) -> tuple[PoseTrajectory | None, list[str]]:
    if sensor is None:
        return None, []
    if sensor.topic.type in TRANSFORMS:
        _keep_base(sensor)
    headings = [not math.isnan(pose[2]) for pose, *_ in sensor.read]
    has_heading = any(headings)
    if has_heading:
        sensor.left_out += len(headings) - sum(headings)
        sensor.keep(headings)
    stamps, said = _stamps(sensor)
    poses = np.array([pose for pose, *_ in sensor.read]).reshape(-1, 3)
    if not len(poses):
        return None, said
    truth = PoseTrajectory(stamps, np.nan_to_num(poses), has_heading=has_heading)
    backward = int(np.sum(np.diff(stamps) < 0))
    if backward:
        said.append(_repaired(sensor, backward))
    return truth, said


def _keep_base(sensor: _Sensor) -> None:
    children = sorted({child for *_, child in sensor.read})
    base = "base_link" if "base_link" in children else children[0] if len(children) == 1 else None
    if base is None:
        raise RecordingError(
            f"{sensor.topic.name} has several frames and none is base_link: {', '.join(children) or 'none at all'}; "
            "give a topic with one pose as the truth."
        )
    sensor.keep([child == base for *_, child in sensor.read])


def _records(
    sensors: Mapping[str, _Sensor],
) -> tuple[dict[str, tuple[Any, ...]], dict[float, float], list[str]]:
    """Return the records of each sensor, repaired stamp → stamp as recorded where they differ, and remarks."""
    made: dict[str, tuple[Any, ...]] = {}
    recorded: dict[float, float] = {}
    remarks = []
    for role, sensor in sensors.items():
        stamps, said = _stamps(sensor)
        remarks += said
        backward = int(np.sum(np.diff(stamps) < 0))
        clock = monotone_clock(stamps) if backward else stamps
        if backward:
            remarks.append(_repaired(sensor, backward))
            recorded |= {c: s for c, s in zip(clock.tolist(), stamps.tolist(), strict=True) if c != s}
        made[role] = tuple(make(stamp=stamp) for make, stamp in zip(sensor.read, clock.tolist(), strict=True))
    return made, recorded, remarks


def _repaired(sensor: _Sensor, backward: int) -> str:
    return f"{backward} stamps of {sensor.topic.name} run backwards; they were repaired in the order of the file."


def _stamps(sensor: _Sensor) -> tuple[Float[np.ndarray, " n"], list[str]]:
    """Return the stamps [s] of a sensor as recorded: of the headers, or of the recording where headers have none."""
    said = []
    if sensor.left_out:
        said.append(f"{sensor.left_out} messages of {sensor.topic.name} hold nothing that can be used.")
    if not sensor.read:
        return np.zeros(0), said
    header, receive = (np.array([ns / 10**9 for ns in values]) for values in (sensor.header_ns, sensor.receive_ns))
    unset = (header == 0) & ((header.max() == 0) | (header.max() > _SINCE_1970))
    if np.any(unset & (receive > 0)):
        said.append(f"{unset.sum()} messages of {sensor.topic.name} have no stamp; the time of recording is taken.")
    return np.where(unset, receive, header), said
