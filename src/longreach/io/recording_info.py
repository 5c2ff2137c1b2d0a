"""What a recording holds, without reading more of it than the stamps."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class TopicInfo:
    """One topic, or one kind of line: rate [Hz], longest gap [s], and how many stamps are before the one before."""

    topic: str
    type: str
    count: int
    rate: float
    longest_gap: float
    backward_stamps: int


@dataclass(frozen=True)
class RecordingInfo:
    """A recording from `start` [s] on for `duration` [s]; remarks: a sentence each."""

    format: str
    start: float
    duration: float
    topics: tuple[TopicInfo, ...]
    remarks: tuple[str, ...] = ()


def topic_info(topic: str, type: str, stamps: Float[np.ndarray, " n"]) -> TopicInfo:
    """Count and time the messages of a topic from their stamps [s], in the order of the file."""
    steps = np.diff(np.sort(stamps))
    span = float(steps.sum())
    return TopicInfo(
        topic=topic,
        type=type,
        count=len(stamps),
        rate=len(steps) / span if span > 0 else 0.0,
        longest_gap=float(steps.max(initial=0.0)),
        backward_stamps=int(np.sum(np.diff(stamps) < 0)),
    )
