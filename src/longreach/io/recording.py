"""Read a recording or a reference, whatever its format."""

from collections.abc import Callable
from pathlib import Path

from longreach.errors import RecordingError
from longreach.io.bag import read_bag
from longreach.io.brenner import read_brenner, read_positions
from longreach.io.carmen import read_carmen, read_corrected_poses
from longreach.io.formats import recording_format
from longreach.io.text_lines import text_lines
from longreach.io.tum import read_tum
from longreach.measurement import Recording
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator, description_of
from longreach.trajectory import PoseTrajectory


def read_recording(
    path: str | Path,
    robot: RobotDescription | MobileManipulator,
    progress: Callable[[float], None] | None = None,
    *,
    truth_topic: str | None = None,
) -> Recording:
    """Read a ROS 1 bag, ROS 2 bag, MCAP, CARMEN log or text folder.

    Arguments: truth_topic: the reference's topic in a bag, in place of the description's.

    Raises:
        RecordingError: the file cannot be used; one sentence says why.
    """
    path, robot = Path(path), description_of(robot)
    kind = recording_format(path)
    if kind in ("carmen", "brenner") and truth_topic is not None:
        raise RecordingError(f"{path} has no topics, so there is no {truth_topic}; give the reference as a file.")
    if kind == "carmen":
        return read_carmen(path, robot, progress)
    if kind == "brenner":
        return read_brenner(path, robot, progress)
    return read_bag(path, robot, progress, truth_topic=truth_topic)


def read_poses(path: Path, recording: Recording | None = None) -> PoseTrajectory:
    """Read a trajectory from a file: TUM, a corrected CARMEN log, or positions as text (P ms x y).

    Arguments: recording: what a corrected log was made from, to give it that recording's stamps.
    """
    _, first = next(iter(text_lines(path)), (0, ""))
    if first.startswith("P "):
        return read_positions(path)
    if first.split(" ", 1)[0].isupper():
        return read_corrected_poses(path, recording)
    return read_tum(path)
