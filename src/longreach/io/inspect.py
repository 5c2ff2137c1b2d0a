"""What a recording holds, whatever its format."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from longreach.errors import RecordingError
from longreach.io import bag_info, brenner, carmen
from longreach.io.formats import recording_format
from longreach.io.recording_info import RecordingInfo


def inspect_recording(
    path: Path, *, topics: Mapping[str, str] | None = None, clock: Literal["header", "record"] = "header"
) -> RecordingInfo:
    """Return a recording's topics with counts, rates and gaps.

    Arguments: topics: of sensors, as {"lidar": "/scan"}, which must be there and of the right type. clock: what stamps
    the messages of a bag: their headers where they have them, or the times of recording.

    Raises:
        RecordingError: nothing is there, or it cannot be read.
    """
    kind = recording_format(path)
    if kind in ("carmen", "brenner") and (topics or clock != "header"):
        raise RecordingError(f"{path} has neither topics nor times of recording; --topic and --clock are for bags.")
    if kind == "carmen":
        return carmen.inspect(path)
    if kind == "brenner":
        return brenner.inspect(path)
    return bag_info.inspect(path, topics=topics or {}, clock=clock)
