"""A ROS bag of any kind as topics and messages; a broken file becomes one sentence.

A bag of ROS 2 is the files in a folder: its metadata.yaml is needed for their names alone, so one that is missing, or
that says too little, loses nothing. A file may be compressed as a whole.

Only the definitions of types that are asked for are read, so that a bag with messages nobody knows can be used.
"""

import heapq
import re
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import yaml
from rosbags.interfaces import Connection, ConnectionExtRosbag1, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from longreach.errors import LongreachError, RecordingError
from longreach.io.formats import COMPRESSIONS, ZSTD_MAGIC, bag_files, recording_format
from longreach.io.mcap_file import McapReader

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


class _File(NamedTuple):
    """An open file of a bag, and the times of its first message and behind its last one [ns]."""

    reader: Any
    start_ns: int
    end_ns: int


class BagFile:
    """An open bag. Stamps are in nanoseconds here, as in the file."""

    def __init__(self, path: Path, files: Sequence[_File], remarks: tuple[str, ...] = ()) -> None:
        self.path, self._remarks = path, remarks
        self._readers = [file.reader for file in files]
        self.connections: list[Connection] = [c for reader in self._readers for c in reader.connections if c.msgcount]
        self.start_ns, self.end_ns = 0, 0
        if self.connections:
            self.start_ns = int(min(file.start_ns for file in files))
            self.end_ns = int(max(file.end_ns for file in files)) - 1

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is wrong with the file, as far as it was read, a sentence each."""
        return (*self._remarks, *(remark for reader in self._readers for remark in getattr(reader, "remarks", ())))

    @property
    def topics(self) -> tuple[Topic, ...]:
        """Topics that have messages, by name; one with messages of two types is there twice."""
        counts: dict[tuple[str, str], int] = {}
        for c in self.connections:
            counts[c.topic, c.msgtype] = counts.get((c.topic, c.msgtype), 0) + c.msgcount
        return tuple(Topic(name, type, count) for (name, type), count in sorted(counts.items()))

    def raw_messages(self, topics: Collection[tuple[str, str]]) -> Iterator[tuple[str, str, int, bytes]]:
        """Yield name, type, time of recording and bytes of the messages of some (name, type), in that time's order."""
        for connection, receive_ns, raw in self._raw(topics):
            yield connection.topic, connection.msgtype, receive_ns, raw

    def stamps(self) -> Iterator[tuple[str, str, int, int | None]]:
        """Yield name, type, time of recording and the header's stamp of all messages; None where types have no header.

        No message is decoded.
        """
        read: dict[tuple[str, str, bool], Callable[[bytes], int] | None] = {}
        for c, receive_ns, raw in self._raw({(topic.name, topic.type) for topic in self.topics}):
            key = (c.topic, c.msgtype, _is_ros1(c))
            if key not in read:
                read[key] = self._header_reader(c)
            header = read[key]
            yield c.topic, c.msgtype, receive_ns, header and header(raw)

    def _raw(self, topics: Collection[tuple[str, str]]) -> Iterator[tuple[Connection, int, bytes]]:
        wanted = [c for c in self.connections if (c.topic, c.msgtype) in topics]
        with _explained(self.path):
            by_file = [(reader, [c for c in wanted if c.owner is reader]) for reader in self._readers]
            streams = [reader.messages(connections=known) for reader, known in by_file if known]
            for connection, receive_ns, raw in heapq.merge(*streams, key=lambda message: message[1]):
                yield connection, receive_ns, _uncompressed(raw)

    def messages(self, topics: Collection[tuple[str, str]]) -> Iterator[tuple[str, str, int, Any]]:
        """Yield name, type, time of recording and message of some (name, type), in the order of that time."""
        with _explained(self.path):
            wanted = [c for c in self.connections if (c.topic, c.msgtype) in topics]
            stores = {(c.msgdef, c.msgtype): self._store_of(c) for c in wanted}
            for c, receive_ns, raw in self._raw(topics):
                store = stores[c.msgdef, c.msgtype]
                read = store.deserialize_ros1 if _is_ros1(c) else store.deserialize_cdr
                yield c.topic, c.msgtype, receive_ns, read(raw, c.msgtype)

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

    def _header_reader(self, connection: Connection) -> Callable[[bytes], int] | None:
        """Return what finds the header's stamp in a message's bytes, or None where its type has no header."""
        type = connection.msgtype
        try:
            fields = self._store_of(connection).fielddefs[type][1]
        except Exception:  # a definition that cannot be read: then there is no telling
            return None
        if not fields or fields[0][1][1] != _HEADER:
            return None
        if _is_ros1(connection):  # after the header's sequence number
            return lambda raw: _time_ns(raw, 4, "little", signed=False)
        return lambda raw: _time_ns(raw, 4, "little" if raw[1] & 1 else "big", signed=True)  # after CDR's four bytes

    def _store_of(self, connection: Connection) -> Any:
        """Return the types for a connection; a file of a bag may lack a definition that another one has."""
        definition, none = connection.msgdef, MessageDefinitionFormat.NONE
        if definition.format == none:
            same = (c.msgdef for c in self.connections if c.msgtype == connection.msgtype)
            definition = next((other for other in same if other.format != none), definition)
        return _store(definition, connection.msgtype)


def _is_ros1(connection: Connection) -> bool:
    about = connection.ext
    return isinstance(about, ConnectionExtRosbag1) or about.serialization_format == "ros1"


def _uncompressed(raw: bytes) -> bytes:
    """Return a message of a bag that compresses each one; no message of ROS 2 begins as Zstandard does."""
    return DECOMPRESSORS["zstd"](raw, 0) if raw[:4] == ZSTD_MAGIC else raw


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


@contextmanager
def open_bag(path: Path) -> Iterator[BagFile]:
    """Open a ROS 1 bag, a folder or a file of ROS 2, or an .mcap file, of which the end may be missing.

    Raises:
        RecordingError: it is no bag, or damaged.
    """
    kind = recording_format(path)
    if kind not in ("ros1", "ros2", "sqlite", "mcap"):
        raise RecordingError(f"{path} is no ROS bag.")
    paths, remarks = _files(path) if kind == "ros2" else ([path], _beside(path))
    with ExitStack() as stack:
        with _explained(path):
            files = [_opened(file, stack) for file in paths]
            bag = BagFile(path, files, tuple(remarks))
        yield bag


def _opened(path: Path, stack: ExitStack) -> _File:
    """Return an open file, which is known by its bytes, whatever its name."""
    kind = recording_format(path)
    if (suffix := path.suffix.lower()) in COMPRESSIONS:
        path = _unpacked(path, suffix, Path(stack.enter_context(TemporaryDirectory())))
    if kind == "mcap":
        reader = McapReader(path)
        times = reader
    else:
        reader = Ros1Reader(path) if kind == "ros1" else Sqlite3Reader(path)
        reader.open()
        times = reader if isinstance(reader, Ros1Reader) else reader.metadata
    stack.callback(_close, reader)
    return _File(reader, times.start_time, times.end_time)


def _close(reader: Any) -> None:
    with suppress(Exception):
        reader.close()


def _unpacked(path: Path, suffix: str, folder: Path) -> Path:
    unpacked = folder / path.stem
    if (opener := COMPRESSIONS[suffix]) is None:  # Zstandard, of which rosbags has no stream
        unpacked.write_bytes(DECOMPRESSORS["zstd"](path.read_bytes(), 0))
        return unpacked
    with opener(path, "rb") as packed, unpacked.open("wb") as file:
        shutil.copyfileobj(packed, file)
    return unpacked


def _files(folder: Path) -> tuple[list[Path], list[str]]:
    """Return the files of a bag of ROS 2, and remarks."""
    named, there = _named_files(folder), bag_files(folder)
    if named is None:
        if not there:
            raise RecordingError(f"{folder} cannot be read as a ROS bag: it holds neither a .db3 nor an .mcap.")
        names = ", ".join(file.name for file in there)
        return there, [f"{folder.name} has no metadata.yaml that says which its files are; {names} were read."]
    found = {file.name: file for file in there} | {file.stem: file for file in there if file.suffix in COMPRESSIONS}
    missing = [name for name in named if name not in found and not (folder / name).is_file()]
    if missing or not named:
        raise RecordingError(
            f"{folder} lacks {', '.join(missing) or 'any file'} of those that its metadata.yaml names; copy it again, "
            "or name a file in it."
        )
    return [found.get(name, folder / name) for name in named], []


def _named_files(folder: Path) -> list[str] | None:
    """Return the names that stand in a folder's metadata, or None where that is missing or nonsense."""
    try:
        about = yaml.safe_load((folder / "metadata.yaml").read_text(encoding="utf-8"))
        return [Path(name).name for name in about["rosbag2_bagfile_information"]["relative_file_paths"]]
    except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError):
        return None


def _beside(path: Path) -> list[str]:
    """Return remarks on what belongs to a bag's file and is not read with it."""
    remarks = []
    part = re.compile(re.escape(re.sub(r"_\d+$", "", path.name.partition(".")[0])) + r"_\d+\.")
    parts = [file for file in bag_files(path.parent) if part.match(file.name)]
    if len(parts) > 1 and path in parts:
        remarks.append(f"{path.name} is one of {len(parts)} files of a bag; name its folder to read all of them.")
    log = path.with_name(f"{path.name}-wal")
    if log.is_file() and log.stat().st_size:
        remarks.append(
            f"{log.name} holds messages that are not read, for the recorder was killed; open {path.name} with sqlite3 "
            "once, which takes them in."
        )
    return remarks
