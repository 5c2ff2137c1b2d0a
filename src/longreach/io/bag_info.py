"""What a ROS bag holds, from the stamps alone: no message is decoded but for its header."""

from pathlib import Path

import numpy as np

from longreach.io.bag_file import open_bag
from longreach.io.formats import recording_format
from longreach.io.recording_info import RecordingInfo, topic_info

_NAMES = {"ros1": "ROS 1 bag", "ros2": "ROS 2 bag", "mcap": "MCAP"}


def inspect(path: Path) -> RecordingInfo:
    """Count and time the messages of every topic, by the stamps of their headers where they have them.

    Start and duration are those of the recording itself.
    """
    with open_bag(path) as bag:
        keys = [(topic.name, topic.type) for topic in bag.topics]
        header_of = {type: bag.header_reader(type) for _, type in keys}
        headers: dict[tuple[str, str], list[int]] = {key: [] for key in keys}
        received: dict[tuple[str, str], list[int]] = {key: [] for key in keys}
        for name, type, receive_ns, raw in bag.raw_messages(keys):
            read = header_of[type]
            headers[name, type].append(0 if read is None else read(raw))
            received[name, type].append(receive_ns)
        start, end = bag.start_ns, bag.end_ns
    topics, remarks = [], list(bag.remarks)
    for name, type in keys:
        stamps = np.array(headers[name, type])
        if not stamps.any():
            stamps = np.array(received[name, type])
            if header_of[type] is not None:
                remarks.append(f"The messages of {name} have no stamps; the time of recording is taken.")
        topics.append(topic_info(name, type, stamps / 1e9))
    return RecordingInfo(
        _NAMES[recording_format(path)], start / 1e9, (end - start) / 1e9, tuple(topics), tuple(remarks)
    )
