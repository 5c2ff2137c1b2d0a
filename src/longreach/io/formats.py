"""Which format a recording has, told from its name and first bytes; one that is not read is called by its name."""

import bz2
import gzip
import lzma
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal

from longreach.errors import RecordingError

Format = Literal["ros1", "ros2", "sqlite", "mcap", "carmen", "brenner"]

ROS1_MAGIC = b"#ROSBAG V2"
MCAP_MAGIC = b"\x89MCAP0\r\n"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_SQLITE_MAGIC = b"SQLite format 3\0"
# How files are opened that are compressed as a whole; Zstandard has no opener before Python 3.14.
COMPRESSIONS: Mapping[str, Callable[..., Any] | None] = {
    ".gz": gzip.open,
    ".bz2": bz2.open,
    ".xz": lzma.open,
    ".zst": None,
    ".zstd": None,
}
_SUFFIXES: dict[str, Format] = {
    ".bag": "ros1",
    ".mcap": "mcap",
    ".db3": "sqlite",
    ".clf": "carmen",
    ".log": "carmen",
}
_ACCEPTED = (
    "a recording is a ROS 1 .bag, a ROS 2 folder or its .db3 or .mcap (bags also .gz, .bz2, .xz, .zstd), a CARMEN .clf "
    "or .log (also .gz, .bz2, .xz), or a folder with *_motors.txt and *_scan.txt"
)
_TO_ROS = "replay it with that sensor's ROS driver and record the topics as a bag"
_TRAJECTORY = "`longreach evaluate` reads it, and --truth takes it, but it is no recording"
# What files begin with, or contain near their start, what they are, and what to do.
_BYTES: tuple[tuple[bytes, str, str], ...] = (
    (rb"#ROSBAG V1|#ROSRECORD", "a ROS bag of a version before 2.0", "convert it with `rosbag fix`"),
    (rb"\xd4\xc3\xb2\xa1|\xa1\xb2[\xc3\x3c][\xd4\x4d]|M\x3c\xb2\xa1|\n\r\r\n", "a network capture (pcap)", _TO_ROS),
    (rb".{0,64}(CSensoryFrame|CActionCollection|CObservation|mrpt::obs)", "an MRPT rawlog", ""),
    (rb"\x89HDF\r\n", "an HDF5 file", ""),
    (rb"PK\x03\x04", "a ZIP archive", "unpack it and name what is inside"),
    (rb"ULog\x01\x12\x35", "a PX4 log (ULog)", ""),
    (rb"\xa3\x95\x80", "an ArduPilot log", ""),
    (rb"\xed\xa1\xda\x01", "an LCM log", ""),
    (rb"RRF", "a Rerun recording", ""),
    (rb"# ?\.PCD|ply\r?\n|LASF", "a point cloud", ""),
    (rb"\s*(VERTEX|EDGE)_SE[23]\b", "a g2o pose graph", "it holds poses and no readings of sensors"),
    (rb"\s*(VERTEX|EDGE)[23]? ", "a TORO pose graph", "it holds poses and no readings of sensors"),
    (rb"(\xef\xbb\xbf)?#? ?timestamp( \[ns\]|, ?p_RS_R_x)", "a file of an EuRoC data set", _TRAJECTORY),
    (rb"(#[^\n]*\n|\s)*([-+.\deE]+[ \t,]+){11}[-+.\deE]+[ \t]*\r?\n", "a trajectory in KITTI's format", _TRAJECTORY),
    (rb"(#[^\n]*\n|\s)*([-+.\deE]+[ \t,]+){7}[-+.\deE]+[ \t]*\r?\n", "a trajectory in TUM's format", _TRAJECTORY),
)  # fmt: skip
_NAMED: Mapping[str, tuple[str, str]] = {
    ".rawlog": ("an MRPT rawlog", ""),
    ".g2o": ("a g2o pose graph", "it holds poses and no readings of sensors"),
    ".pcap": ("a network capture (pcap)", _TO_ROS),
    ".pcapng": ("a network capture (pcap)", _TO_ROS),
    ".tum": ("a trajectory in TUM's format", _TRAJECTORY),
    ".svo": ("a recording of a ZED camera", _TO_ROS),
    ".pcd": ("a point cloud", ""),
    ".ply": ("a point cloud", ""),
}
_CONVERT = "convert it to a bag or an MCAP"


def recording_format(path: Path) -> Format:
    """Return the format of the recording at `path`; a bag is known by its first bytes too, whatever its name.

    Raises:
        RecordingError: nothing is there, or it is none of the formats.
    """
    if not path.exists():
        raise RecordingError(f"There is no recording at {path}; check the path.")
    if path.is_dir():
        return _folder_format(path)
    start = _start(path)
    if start.startswith(ROS1_MAGIC):
        return "ros1"
    if start.startswith(MCAP_MAGIC):
        return "mcap"
    suffixes = [suffix.lower() for suffix in path.suffixes]
    packed = bool(suffixes) and suffixes[-1] in COMPRESSIONS
    suffix = (["", *suffixes[:-1]] if packed else ["", *suffixes])[-1]
    if start.startswith(_SQLITE_MAGIC) and suffix not in _NAMED:
        return "sqlite"
    other = _other_format(suffix, start)
    found = _SUFFIXES.get(suffix)
    if found is None or (other is not None and found != "carmen"):
        raise RecordingError(
            f"{path} is of no known format: {_ACCEPTED}."
            if other is None
            else f"{path} is {other[0]}, which is not read as a recording; {other[1] or _CONVERT}."
        )
    if not start and not packed:
        raise RecordingError(f"{path} is empty; record or copy it again.")
    if found == "carmen" and packed and COMPRESSIONS[suffixes[-1]] is None:
        raise RecordingError(f"{path} is a CARMEN log that is compressed by Zstandard; unpack it with `unzstd`.")
    return found


def _start(path: Path) -> bytes:
    """Return the first bytes of a file, of what is packed in it where it is compressed."""
    try:
        with path.open("rb") as file:
            start = file.read(400)
        opener = gzip.open if start.startswith(b"\x1f\x8b") else COMPRESSIONS.get(path.suffix.lower())
        if opener is not None and start:
            with opener(path, "rb") as file:
                start = file.read(400)
    except PermissionError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}.") from error
    except (OSError, EOFError, lzma.LZMAError):  # its reader says what is wrong
        return b""
    return start


def _other_format(suffix: str, start: bytes) -> tuple[str, str] | None:
    """Return what a file is that is no recording, and what to do with it, or None where that is not known."""
    if suffix in _NAMED:
        return _NAMED[suffix]
    return next(((name, advice) for pattern, name, advice in _BYTES if re.match(pattern, start, re.DOTALL)), None)


def bag_files(folder: Path) -> list[Path]:
    """Return the files of ROS 2 bags in a folder, by number; a compressed one only where its content is not there."""
    found = {
        file.stem if file.suffix in COMPRESSIONS else file.name: file
        for file in sorted(folder.glob("*"), key=lambda file: file.suffix not in COMPRESSIONS)
        if re.search(r"\.(db3|mcap)(\.[a-z0-9]+)?$", file.name) and file.suffix in (".db3", ".mcap", *COMPRESSIONS)
    }
    return [found[name] for name in sorted(found, key=lambda name: (len(name), name))]


def _folder_format(folder: Path) -> Format:
    if (folder / "metadata.yaml").is_file():
        return "ros2"
    if any(folder.glob("*_motors.txt")) and any(folder.glob("*_scan.txt")):
        return "brenner"
    if any((folder / name).is_dir() for name in ("mav0", "cam0", "imu0", "state_groundtruth_estimate0")):
        raise RecordingError(
            f"{folder} is a folder of an EuRoC data set, which is not read as a recording; {_CONVERT}. `longreach "
            "evaluate` reads its state_groundtruth_estimate0/data.csv."
        )
    if any((folder / name).is_dir() for name in ("oxts", "velodyne_points", "sequences")):
        raise RecordingError(
            f"{folder} is a folder of a KITTI data set, which is not read as a recording; {_CONVERT}. `longreach "
            "evaluate` reads its files of poses."
        )
    there = bag_files(folder)
    if len({re.sub(r"(_\d+)?\.(db3|mcap).*$", "", file.name) for file in there}) == 1:  # one bag's
        return "ros2"
    inside = [file.name for file in there] + sorted(file.name for file in folder.glob("*.bag"))
    if inside:
        raise RecordingError(f"{folder} has no metadata.yaml; name a file in it instead: {', '.join(inside)}.")
    raise RecordingError(f"{folder} is a folder without metadata.yaml: {_ACCEPTED}.")
