"""What a server says, into a bag, by a thread of its own: a loop never waits for a disk."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from threading import Thread

from longreach.io.bag_writer import BagWriter, new_bag
from longreach.live.protocol.topics import Topic


class Recorder:
    """Takes messages for a bag that is being written; made by `recording`."""

    def __init__(self) -> None:
        self._waiting: SimpleQueue[tuple[Topic, bytes, float] | None] = SimpleQueue()
        self.count = 0

    def write(self, topic: Topic, payload: bytes, stamp: float) -> None:
        """Put a message, as CDR, at a time of recording [s] on its way to the bag."""
        self._waiting.put((topic, payload, stamp))

    def end(self) -> None:
        """Let the thread end when all is written."""
        self._waiting.put(None)

    def run(self, bag: BagWriter) -> None:
        """Write what comes until the end."""
        while (item := self._waiting.get()) is not None:
            topic, payload, stamp = item
            bag.write_cdr(topic.name, topic.type, payload, stamp)
            self.count += 1


@contextmanager
def recording(path: Path | None) -> Iterator[Recorder | None]:
    """Yield what takes messages for a new bag, which is whole and in its place when the block has been left.

    Raises:
        RecordingError: it cannot be written there.
    """
    if path is None:
        yield None
        return
    recorder = Recorder()
    with new_bag(path) as bag:
        thread = Thread(target=recorder.run, args=(bag,), name="recorder", daemon=True)
        thread.start()
        try:
            yield recorder
        finally:
            recorder.end()
            thread.join()
