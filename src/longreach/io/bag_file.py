"""A ROS bag of any kind as topics and messages; a broken file becomes one sentence.

A bag of ROS 2 is the files in a folder: its metadata.yaml is needed for their names alone, so one that is missing, or
that says too little, loses nothing. A file may be compressed as a whole.

Only the definitions of types that are asked for are read, so that a bag with messages nobody knows can be used.
"""

import heapq
import io
import re
import shutil
import struct
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
from rosbags.rosbag1 import reader as ros1
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from longreach.errors import LongreachError, RecordingError
from longreach.io.formats import COMPRESSIONS, ZSTD_MAGIC, bag_files, recording_format
from longreach.io.mcap_file import McapReader

_IDL = "=" * 80 + "\nIDL: "
_HEADER = "std_msgs/msg/Header"
_TELL_EVERY = 500  # messages
_LARGEST = 1 << 28  # [bytes] of a chunk that does not say how large it is


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
        """A sentence each; what is damaged may be found only when it is read."""
        return (*self._remarks, *(said for reader in self._readers for said in getattr(reader, "remarks", ())))

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
    """Open a ROS 1 bag, a folder or a file of ROS 2, or an .mcap file; of a bag or an .mcap the end may be missing.

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
        reader = times = McapReader(path)
    elif kind == "ros1":
        reader = times = _opened_ros1(path)
    else:
        reader = Sqlite3Reader(path)
        reader.open()
        times = reader.metadata
    stack.callback(_close, reader)
    return _File(reader, times.start_time, times.end_time)


class _UnindexedRos1Reader(Ros1Reader):
    """A bag of ROS 1 whose index is missing or damaged: what is whole in its chunks. remarks: a sentence each.

    Source: wiki.ros.org/Bags/Format/2.0.
    """

    def open(self) -> None:
        """Find the chunks one after the other.

        Raises:
            ReaderError: there is none.
        """
        self.bio = self.path.open("rb")
        self.bio.readline()
        found: dict[int, Connection] = {}
        damaged = 0
        with suppress(ros1.ReaderError):  # the end, or what is no record
            while True:
                at = self.bio.tell()
                if ros1.Header.read(self.bio).get_uint8("op") != ros1.RecordType.CHUNK:
                    ros1.read_bytes(self.bio, ros1.read_uint32(self.bio))
                    continue
                self.bio.seek(at)
                chunk = self.read_chunk()
                self.bio.seek(chunk.datapos)
                packed = self.bio.read(chunk.datasize or _LARGEST)  # the size is written last, thus 0 in one begun
                is_cut = chunk.datasize != len(packed)
                try:
                    data = chunk.decompressor(packed)
                    taken = self._take(at, data, found)
                    if chunk.datasize == 0 and len(data) == len(packed):  # it is not packed, and ends where it is whole
                        packed = packed[:taken]
                        self.bio.seek(chunk.datapos + taken)
                    self.chunks[at] = chunk._replace(datasize=len(packed))
                except Exception:  # whatever the decompressors, struct or Unicode say of it
                    damaged += not is_cut
        if not self.chunk_infos:
            self.close()
            raise ros1.ReaderError("no message in it is whole")
        self.indexes = {id: sorted(entries) for id, entries in self.indexes.items()}
        self.connections = [c._replace(msgcount=len(self.indexes.get(c.id, ()))) for c in found.values()]
        start, end = 1e-9 * self.start_time, 1e-9 * (self.end_time - 1)
        self.remarks = (
            f"The bag has no whole index, as if its recording was cut off: the {end - start:.1f} s up to its last "
            f"whole message, at {end:.3f}, are read"
            f"{f'; {damaged} damaged chunks are left out' if damaged else ''}.",
        )

    def _take(self, at: int, data: bytes, found: dict[int, Connection]) -> int:
        """Take note of what is in the chunk at a place of the file; return how many bytes of it are whole records."""
        file, self.bio = self.bio, io.BytesIO(data)
        known, entries, offset = {}, [], 0
        with suppress(ros1.ReaderError):  # a record that is cut
            while (offset := self.bio.tell()) < len(data):
                header = ros1.Header.read(self.bio)
                if header.get_uint8("op") == ros1.RecordType.CONNECTION:
                    self.bio.seek(offset)
                    connection = self.read_connection()
                    known[connection.id] = connection
                    continue
                entry = ros1.IndexData(header.get_time("time"), at, offset)
                ros1.read_bytes(self.bio, ros1.read_uint32(self.bio))
                entries.append((header.get_uint32("conn"), entry))
        self.bio = file
        found.update(known)
        entries = [(id, entry) for id, entry in entries if id in found]  # else a damaged chunk has what they are
        for id, entry in entries:
            self.indexes.setdefault(id, []).append(entry)
        if entries:
            times = [entry.time for _, entry in entries]
            self.chunk_infos.append(ros1.ChunkInfo(at, min(times), max(times) + 1, {}))
        return offset


def _opened_ros1(path: Path) -> Ros1Reader:
    """Open a bag by its index, else by its chunks."""
    reader: Ros1Reader = Ros1Reader(path)
    try:
        reader.open()
    except (ros1.ReaderError, AssertionError, struct.error) as error:
        if "version" in str(error) or "encryption" in str(error):  # not for want of an index
            raise
        reader = _UnindexedRos1Reader(path)
        reader.open()
    return reader


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
