"""Read a recording, whatever its format."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal

from longreach.errors import RecordingError
from longreach.io.bag import read_bag
from longreach.io.brenner import read_brenner
from longreach.io.carmen import read_carmen
from longreach.io.formats import recording_format
from longreach.measurement import Recording
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator, description_of


def read_recording(
    path: str | Path,
    robot: RobotDescription | MobileManipulator,
    progress: Callable[[float], None] | None = None,
    *,
    truth_topic: str | None = None,
    topics: Mapping[str, str] | None = None,
    clock: Literal["header", "record"] = "header",
) -> Recording:
    """Read a ROS 1 bag, ROS 2 bag, MCAP, CARMEN log or text folder.

    Arguments: truth_topic: the reference's topic in a bag, in place of the description's. topics: those of sensors, as
    {"lidar": "/scan"}, likewise. clock: what stamps the readings of a bag: their headers, or the times of recording.

    Raises:
        RecordingError: the file cannot be used; one sentence says why.
    """
    path, robot = Path(path), description_of(robot)
    kind = recording_format(path)
    if kind in ("carmen", "brenner"):
        if truth_topic is not None:
            raise RecordingError(f"{path} has no topics, so there is no {truth_topic}; give the reference as a file.")
        if topics:
            raise RecordingError(f"{path} has no topics, so there is no {next(iter(topics.values()))}.")
        if clock != "header":
            raise RecordingError(f"{path} has no times of recording beside its stamps; only a bag has them.")
    if kind == "carmen":
        return read_carmen(path, robot, progress)
    if kind == "brenner":
        return read_brenner(path, robot, progress)
    return read_bag(path, robot, progress, truth_topic=truth_topic, topics=topics, clock=clock)
