"""What a ROS bag holds, from the stamps alone: no message is decoded but for its header."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np

from longreach.io.bag_file import open_bag
from longreach.io.bag_topics import check_topics
from longreach.io.formats import recording_format
from longreach.io.recording_info import RecordingInfo, topic_info

_NAMES = {"ros1": "ROS 1 bag", "ros2": "ROS 2 bag", "sqlite": "ROS 2 bag", "mcap": "MCAP"}


def inspect(
    path: Path, *, topics: Mapping[str, str] | None = None, clock: Literal["header", "record"] = "header"
) -> RecordingInfo:
    """Count and time the messages of every topic, by the stamps of their headers where they have them.

    Start and duration are those of the recording itself.

    Arguments: topics: of sensors, which must be there. clock: record: the times of recording alone are looked at.
    """
    headers: dict[tuple[str, str], list[int | None]] = {}
    received: dict[tuple[str, str], list[int]] = {}
    with open_bag(path) as bag:
        check_topics(bag, topics or {})
        for name, type, receive_ns, header_ns in bag.stamps():
            headers.setdefault((name, type), []).append(header_ns)
            received.setdefault((name, type), []).append(receive_ns)
        start, end = bag.start_ns, bag.end_ns
    counted, remarks = [], list(bag.remarks)
    for (name, type), times in sorted(headers.items()):
        stamps = np.array([ns or 0 for ns in times])
        if clock == "record" or not stamps.any():
            stamps = np.array(received[name, type])
            if clock == "header" and None not in times:
                remarks.append(f"The messages of {name} have no stamps; the time of recording is taken.")
        counted.append(topic_info(name, type, stamps / 1e9))
    return RecordingInfo(
        _NAMES[recording_format(path)], start / 1e9, (end - start) / 1e9, tuple(counted), tuple(remarks)
    )
