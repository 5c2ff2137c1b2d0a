"""The plain text files of C. Brenner's course (a small tracked robot in an arena), a folder with

    *_motors.txt      M ms left … right …    columns 2 and 6, from 0: absolute encoder counts, left and right
    *_scan.txt        S ms n r1 … rn         ranges in mm, beams counter-clockwise
    *_reference.txt   P ms x y               position of an overhead camera in mm (may be missing)

The beams' angles stand in the robot's description.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from longreach.errors import RecordingError
from longreach.io.recording_info import RecordingInfo, topic_info
from longreach.io.text_lines import numbers, text_lines
from longreach.measurement import LaserScan, Recording, WheelTicks
from longreach.robot.description import RobotDescription
from longreach.trajectory import PoseTrajectory

_MILLI = 1e-3


def _rows(path: Path, kind: str, fewest: int) -> list[list[float]]:
    rows = []
    for line, text in text_lines(path):
        words = text.split()
        if words[0] != kind or len(words) < fewest:
            raise RecordingError(f"{path}, line {line}: expected {kind} and at least {fewest - 1} numbers.")
        rows.append(numbers(path, line, words[1:]))
    if not rows:
        raise RecordingError(f"{path} is empty.")
    return rows


def _only(folder: Path, ending: str) -> Path:
    found = sorted(folder.glob(f"*_{ending}.txt"))
    if len(found) != 1:
        raise RecordingError(f"{folder} must hold just one file *_{ending}.txt, but holds {len(found)}.")
    return found[0]


def read_brenner(folder: Path, robot: RobotDescription, progress: Callable[[float], None] | None = None) -> Recording:
    """Read the folder; the reference is for evaluation alone."""
    lidar = robot.lidar
    if lidar is None or lidar.angle_min is None or lidar.angle_increment is None:
        raise RecordingError(
            f"The description of {robot.name} does not say angle_min and angle_increment of its lidar, and {folder} "
            "does not either; take the robot brenner."
        )
    motors = _rows(_only(folder, "motors"), "M", 8)
    scans = _rows(_only(folder, "scan"), "S", 4)
    for row in scans:
        if len(row) != 2 + int(row[1]):
            raise RecordingError(f"{folder}: the scan at {row[0]:.0f} ms has {len(row) - 2} of {row[1]:.0f} ranges.")
    reference = sorted(folder.glob("*_reference.txt"))
    return Recording(
        name=folder.name,
        wheels=tuple(WheelTicks(row[0] * _MILLI, np.array([row[1], row[5]])) for row in motors),
        scans=tuple(
            LaserScan(
                row[0] * _MILLI,
                np.array(row[2:]) * _MILLI,
                lidar.angle_min,
                lidar.angle_increment,
                lidar.range_min or 0.0,
                lidar.range_max or np.inf,
            )
            for row in scans
        ),
        truth=read_positions(reference[0]) if reference else None,
    )


def read_positions(path: Path) -> PoseTrajectory:
    """Read a reference file: positions without headings."""
    table = np.array([row[:3] for row in _rows(path, "P", 4)]) * _MILLI
    return PoseTrajectory(table[:, 0], np.column_stack([table[:, 1:], np.zeros(len(table))]), has_heading=False)


def inspect(folder: Path) -> RecordingInfo:
    """Count and time the lines of each file."""
    kinds = {"motors": ("M", "encoder counts"), "scan": ("S", "ranges"), "reference": ("P", "positions")}
    stamps, topics = [], []
    for ending, (letter, what) in kinds.items():
        for path in sorted(folder.glob(f"*_{ending}.txt")):
            times = np.array([row[0] for row in _rows(path, letter, 2)]) * _MILLI
            stamps.append(times)
            topics.append(topic_info(path.name, what, times))
    both = np.concatenate(stamps)
    return RecordingInfo("text files", float(both.min()), float(np.ptp(both)), tuple(topics))
