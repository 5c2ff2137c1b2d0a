"""MCAP files: written in chunks that can each be read alone, and read where their end is missing or damaged.

What its topics are stands before the chunks: a damaged chunk takes no topic with it.

Source: https://mcap.dev/spec. Whole files are read by rosbags.
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

from longreach.io.formats import MCAP_MAGIC

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(1, 9)
_STATISTICS, _SUMMARY_OFFSET, _DATA_END = 0x0B, 0x0E, 0x0F
_RECORD = struct.Struct("<BQ")  # opcode and length
_STAMPED = struct.Struct("<HIQQ")  # channel, number, time of recording, time of publication [ns]
_CHUNK_HEAD = struct.Struct("<QQQI")  # first and last time [ns], size and CRC before compression
_LARGEST_CHUNK = 1 << 20  # [bytes]
_DEFINITIONS = {
    "ros2msg": MessageDefinitionFormat.MSG,
    "ros2idl": MessageDefinitionFormat.IDL,
    "omgidl": MessageDefinitionFormat.IDL,
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
    """A chunk, or a message outside of chunks: its first time [ns], its opcode, and where it is in the file."""

    first_ns: int
    opcode: int
    start: int
    length: int


class CutMcap:
    """An MCAP without its end, as rosbags' readers are used: all that is in its whole chunks.

    remark: a sentence that says so.

    Raises:
        ValueError: it has no message.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._size = os.fstat(self._file.fileno()).st_size
        self._schemas: dict[int, tuple[str, MessageDefinition]] = {}
        self._channels: dict[int, tuple[int, str, str]] = {}  # schema, topic, encoding
        self._counts: dict[int, int] = {}
        self._parts: list[_Part] = []
        self.start_time, self.end_time = 2**63 - 1, 0  # [ns]; the end is not within, as rosbags has it
        self._damaged = 0
        try:
            self._scan()
            if not self._parts:
                raise ValueError("no whole chunk is in it")
        except BaseException:
            self.close()
            raise
        self.connections = [self._connection(channel) for channel in sorted(self._counts)]
        seconds = 1e-9 * (self.end_time - 1 - self.start_time)
        damaged = f"; {self._damaged} damaged chunks are left out" if self._damaged else ""
        self.remark = (
            f"The recording was cut off, its file has no end: the {seconds:.1f} s up to its last whole chunk are "
            f"read{damaged}."
        )

    def _scan(self) -> None:
        """Find all parts that are whole."""
        start = self._file.read(len(MCAP_MAGIC) + _RECORD.size + 8)
        if not (start.startswith(MCAP_MAGIC) and start.endswith(_sized(b"ros2"))):
            raise ValueError("it does not begin as an MCAP of ROS 2")
        at, taken = len(MCAP_MAGIC), (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK)
        while at + _RECORD.size <= self._size:
            self._file.seek(at)
            opcode, length = _RECORD.unpack(self._file.read(_RECORD.size))
            start, at = at + _RECORD.size, at + _RECORD.size + length
            if opcode in (0, _FOOTER, _DATA_END) or at > self._size:
                return  # 0: blocks of the disk that nothing was written to
            if opcode in taken:
                try:
                    self._take(_Part(0, opcode, start, length))
                except Exception:  # whatever the decompressors, struct or Unicode say of it
                    self._damaged += 1

    def _take(self, part: _Part) -> None:
        """Take note of what is in a part."""
        stamps = []
        for opcode, body in list(self._records(part)):
            if opcode == _SCHEMA:
                name, encoding, text = _texts(body[2:], 3)
                kind = _DEFINITIONS.get(encoding, MessageDefinitionFormat.NONE)
                self._schemas[int.from_bytes(body[:2], "little")] = name, MessageDefinition(kind, text)
            elif opcode == _CHANNEL:
                channel, schema = struct.unpack_from("<HH", body)
                topic, encoding = _texts(body[4:], 2)
                self._channels[channel] = schema, topic, encoding
            elif opcode == _MESSAGE:
                channel, _, stamp, _ = _STAMPED.unpack_from(body)
                schema, *_ = self._channels.get(channel, (None,))
                if schema in self._schemas:  # else a damaged chunk says of what it is
                    self._counts[channel] = self._counts.get(channel, 0) + 1
                    stamps.append(stamp)
        if stamps:
            self._parts.append(part._replace(first_ns=min(stamps)))
            self.start_time = min(self.start_time, *stamps)
            self.end_time = max(self.end_time, max(stamps) + 1)

    def _connection(self, channel: int) -> Connection:
        schema, topic, encoding = self._channels[channel]
        type, definition = self._schemas[schema]
        about = ConnectionExtRosbag2(encoding, [])
        return Connection(channel, topic, type, definition, "", self._counts[channel], about, self)

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
        at = 0
        while at < size:
            opcode, length = _RECORD.unpack_from(data, at)
            at += _RECORD.size + length
            if at > size:
                raise ValueError("a record is longer than its chunk")
            yield opcode, data[at - length : at]

    def messages(self, connections: Collection[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time of recording [ns] and payload of messages in that time's order."""
        wanted = {connection.id: connection for connection in connections}
        waiting: list[tuple[int, int, int, bytes]] = []  # time, number, channel, payload
        number = 0
        for part in sorted(self._parts):
            while waiting and waiting[0][0] < part.first_ns:
                stamp, _, channel, payload = heapq.heappop(waiting)
                yield wanted[channel], stamp, payload
            for opcode, body in self._records(part):
                if opcode == _MESSAGE and (channel := int.from_bytes(body[:2], "little")) in wanted:
                    stamp, number = _STAMPED.unpack_from(body)[2], number + 1
                    heapq.heappush(waiting, (stamp, number, channel, body[_STAMPED.size :]))
        for stamp, _, channel, payload in sorted(waiting):
            yield wanted[channel], stamp, payload

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _texts(data: bytes, count: int) -> list[str]:
    """Return the texts at the start of some data, each behind its length."""
    texts, at = [], 0
    for _ in range(count):
        (length,) = struct.unpack_from("<I", data, at)
        at += 4 + length
        if at > len(data):
            raise ValueError("a text is longer than its record")
        texts.append(data[at - length : at].decode())
    return texts
