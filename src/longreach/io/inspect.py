"""What a recording holds, whatever its format."""

from pathlib import Path

from longreach.io import bag_info, brenner, carmen
from longreach.io.formats import recording_format
from longreach.io.recording_info import RecordingInfo


def inspect_recording(path: Path) -> RecordingInfo:
    """Return a recording's topics with counts, rates and gaps.

    Raises:
        RecordingError: nothing is there, or it cannot be read.
    """
    kind = recording_format(path)
    if kind == "carmen":
        return carmen.inspect(path)
    if kind == "brenner":
        return brenner.inspect(path)
    return bag_info.inspect(path)
