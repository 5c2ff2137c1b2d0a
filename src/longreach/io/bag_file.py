"""A ROS bag of any kind as topics and messages; a broken file becomes one sentence.

Only the definitions of types that are asked for are read, so that a bag with messages nobody knows can be used.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from longreach.errors import LongreachError, RecordingError
from longreach.io.formats import recording_format
from longreach.io.mcap_file import CutMcap

_IDL = "=" * 80 + "\nIDL: "
_HEADER = "std_msgs/msg/Header"
_TELL_EVERY = 500  # messages


@dataclass(frozen=True)
class Topic:
    """A topic, its type as ROS 2 writes it (sensor_msgs/msg/Imu), and how many messages it has."""

    name: str
    type: str
    count: int


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn whatever a broken file does to rosbags into one sentence.

    Besides its own errors it lets those of struct, zstd, sqlite and of failed assertions through.
    """
    try:
        yield
    except LongreachError:
        raise
    except PermissionError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror}.") from error
    except Exception as error:
        reason = " ".join(str(error).split()).rstrip(".") or type(error).__name__
        raise RecordingError(
            f"{path} cannot be read as a ROS bag, it is damaged or cut short ({reason}); copy it again, or let "
            "ROS reindex it."
        ) from error


class BagFile:
    """An open bag. Stamps are in nanoseconds here, as in the file. remarks: a sentence each."""

    def __init__(self, path: Path, reader: Any, is_ros1: bool, remarks: tuple[str, ...] = ()) -> None:
        self.path, self.remarks = path, remarks
        self._reader = reader
        self._is_ros1 = is_ros1
        self.connections: list[Connection] = [c for c in reader.connections if c.msgcount]
        self.start_ns, self.end_ns = 0, 0
        if self.connections:
            self.start_ns, self.end_ns = int(reader.start_time), int(reader.end_time) - 1

    @property
    def topics(self) -> tuple[Topic, ...]:
        """Topics that have messages, by name; one with messages of two types is there twice."""
        counts: dict[tuple[str, str], int] = {}
        for c in self.connections:
            counts[c.topic, c.msgtype] = counts.get((c.topic, c.msgtype), 0) + c.msgcount
        return tuple(Topic(name, type, count) for (name, type), count in sorted(counts.items()))

    def raw_messages(self, topics: Collection[tuple[str, str]]) -> Iterator[tuple[str, str, int, bytes]]:
        """Yield name, type, time of recording and bytes of the messages of some (name, type), in that time's order."""
        wanted = [c for c in self.connections if (c.topic, c.msgtype) in topics]
        with _explained(self.path):
            if wanted:
                for connection, receive_ns, raw in self._reader.messages(connections=wanted):
                    yield connection.topic, connection.msgtype, receive_ns, raw

    def messages(self, topics: Collection[tuple[str, str]]) -> Iterator[tuple[str, str, int, Any]]:
        """Yield name, type, time of recording and message of some (name, type), in the order of that time."""
        with _explained(self.path):
            stores = {type: self._store_of(type) for name, type in topics}
            for name, type, receive_ns, raw in self.raw_messages(topics):
                store = stores[type]
                message = store.deserialize_ros1(raw, type) if self._is_ros1 else store.deserialize_cdr(raw, type)
                yield name, type, receive_ns, message

    def hand_out(
        self, taking: Mapping[tuple[str, str], Sequence[Callable[[Any, int], None]]], progress: Callable[[float], None]
    ) -> None:
        """Give each message and its time of recording [ns] to all who take its (name, type), in the order of time."""
        total = sum(topic.count for topic in self.topics if (topic.name, topic.type) in taking)
        for i, (name, type, receive_ns, message) in enumerate(self.messages(taking)):
            if i % _TELL_EVERY == 0:
                progress(i / total)
            for take in taking[name, type]:
                take(message, receive_ns)
        progress(1.0)

    def header_reader(self, type: str) -> Callable[[bytes], int] | None:
        """Return what finds the header's stamp in a message's bytes, or None where the type has no header."""
        try:
            fields = self._store_of(type).fielddefs[type][1]
        except Exception:  # a definition that cannot be read: then there is no telling
            return None
        if not fields or fields[0][1][1] != _HEADER:
            return None
        if self._is_ros1:  # after the header's sequence number
            return lambda raw: _time_ns(raw, 4, "little", signed=False)
        return lambda raw: _time_ns(raw, 4, "little" if raw[1] & 1 else "big", signed=True)  # after CDR's four bytes

    def _store_of(self, type: str) -> Any:
        return _store(next(c.msgdef for c in self.connections if c.msgtype == type), type)


@lru_cache(maxsize=64)  # rosbags makes code for a type when it is first used, which takes longer than a small bag
def _store(definition: MessageDefinition, type: str) -> Any:
    """Return a type store for one type: from the bag's own definition, else (before ROS 2 Iron) from Humble's."""
    if definition.format == MessageDefinitionFormat.NONE:
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.EMPTY)
    if definition.format == MessageDefinitionFormat.MSG:
        store.register(get_types_from_msg(definition.data, type))
        return store
    text = definition.data
    parts = [part.partition("\n")[2] for part in text.split(_IDL)[1:]] if text.startswith(_IDL) else [text]
    for part in parts:
        store.register(get_types_from_idl(part))
    return store


def _time_ns(raw: bytes, at: int, order: Any, *, signed: bool) -> int:
    seconds = int.from_bytes(raw[at : at + 4], order, signed=signed)
    return seconds * 10**9 + int.from_bytes(raw[at + 4 : at + 8], order)


def _opened(path: Path, kind: str) -> tuple[Any, tuple[str, ...]]:
    """Return an open reader, and remarks."""
    if kind == "mcap":  # by its bytes; Ros2Reader goes by the name
        reader = _McapFile(path)
        try:
            reader.open()
        except Exception:  # its end is missing or damaged
            with suppress(ValueError):
                cut = CutMcap(path)
                return cut, (cut.remark,)
            raise
        return reader, ()
    reader = Ros1Reader(path) if kind == "ros1" else Ros2Reader(path)
    reader.open()
    return reader, ()


class _McapFile(Ros2Reader):
    """An .mcap file whatever its suffix."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.is_open = False
        self.storage = self.STORAGE_PLUGINS[".mcap"](path)


@contextmanager
def open_bag(path: Path) -> Iterator[BagFile]:
    """Open a ROS 1 bag, a ROS 2 folder or an .mcap file, of which the end may be missing.

    Raises:
        RecordingError: it is no bag, or damaged.
    """
    kind = recording_format(path)
    if kind not in ("ros1", "ros2", "mcap"):
        raise RecordingError(f"{path} is no ROS bag.")
    with _explained(path):
        reader, remarks = _opened(path, kind)
    try:
        with _explained(path):
            bag = BagFile(path, reader, kind == "ros1", remarks)
        yield bag
    finally:
        with suppress(Exception):
            reader.close()
