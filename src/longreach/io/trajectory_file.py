"""Read a trajectory, whatever its file: TUM, EuRoC, KITTI, a corrected CARMEN log, or positions as text.

What such files leave open is found from their numbers, and each finding is a remark: stamps in nanoseconds, quaternions
with w first, axes as cameras have them. A robot that drives stays in a plane and turns about its normal; it does so
with one order of the quaternion and one set of axes alone.
"""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from longreach.errors import ConfigError, RecordingError
from longreach.io.brenner import read_positions
from longreach.io.carmen import read_corrected_poses
from longreach.io.text_lines import numbers, text_lines
from longreach.io.tum import HEADER, pose_rows, read_tum, rotations
from longreach.measurement import Recording
from longreach.trajectory import PoseTrajectory

_UNITS = (
    (1e17, 1e9, "nanoseconds"),
    (1e14, 1e6, "microseconds"),
    (1e11, 1e3, "milliseconds"),
)  # stamps above, a second
_NANOSECOND_STEP = 1e6  # no robot writes its poses less than once in so many seconds, 11 days
_TIPPED = 0.7  # by more than 40°
_FLAT = 0.05  # how far vectors of length 1 may be off: about 3°
# Camera axes (x right, y down, z forward) → those of a robot (x forward, y left, z up).
_OF_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
ASSUMPTIONS = {"quaternion": ("xyzw", "wxyz"), "axes": ("robot", "camera", "camera-body")}


def read_poses(
    path: Path, recording: Recording | None = None, assume: Mapping[str, str] | None = None
) -> tuple[PoseTrajectory, tuple[str, ...]]:
    """Read a trajectory from a file, and what there is to say about it.

    A file of KITTI has no stamps: they are those of times.txt beside it, or else the numbers of its lines.

    Arguments: recording: what a corrected log was made from, to give it that recording's stamps. assume: what is known
    of the file, unless it says so itself: quaternion: xyzw or wxyz; axes: robot, camera (of the poses and of what they
    are in), or camera-body (of the poses alone).

    Raises:
        RecordingError: the file cannot be read as any of them.
        ConfigError: an assumption is none.
    """
    assume = assume or {}
    for name, value in assume.items():
        if value not in ASSUMPTIONS.get(name, ()):
            known = "; ".join(f"{key}={'|'.join(values)}" for key, values in ASSUMPTIONS.items())
            raise ConfigError(f"{name}={value} is nothing that can be assumed of a trajectory; there are {known}.")
    words = next((text.replace(",", " ").split() for _, text in text_lines(path)), [])
    if words and _is_ours(path):
        return read_tum(path), ()
    if words[:1] == ["P"]:
        return read_positions(path), ()
    if words and words[0].isupper() and words[0].isidentifier():
        return read_corrected_poses(path, recording), ()
    remarks: list[str] = []
    if len(words) == 12:
        stamps, p, R = _read_kitti(path, remarks)
    else:
        table = pose_rows(path, 17 if len(words) == 17 else 8)  # of EuRoC's ground truth, which has more
        stamps, p, q = _in_seconds(table[:, 0], remarks), table[:, 1:4], table[:, 4:]
        order = "wxyz" if len(words) == 17 else _named_order(path) or assume.get("quaternion")
        if order is None and _is_w_first(q):
            order = "wxyz"
            remarks.append(
                "its quaternions are taken for w x y z: as x y z w, TUM's order, the robot would tip over. --assume "
                "quaternion=xyzw takes them as they are."
            )
        R = rotations(q[:, [1, 2, 3, 0]] if order == "wxyz" else q)
    p, R = _with_axes(p, R, assume.get("axes"), remarks)
    heading = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    found = PoseTrajectory(stamps, np.column_stack([p[:, :2], heading]))
    return found, tuple(f"{path.name}: {remark}" for remark in remarks)


def stamped_like(path: PoseTrajectory, other: PoseTrajectory) -> PoseTrajectory | None:
    """Return poses without stamps with those of another trajectory, line by line, or None where the lengths differ."""
    if len(path) != len(other):
        return None
    return PoseTrajectory(other.stamps, path.poses, clock=other.clock, has_heading=path.has_heading)


def has_stamps(path: Path) -> bool:
    """Whether a file has stamps itself, or a times.txt beside it; files of KITTI have none."""
    words = next((text.split() for _, text in text_lines(path)), [])
    return len(words) != 12 or _times_of(path) is not None


def _is_ours(path: Path) -> bool:
    """Whether a file begins as those that are written here, of which all is known."""
    with path.open("rb") as file:
        return file.readline().strip() == HEADER.encode()


def _named_order(path: Path) -> str | None:
    """Return the order of the quaternion where the first line names the columns, as q_RS_w or qx."""
    with path.open(encoding="utf-8-sig", errors="replace") as lines:
        named = "".join(re.findall(r"\bq\w*?([wxyz])\b", lines.readline().lower()))
    return named if named in ASSUMPTIONS["quaternion"] else None


def _times_of(path: Path) -> Path | None:
    """Return the file of stamps that belongs to one of KITTI's poses."""
    known = ("times.txt", f"{path.stem}_times.txt", f"../sequences/{path.stem}/times.txt")
    return next((path.parent / name for name in known if name != path.name and (path.parent / name).is_file()), None)


def _read_kitti(
    path: Path, remarks: list[str]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
    """Return stamps, positions and rotations: each line holds the upper three rows of a transformation."""
    rows = []
    for line, text in text_lines(path):
        row = numbers(path, line, text.split())
        if len(row) != 12 or not np.all(np.isfinite(row)):
            raise RecordingError(f"{path}, line {line}: a line of KITTI's poses is 12 finite numbers.")
        rows.append(row)
    T = np.array(rows).reshape(-1, 3, 4)
    R = T[:, :, :3]
    if np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max() > _FLAT or np.any(np.linalg.det(R) < 0):
        raise RecordingError(f"{path} has 12 numbers a line as KITTI's poses, but they hold no rotations.")
    times = _times_of(path)
    if times is None:
        return np.arange(float(len(rows))), T[:, :, 3], R
    stamps = np.array([numbers(times, line, text.split()[:1])[0] for line, text in text_lines(times)])
    if len(stamps) != len(rows):
        raise RecordingError(
            f"{times} has {len(stamps)} stamps for the {len(rows)} poses of {path}; take its own file."
        )
    remarks.append(f"poses of KITTI have no stamps; those of {times.name} are taken, line by line.")
    return _in_seconds(stamps, remarks), T[:, :, 3], R


def _in_seconds(stamps: Float[np.ndarray, " n"], remarks: list[str]) -> Float[np.ndarray, " n"]:
    """Return stamps [s], which are in a smaller unit where they could not be seconds."""
    largest, step = np.abs(stamps).max(), np.median(np.abs(np.diff(stamps))) if len(stamps) > 1 else 0.0
    unit = next(((size, name) for above, size, name in _UNITS if largest > above), None)
    if step >= _NANOSECOND_STEP and np.all(stamps == np.round(stamps)):
        unit = (1e9, "nanoseconds")
    if unit is None:
        return stamps
    remarks.append(f"its stamps are in {unit[1]}; they were converted to seconds.")
    return stamps / unit[0]


def _is_w_first(q: Float[np.ndarray, "n 4"]) -> bool:
    """Whether quaternions turn about z alone as w x y z, and about other axes as x y z w."""
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    return bool(np.abs(q[:, 1:3]).max() < _FLAT and np.abs(q[:, 0]).max() > 0.5)


def _with_axes(
    p: Float[np.ndarray, "n 3"], R: Float[np.ndarray, "n 3 3"], assumed: str | None, remarks: list[str]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 3"]]:
    """Return positions and rotations with x forward, y left and z up."""
    axes, why = assumed or "robot", ""
    if assumed is None and len(p) > 1:
        extent = np.ptp(p, axis=0)
        turns = np.any(R[:, 2, 2] < R[:, 1, 1] - _FLAT) or extent[2] > 5 * np.hypot(*extent[:2])
        if np.all(R[:, 1, 1] > 0.9) and extent[1] < 0.2 * np.hypot(extent[0], extent[2]) and turns:
            axes, why = "camera", "the path stays in the plane of x and z"
        elif np.all(R[:, 2, 1] < -0.9) and extent[2] < 0.2 * np.hypot(*extent[:2]):
            axes, why = "camera-body", "y points down all along"
    if why:
        remarks.append(
            f"its axes are taken for a camera's (x right, y down, z forward): {why}. They were changed to x forward, "
            "y left, z up; --assume axes=robot takes them as they are."
        )
    C = _OF_CAMERA
    if axes != "robot":
        R = C @ R @ C.T if axes == "camera" else R @ C.T
        p = p @ C.T if axes == "camera" else p
    if np.abs(R[:, 2] - R[0, 2]).max() > _TIPPED:
        remarks.append(
            "its poses tip over, which a robot that drives does not; its quaternions or axes may be others than taken "
            "(--assume quaternion=…, axes=…)."
        )
    return p, R
