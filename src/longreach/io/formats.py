"""Which format a recording has, told from its name and first bytes."""

from pathlib import Path
from typing import Literal

from longreach.errors import RecordingError

Format = Literal["ros1", "ros2", "mcap", "carmen", "brenner"]

ROS1_MAGIC = b"#ROSBAG V"
MCAP_MAGIC = b"\x89MCAP0\r\n"
_SUFFIXES: dict[str, Format] = {".bag": "ros1", ".mcap": "mcap", ".clf": "carmen", ".log": "carmen"}
_ACCEPTED = (
    "a recording is a ROS 1 .bag, a ROS 2 folder with its metadata.yaml, an .mcap, a CARMEN .clf or .log "
    "(also .gz, .bz2), or a folder with *_motors.txt and *_scan.txt"
)


def recording_format(path: Path) -> Format:
    """Return the format of the recording at `path`; a bag is known by its first bytes too, whatever its name.

    Raises:
        RecordingError: nothing is there, or it is none of the formats.
    """
    if not path.exists():
        raise RecordingError(f"There is no recording at {path}; check the path.")
    if path.is_dir():
        return _folder_format(path)
    try:
        with path.open("rb") as file:
            start = file.read(max(len(ROS1_MAGIC), len(MCAP_MAGIC)))
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.") from error
    if start.startswith(ROS1_MAGIC):
        return "ros1"
    if start.startswith(MCAP_MAGIC):
        return "mcap"
    suffixes = [suffix.lower() for suffix in path.suffixes]
    if suffixes and suffixes[-1] in (".gz", ".bz2"):
        found = _SUFFIXES.get(suffixes[-2]) if len(suffixes) > 1 else None
        found = found if found == "carmen" else None
    else:
        found = _SUFFIXES.get(suffixes[-1]) if suffixes else None
    if found is None:
        raise RecordingError(f"{path} is of no known format: {_ACCEPTED}.")
    if not start:
        raise RecordingError(f"{path} is empty; record or copy it again.")
    return found


def _folder_format(folder: Path) -> Format:
    if (folder / "metadata.yaml").is_file():
        return "ros2"
    if any(folder.glob("*_motors.txt")) and any(folder.glob("*_scan.txt")):
        return "brenner"
    inside = sorted(p.name for p in folder.iterdir() if p.suffix in (".bag", ".db3", ".mcap"))
    if any(name.endswith(".db3") for name in inside):
        raise RecordingError(f"{folder} has no metadata.yaml beside {inside[0]}; make it with `ros2 bag reindex`.")
    if inside:
        raise RecordingError(f"{folder} has no metadata.yaml; name a file in it instead: {', '.join(inside)}.")
    raise RecordingError(f"{folder} is a folder without metadata.yaml: {_ACCEPTED}.")
