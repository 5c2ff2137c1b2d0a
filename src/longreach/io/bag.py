"""Read a ROS bag (ROS 1, ROS 2 sqlite3 or MCAP) as a Recording, without ROS."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from longreach.errors import RecordingError
from longreach.io import clocks, records
from longreach.io.bag_file import BagFile, Topic, open_bag
from longreach.io.bag_topics import (
    JOINT_STATE,
    ODOMETRY,
    TRANSFORMS,
    check_topics,
    choose_topics,
    listed,
    with_topics,
)
from longreach.io.clocks import Clock
from longreach.io.frames import FrameTree, is_base
from longreach.measurement import Recording
from longreach.robot.description import Lidar, RobotDescription
from longreach.trajectory import PoseTrajectory, monotone_clock


@dataclass(eq=False)
class _Sensor:
    """What came in on one topic: stamps of the headers and of the recording [ns], and what was read."""

    topic: Topic
    header_ns: list[int] = field(default_factory=list)
    receive_ns: list[int] = field(default_factory=list)
    read: list[Any] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)

    def take(self, header: Any, receive_ns: int, value: Any) -> None:
        """Take what was read of a message, or why it cannot be used (str), or None where it is about something else."""
        if value is None or isinstance(value, str):
            self.left_out[value or "has no joint that is looked for"] += 1
            return
        self.header_ns.append(header.stamp.sec * 10**9 + header.stamp.nanosec)
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
    clock: Clock = "header",
) -> Recording:
    """Read the topics that the robot's description names, or the only one of a sensor's type.

    Messages stay in the order in which they were recorded. Stamps are put on one clock (`io.clocks`); where those of a
    sensor run backwards a repaired clock takes their place (`Recording.recorded_stamps`).

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
        sensors = {role: _Sensor(topic) for role, topic in chosen.items()}
        tree = _read_all(bag, sensors, robot, progress or (lambda fraction: None))
    driven, remarks = "", [*bag.remarks, *remarks]
    if "wheels" in sensors:
        if sensors["wheels"].topic.type == ODOMETRY:
            driven, said = _read_odometry(sensors["wheels"], tree)
            remarks += said
        needed = robot.topics.wheels is not None or not sensors.keys() & {"lidar", "imu"}
        _keep_wheels(sensors["wheels"], robot, needed)
    if "fixes" in sensors:
        remarks += _take_guesses(sensors["fixes"])
    if "truth" in sensors:
        _keep_truth(sensors["truth"])
    for sensor in sensors.values():
        _drop_repeated(sensor)
    stamps, said = clocks.on_one_clock({role: _stamped(sensor) for role, sensor in sensors.items()}, clock)
    remarks += [*_left_out(sensors), *said]
    truth, said = _truth(sensors.pop("truth", None), stamps)
    made, recorded, repairs = _records(sensors, stamps)
    frames = {role: sorted({record.frame for record in made.get(role, ())}) for role in ("lidar", "imu")}
    mounts, missing = tree.mounts(chain(*frames.values()), driven)
    lost = [
        f"Nothing says where the {role} is mounted ({frame}: {missing[frame]}); it is taken to stand at base_link, "
        f"looking ahead. Give {role}.mount in the robot's description."
        for role, sensor in (("lidar", robot.lidar or Lidar()), ("imu", robot.imu))
        for frame in frames[role]
        if frame in missing and sensor is not None and sensor.mount is None
    ]
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
        remarks=(*remarks, *said, *repairs, *lost),
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
    if sensors.keys() & {"lidar", "imu", "wheels"}:
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
    return records.wheels(message, robot) if message.__msgtype__ == JOINT_STATE else message


def _read_odometry(sensor: _Sensor, tree: FrameTree) -> tuple[str, list[str]]:
    """Read the messages of a topic of odometry, now that all transforms are known; return the frame that drives.

    Where that is mounted on the base its motion is carried to the base.
    """
    children = {records.frame_name(message.child_frame_id) for message in sensor.read}
    child = min(children, default="")
    if len(children) > 1:
        names = ", ".join(sorted(children))
        raise RecordingError(f"{sensor.topic.name} has the motion of several frames: {names}; name another topic.")
    base, name, T, said = tree.base([child]), tree.resolved(child), None, list[str]()
    if base is not None and child and name != base and not is_base(child):
        T = None if name is None else tree.between(base, name)
        if T is None:
            said.append(f"{sensor.topic.name} has the motion of {child}, which no transform joins to {base}; ")
            said[0] += "it was taken for the motion of the base."
        elif not np.allclose(T, np.eye(4)):
            said.append(f"{sensor.topic.name} has the motion of {child}; it was carried to {base} by their transform.")
    keep = []
    for i, message in enumerate(sensor.read):
        made = records.odometry(message, T)
        sensor.read[i] = (True, made)
        keep.append(not isinstance(made, str))
        if isinstance(made, str):
            sensor.left_out[made] += 1
    sensor.keep(keep)
    return child, said


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


def _take_guesses(sensor: _Sensor) -> list[str]:
    """Say how many fixes do not tell how good they are."""
    guessed = sum(not known for known, _ in sensor.read)
    sensor.read[:] = [make for _, make in sensor.read]
    x, _, heading = records.FIX_DEVIATIONS
    say = (
        f"{guessed} fixes of {sensor.topic.name} have no covariance; they are taken to be good to {x} m, {heading} rad."
    )
    return [say] if guessed else []


def _keep_truth(sensor: _Sensor) -> None:
    """Leave out what is not about the base, and where some poses have a heading those that have none."""
    if sensor.topic.type in TRANSFORMS:
        _keep_base(sensor)
    headings = [not math.isnan(pose[2]) for pose, *_ in sensor.read]
    if any(headings) and not all(headings):
        sensor.left_out["has no heading"] += len(headings) - sum(headings)
        sensor.keep(headings)


def _drop_repeated(sensor: _Sensor) -> None:
    """Leave out messages that are there twice."""
    same = [a == b != 0 for a, b in pairwise(sensor.header_ns)]
    if any(same):
        twice = [is_one and _is_same(*both) for is_one, both in zip(same, pairwise(sensor.read), strict=True)]
        sensor.left_out["is equal to the one before, stamp included"] += sum(twice)
        sensor.keep([True, *(not one for one in twice)])


def _is_same(a: Any, b: Any) -> bool:
    if not (isinstance(a, partial) and isinstance(b, partial)):
        return False
    return all(np.array_equal(value, b.keywords[name]) for name, value in a.keywords.items())


def _truth(sensor: _Sensor | None, stamps: Mapping[str, np.ndarray]) -> tuple[PoseTrajectory | None, list[str]]:
    if sensor is None or not sensor.read:
        return None, []
    poses = np.array([pose for pose, *_ in sensor.read])
    has_heading = not np.isnan(poses[0, 2])
    truth = PoseTrajectory(stamps["truth"], np.nan_to_num(poses), has_heading=bool(has_heading))
    backward = int(np.sum(np.diff(truth.stamps) < 0))
    return truth, [_repaired(sensor, backward)] if backward else []


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
    sensors: Mapping[str, _Sensor], stamps: Mapping[str, np.ndarray]
) -> tuple[dict[str, tuple[Any, ...]], dict[float, float], list[str]]:
    """Return the records of each sensor, repaired stamp → stamp as recorded where they differ, and remarks."""
    made: dict[str, tuple[Any, ...]] = {}
    recorded: dict[float, float] = {}
    remarks = []
    for role, sensor in sensors.items():
        backward = int(np.sum(np.diff(stamps[role]) < 0))
        clock = monotone_clock(stamps[role]) if backward else stamps[role]
        if backward:
            remarks.append(_repaired(sensor, backward))
            recorded |= {c: s for c, s in zip(clock.tolist(), stamps[role].tolist(), strict=True) if c != s}
        made[role] = tuple(make(stamp=stamp) for make, stamp in zip(sensor.read, clock.tolist(), strict=True))
    return made, recorded, remarks


def _repaired(sensor: _Sensor, backward: int) -> str:
    return f"{backward} stamps of {sensor.topic.name} run backwards; they were repaired in the order of the file."


def _stamped(sensor: _Sensor) -> clocks.Stamped:
    header, received = (np.array([ns / 10**9 for ns in values]) for values in (sensor.header_ns, sensor.receive_ns))
    return clocks.Stamped(sensor.topic.name, header, received)


def _left_out(sensors: Mapping[str, _Sensor]) -> list[str]:
    return [
        records.left_out(count, sensor.topic.name, why)
        for sensor in sensors.values()
        for why, count in sensor.left_out.items()
        if count
    ]
