"""MCAP files: written in chunks that can each be read alone, and read where their end is missing or damaged.

What its topics are stands before the chunks: a damaged chunk takes no topic with it.

Source: https://mcap.dev/spec. rosbags reads whole files of the profile ros2 alone, so they are read here too.
"""

import heapq
import os
import struct
import tempfile
import zlib
from collections.abc import Collection, Iterator
from functools import partial
from io import FileIO
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
    Qos,
)
from rosbags.rosbag2.metadata import dump_qos_v8
from rosbags.rosbag2.storage_mcap import DECOMPRESSORS
from rosbags.typesys.msg import normalize_msgtype

from longreach.errors import RecordingError
from longreach.io.formats import MCAP_MAGIC

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(1, 9)
_STATISTICS, _SUMMARY_OFFSET, _DATA_END = 0x0B, 0x0E, 0x0F
_RECORD = struct.Struct("<BQ")  # opcode and length
_STAMPED = struct.Struct("<HIQQ")  # channel, number, time of recording, time of publication [ns]
_CHUNK_HEAD = struct.Struct("<QQQI")  # first and last time [ns], size and CRC before compression
_LARGEST_CHUNK = 1 << 20  # [bytes]
_FOOTER_SIZE = 9 + 20  # [bytes]
_DEFINITIONS = {  # by the encodings of messages and of their definitions
    ("cdr", "ros2msg"): MessageDefinitionFormat.MSG,
    ("cdr", "ros2idl"): MessageDefinitionFormat.IDL,
    ("cdr", "omgidl"): MessageDefinitionFormat.IDL,
    ("cdr", ""): MessageDefinitionFormat.NONE,
    ("ros1", "ros1msg"): MessageDefinitionFormat.MSG,
}


def _record(opcode: int, *parts: bytes | bytearray | memoryview) -> bytes:
    body = b"".join(parts)
    return _RECORD.pack(opcode, len(body)) + body


def _sized(data: bytes) -> bytes:
    return len(data).to_bytes(4, "little") + data


class McapWriter:
    """A new MCAP of ROS 2 messages; with the block that it opens it gets its end, unless that raises.

    All that was flushed can be read, whatever becomes of the process, and memory does not grow with the file.
    """

    def __init__(self, path: Path) -> None:
        self._chunk_indices = tempfile.TemporaryFile(dir=path.parent)  # noqa: SIM115
        self._file = FileIO(path, "x")
        self._size = self._chunks = 0
        self._schemas: dict[str, bytes] = {}  # the records, by the names of types
        self._channels: list[bytes] = []
        self._counts: list[int] = []
        self._first, self._last = 2**63 - 1, 0
        self._new = b""  # of these, what is not in the file yet: it stands before a chunk, which may be damaged
        self._clear()
        try:
            self._append(MCAP_MAGIC + _record(_HEADER, _sized(b"ros2"), _sized(b"longreach")))
        except OSError:
            self._file.close()
            self._chunk_indices.close()
            raise

    def _clear(self) -> None:
        self._records = bytearray()
        self._messages: dict[int, list[tuple[int, int]]] = {}  # channel → time [ns] and offset in the chunk

    @property
    def count(self) -> int:
        """How many messages were flushed."""
        return sum(self._counts)

    def add_connection(self, topic: str, type: str, *, typestore: Any, offered_qos_profiles: Collection[Qos]) -> int:
        """Return the channel for messages of a type on a topic."""
        if type not in self._schemas:
            definition, _ = typestore.generate_msgdef(type, ros_version=2)
            number = (len(self._schemas) + 1).to_bytes(2, "little")
            texts = (type, "ros2msg", definition)
            self._schemas[type] = _record(_SCHEMA, number, *(_sized(text.encode()) for text in texts))
            self._new += self._schemas[type]
        channel, schema = len(self._channels) + 1, list(self._schemas).index(type) + 1
        qos = _sized(b"offered_qos_profiles") + _sized(dump_qos_v8(list(offered_qos_profiles)).encode())
        start = struct.pack("<HH", channel, schema)
        self._channels.append(_record(_CHANNEL, start, _sized(topic.encode()), _sized(b"cdr"), _sized(qos)))
        self._counts.append(0)
        self._new += self._channels[-1]
        return channel

    def write(self, channel: int, stamp_ns: int, payload: bytes | memoryview) -> None:
        """Put a message into the chunk that is being filled."""
        self._messages.setdefault(channel, []).append((stamp_ns, len(self._records)))
        self._records += _record(_MESSAGE, _STAMPED.pack(channel, 0, stamp_ns, stamp_ns), payload)
        if len(self._records) > _LARGEST_CHUNK:
            self.flush()

    def flush(self) -> None:
        """Write the chunk, so that its messages are safe.

        Raises:
            OSError: that is not possible; the file then ends with the chunk before.
        """
        if not self._messages:
            return
        stamps = [stamp for messages in self._messages.values() for stamp, _ in messages]
        first, last, size = min(stamps), max(stamps), len(self._records)
        head = _CHUNK_HEAD.pack(first, last, size, zlib.crc32(self._records))
        chunk = _record(_CHUNK, head, _sized(b""), size.to_bytes(8, "little"), self._records)
        indices, offsets, start = b"", b"", self._size + len(self._new)
        for channel, messages in self._messages.items():
            offsets += struct.pack("<HQ", channel, start + len(chunk) + len(indices))
            rows = b"".join(struct.pack("<QQ", *message) for message in messages)
            indices += _record(_MESSAGE_INDEX, channel.to_bytes(2, "little"), _sized(rows))
        about = struct.pack("<QQQQ", first, last, start, len(chunk)) + _sized(offsets)
        about += struct.pack("<Q", len(indices)) + _sized(b"") + struct.pack("<QQ", size, size)
        self._append(self._new + chunk + indices)
        self._new = b""
        self._chunk_indices.write(_record(_CHUNK_INDEX, about))
        self._chunks += 1
        for channel, messages in self._messages.items():
            self._counts[channel - 1] += len(messages)
        self._first, self._last = min(self._first, first), max(self._last, last)
        self._clear()

    def _append(self, data: bytes) -> None:
        """Write all of some data, or nothing."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError:
            self._file.truncate(self._size)
            self._file.seek(self._size)
            raise
        self._size += len(data)

    def _finish(self) -> None:
        """Write the summary, by which a reader finds each message at once."""
        self.flush()
        self._append(self._new + _record(_DATA_END, bytes(4)))
        numbers = (self.count, len(self._schemas), len(self._channels), 0, 0, self._chunks)
        times = (self._first, self._last) if self._chunks else (0, 0)
        counts = b"".join(struct.pack("<HQ", i + 1, count) for i, count in enumerate(self._counts))
        self._chunk_indices.seek(0)
        summary = {
            _SCHEMA: self._schemas.values(),
            _CHANNEL: self._channels,
            _CHUNK_INDEX: iter(partial(self._chunk_indices.read, 1 << 16), b""),
            _STATISTICS: [_record(_STATISTICS, struct.pack("<QHIIIIQQ", *numbers, *times), _sized(counts))],
        }
        start, offsets = self._size, b""
        for opcode, parts in summary.items():
            before = self._size
            for part in parts:
                self._append(part)
            offsets += _record(_SUMMARY_OFFSET, struct.pack("<BQQ", opcode, before, self._size - before))
        footer = _record(_FOOTER, struct.pack("<QQI", start, self._size, 0))
        self._append(offsets + footer + MCAP_MAGIC)

    def __enter__(self) -> "McapWriter":
        """Return the writer."""
        return self

    def __exit__(self, failed: object, *_: object) -> None:
        """Give the file its end, unless the block has failed."""
        with self._file, self._chunk_indices:
            if failed is None:
                self._finish()


class _Part(NamedTuple):
    """A chunk, or a message outside of chunks: its first time [ns], its opcode, and where it is in the file.

    channels: those with messages in it, where an index says so.
    """

    first_ns: int
    opcode: int
    start: int
    length: int
    channels: frozenset[int] = frozenset()


class McapReader:
    """An MCAP of ROS messages, as rosbags' readers are used: by its index, or all whole chunks where it has none.

    Each channel's own encodings count, whatever the header's profile is: messages of ROS 1 and ROS 2 are read, others
    are left out. remarks: a sentence each.

    Raises:
        ValueError: there is no whole chunk.
        RecordingError: none of its messages is of ROS.
    """

    def __init__(self, path: Path) -> None:
        self.remarks: list[str] = []
        self._damaged: set[int] = set()  # where chunks start that cannot be read
        self._file = path.open("rb")
        try:
            self._size = os.fstat(self._file.fileno()).st_size
            if self._file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
                raise ValueError("it does not begin as an MCAP")
            if not self._read_summary():
                self._scan()
            self.connections = self._connections(path)
        except BaseException:
            self.close()
            raise

    def _clear(self) -> None:
        self._schemas: dict[int, tuple[str, str, str]] = {}  # name, encoding, definition
        self._channels: dict[int, tuple[int, str, str]] = {}  # schema, topic, encoding
        self._counts: dict[int, int] = {}
        self._parts: list[_Part] = []
        self.start_time, self.end_time = 2**63 - 1, 0  # [ns]; the end is not within, as rosbags has it

    def _read_summary(self) -> bool:
        """Take note of what the index at the end of the file says; return whether it says all that is needed."""
        self._clear()
        chunks = -1
        try:
            end = self._size - _FOOTER_SIZE - len(MCAP_MAGIC)
            self._file.seek(end)
            opcode, length, start = struct.unpack("<BQQ", self._file.read(17))
            self._file.seek(-len(MCAP_MAGIC), os.SEEK_END)
            self._is_whole = (opcode, length) == (_FOOTER, 20) and self._file.read() == MCAP_MAGIC
            if not self._is_whole or not 0 < start < end:
                return False
            self._file.seek(start)
            for opcode, body in _split(self._file.read(end - start)):
                if opcode in (_SCHEMA, _CHANNEL):
                    self._define(opcode, body)
                elif opcode == _CHUNK_INDEX:
                    first, _, at, length, size = struct.unpack_from("<QQQQI", body)
                    channels = frozenset(channel for channel, _ in struct.iter_unpack("<HQ", body[36 : 36 + size]))
                    self._parts.append(_Part(first, _CHUNK, at + _RECORD.size, length - _RECORD.size, channels))
                elif opcode == _STATISTICS:
                    *_, chunks, first, last = struct.unpack_from("<QHIIIIQQ", body)
                    self.start_time, self.end_time = first, last + 1
                    self._counts = {channel: count for channel, count in struct.iter_unpack("<HQ", body[46:]) if count}
        except (OSError, ValueError, struct.error):
            self._is_whole = False
            return False
        known = all(channel in self._channels and self._has_schema(channel) for channel in self._counts)
        return known and chunks == len(self._parts) and (chunks > 0) == bool(self._counts)

    def _scan(self) -> None:
        """Find all parts that are whole."""
        self._clear()
        at, taken = len(MCAP_MAGIC), (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK)
        while at + _RECORD.size <= self._size:
            self._file.seek(at)
            opcode, length = _RECORD.unpack(self._file.read(_RECORD.size))
            start, at = at + _RECORD.size, at + _RECORD.size + length
            if opcode in (0, _FOOTER, _DATA_END) or at > self._size:
                break  # 0: blocks of the disk that nothing was written to
            if opcode in taken:
                try:
                    self._take(_Part(0, opcode, start, length))
                except Exception:  # whatever the decompressors, struct or Unicode say of it
                    self._leave_out(_Part(0, opcode, start, length))
        if not self._parts and not self._is_whole:
            raise ValueError("no whole chunk is in it")
        if not self._is_whole:
            end = self.end_time - 1
            self.remarks.append(
                f"The recording was cut off, its file has no end: the {1e-9 * (end - self.start_time):.1f} s up to its "
                f"last whole chunk, which ends at {1e-9 * end:.3f}, are read."
            )

    def _leave_out(self, part: _Part) -> None:
        """Say once that a part is damaged, and how much is lost as far as the index behind it says."""
        if part.start in self._damaged:
            return
        self._damaged.add(part.start)
        at, count = part.start + part.length, 0
        while part.opcode == _CHUNK and at + _RECORD.size < self._size:
            self._file.seek(at)
            opcode, length = _RECORD.unpack(self._file.read(_RECORD.size))
            if opcode != _MESSAGE_INDEX or length < 6:
                break
            count, at = count + (length - 6) // 16, at + _RECORD.size + length
        lost = f"the {count} messages in it were" if count else "what is in it was"
        where = f"{part.length} bytes from byte {part.start} on"
        self.remarks.append(f"A chunk of the file is damaged ({where}); {lost} left out.")

    def _take(self, part: _Part) -> None:
        """Take note of what is in a part."""
        stamps = []
        for opcode, body in list(self._records(part)):
            if opcode in (_SCHEMA, _CHANNEL):
                self._define(opcode, body)
            elif opcode == _MESSAGE:
                channel, _, stamp, _ = _STAMPED.unpack_from(body)
                if channel in self._channels and self._has_schema(channel):  # else a damaged chunk has them
                    self._counts[channel] = self._counts.get(channel, 0) + 1
                    stamps.append(stamp)
        if stamps:
            self._parts.append(part._replace(first_ns=min(stamps)))
            self.start_time = min(self.start_time, *stamps)
            self.end_time = max(self.end_time, max(stamps) + 1)

    def _define(self, opcode: int, body: bytes) -> None:
        if opcode == _SCHEMA:
            name, encoding, text = _texts(body[2:], 3)
            self._schemas[int.from_bytes(body[:2], "little")] = name, encoding, text
        else:
            channel, schema = struct.unpack_from("<HH", body)
            topic, encoding = _texts(body[4:], 2)
            self._channels[channel] = schema, topic, encoding

    def _has_schema(self, channel: int) -> bool:
        schema, *_ = self._channels[channel]
        return schema == 0 or schema in self._schemas

    def _connections(self, path: Path) -> list[Connection]:
        """Return a connection for each channel of ROS messages."""
        connections, others = [], []
        for channel, count in sorted(self._counts.items()):
            schema, topic, encoding = self._channels[channel]
            type, language, text = self._schemas.get(schema, ("", "", ""))
            format = _DEFINITIONS.get((encoding, language)) if type else None
            if format is None:
                others.append(f"{topic} ({encoding or 'no encoding'})")
                continue
            definition = MessageDefinition(format if text.strip() else MessageDefinitionFormat.NONE, text)
            about = ConnectionExtRosbag2(encoding, [])
            type = normalize_msgtype(type.replace("::", "/"))
            connections.append(Connection(channel, topic, type, definition, "", count, about, self))
        if others:
            named = ", ".join(others)
            if not connections:
                raise RecordingError(f"{path} holds no messages of ROS, only {named}; record the topics of ROS.")
            self.remarks.append(f"Topics whose messages are not of ROS are left out: {named}.")
        return connections

    def _records(self, part: _Part) -> Iterator[tuple[int, bytes]]:
        """Yield opcode and body of the records of a part."""
        self._file.seek(part.start)
        body = self._file.read(part.length)
        if part.opcode != _CHUNK:
            yield part.opcode, body
            return
        _, _, size, crc = _CHUNK_HEAD.unpack_from(body)
        (compression,) = _texts(body[_CHUNK_HEAD.size :], 1)
        start = _CHUNK_HEAD.size + 4 + len(compression) + 8  # behind the lengths of both
        data = DECOMPRESSORS[compression](body[start:], size)
        if len(data) != size or (crc and zlib.crc32(data) != crc):
            raise ValueError("a chunk is damaged")
        yield from _split(data)

    def messages(self, connections: Collection[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time of recording [ns] and payload of messages in that time's order."""
        wanted = {connection.id: connection for connection in connections}
        waiting: list[tuple[int, int, int, bytes]] = []  # time, number, channel, payload
        number = 0
        for part in sorted(part for part in self._parts if not part.channels or part.channels & wanted.keys()):
            while waiting and waiting[0][0] < part.first_ns:
                stamp, _, channel, payload = heapq.heappop(waiting)
                yield wanted[channel], stamp, payload
            try:
                records = list(self._records(part))
            except Exception:  # whatever the decompressors or struct say of it
                self._leave_out(part)
                continue
            for opcode, body in records:
                if opcode == _MESSAGE and (channel := int.from_bytes(body[:2], "little")) in wanted:
                    stamp, number = _STAMPED.unpack_from(body)[2], number + 1
                    heapq.heappush(waiting, (stamp, number, channel, body[_STAMPED.size :]))
        if len(self._damaged) == len(self._parts) > 0:
            raise ValueError("no whole chunk is in it")
        for stamp, _, channel, payload in sorted(waiting):
            yield wanted[channel], stamp, payload

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _split(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and body of the records that some data are."""
    at = 0
    while at < len(data):
        opcode, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size + length
        if at > len(data):
            raise ValueError("a record is longer than its chunk")
        yield opcode, data[at - length : at]


def _texts(data: bytes, count: int) -> list[str]:
    """Return the texts at the start of some data, each behind its length; a definition may be no text."""
    texts, at = [], 0
    for _ in range(count):
        (length,) = struct.unpack_from("<I", data, at)
        at += 4 + length
        if at > len(data):
            raise ValueError("a text is longer than its record")
        texts.append(data[at - length : at].decode(errors="replace"))
    return texts
