"""Record messages as they come: an MCAP that can be read up to its last chunk, whatever becomes of the process."""

import logging
import os
import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread

from longreach.errors import RecordingError
from longreach.io.bag_writer import BagWriter
from longreach.io.mcap_file import McapWriter

_FLUSH_EVERY = 0.1  # [s]
_WAITING = 20_000  # messages that the disk has not taken yet; about 20 s of a robot
_LOG = logging.getLogger("longreach.recorder")


def check_recording(path: Path) -> None:
    """Raise a RecordingError where what a robot says cannot be recorded under this name."""
    if path.suffix != ".mcap":
        raise RecordingError(f"Nothing can be recorded into {path}: end it with .mcap.")
    if path.is_dir():
        raise RecordingError(f"The folder {path} is there already; remove it or give another name.")


class Recorder:
    """Writes a new MCAP in a thread of its own: whoever gives it messages never waits for the disk.

    The file is in its place from the first messages on, and replaces another one only then. Its end is written when the
    recorder is closed. Where it cannot be written any more, `error` and the log say why, and it stays as it is; what it
    lacks they say once it is closed.

    ended: is called when the recorder is closed.

    Raises:
        RecordingError: nothing can be written there, or the path does not end with .mcap.
    """

    def __init__(self, path: Path) -> None:
        check_recording(path)
        self.path, self.error = path, ""
        self.ended: Callable[[], None] = lambda: None
        self._hidden = path.with_name(f".{path.stem}.{secrets.token_hex(4)}.mcap")  # before the first messages
        self._waiting: SimpleQueue[tuple[str, str, bytes, float] | None] = SimpleQueue()
        self._lost = 0
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = McapWriter(self._hidden)
            self._bag = BagWriter(self._file)
        except OSError as error:
            with suppress(OSError):  # where there is no folder there is no file
                self._hidden.unlink()
            raise RecordingError(f"{path} cannot be written: {error.strerror or error}.") from error
        self._thread = Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def write(self, topic: str, type: str, payload: bytes, stamp: float) -> None:
        """Record a message, as CDR, at a time of recording [s]."""
        if self.error:
            return
        if self._waiting.qsize() < _WAITING:
            self._waiting.put((topic, type, payload, stamp))
        else:
            self._lost += 1

    def _run(self) -> None:
        try:
            try:
                with self._file:
                    self._write_all()
            finally:
                if self._file.count:
                    self._put_in_place()
        except Exception as error:  # whatever it is, the robot goes on
            reason = error.strerror if isinstance(error, OSError) else error
            self.error = f"{self.path} cannot be written any more: {reason}. {self._kept()}"
            _LOG.error(self.error)
        if not self._file.count:
            self._hidden.unlink(missing_ok=True)
            self.error = self.error or "Nothing was recorded: no message has come."
        if self._lost:
            lost = f"{self.path} lacks {self._lost} messages that the disk was too slow for."
            self.error = f"{self.error} {lost}".strip()
            _LOG.warning(lost)

    def _kept(self) -> str:
        if not self._file.count:
            return "Nothing was recorded."
        where = f" in {self._hidden}" if self._hidden.exists() else ""
        return f"What was recorded before can be read{where}."

    def _write_all(self) -> None:
        """Write what comes until there is a None, and a chunk every while."""
        due = None
        while True:
            now = time.monotonic()
            if due is not None and now >= due:
                self._file.flush()
                self._put_in_place()
                due = None
            try:
                item = self._waiting.get(timeout=None if due is None else due - now)
            except Empty:
                continue
            if item is None:
                return
            self._bag.write_cdr(*item)
            due = now + _FLUSH_EVERY if due is None else due

    def _put_in_place(self) -> None:
        if self._hidden.exists():
            os.replace(self._hidden, self.path)

    def close(self) -> None:
        """Write the end of the recording; once is enough."""
        ended, self.ended = self.ended, lambda: None
        ended()
        self._waiting.put(None)
        self._thread.join()

    def __enter__(self) -> "Recorder":
        """Return the recorder."""
        return self

    def __exit__(self, *_: object) -> None:
        """Write the end of the recording."""
        self.close()
