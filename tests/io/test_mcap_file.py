"""An MCAP without its end is read up to its last whole chunk, and a remark says so; it is never a traceback."""

import re
import struct
import tracemalloc
from contextlib import suppress

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

from longreach.errors import RecordingError
from longreach.io import messages
from longreach.io.bag import read_bag
from longreach.io.bag_file import open_bag
from longreach.io.bag_info import inspect
from longreach.io.bag_writer import BagWriter
from longreach.io.mcap_file import McapWriter
from longreach.measurement import Imu
from longreach.robot.description import RobotDescription, Topics

ROBOT = RobotDescription(name="r")
STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPE, TEXT = "sensor_msgs/msg/Imu", "std_msgs/msg/String"
SMALL = bytes(STORE.serialize_cdr(STORE.types[TEXT]("x"), TEXT))


def payload(i):
    return bytes(STORE.serialize_cdr(messages.imu(STORE.types, 0.01 * i, Imu(0.0, np.ones(3), np.zeros(3))), TYPE))


def chunks_of(path, chunks, each=4, topic="/imu", type=TYPE, payload=payload):
    """Write an MCAP of chunks and return where in the file each of them ends, with its index of messages."""
    ends = []
    with McapWriter(path) as file:
        bag = BagWriter(file)
        for i in range(chunks * each):
            bag.write_cdr(topic, type, payload(i), 0.01 * i)
            if i % each == each - 1:
                file.flush()
                ends.append(path.stat().st_size)
    return ends


def test_a_file_that_was_cut_is_read_up_to_its_last_whole_chunk_at_every_byte(tmp_path):
    path = tmp_path / "run.mcap"
    ends = chunks_of(path, 3, 2, "/text", TEXT, lambda i: SMALL)
    whole = path.read_bytes()
    assert inspect(path).remarks == ()
    index = 9 + 2 + 4 + 2 * 16  # bytes behind each chunk that are not needed
    for size in range(len(whole)):
        path.write_bytes(whole[:size])
        there = sum(size >= end - index for end in ends)
        if not there:
            with pytest.raises(RecordingError, match=r"damaged or cut short|is empty"):
                inspect(path)
            continue
        info = inspect(path)
        assert [(topic.topic, topic.count) for topic in info.topics] == [("/text", 2 * there)]
        (remark,) = info.remarks
        end = f"{info.start + info.duration:.3f}"
        assert re.search(rf"cut off, its file has no end: the {info.duration:.1f} s .* ends at {end}, are", remark)


def test_what_is_read_of_a_cut_file_is_what_was_written_and_the_remark_goes_with_it(tmp_path):
    path = tmp_path / "run.mcap"
    ends = chunks_of(path, 3)
    path.write_bytes(path.read_bytes()[: ends[-1]])
    recording = read_bag(path, ROBOT)
    assert [imu.stamp for imu in recording.imu] == pytest.approx(0.01 * np.arange(12))
    assert recording.remarks == inspect(path).remarks
    assert len(recording.remarks) == 1


def test_a_cut_file_whose_bytes_changed_is_read_or_refused_but_never_crashes(tmp_path, rng):
    path = tmp_path / "run.mcap"
    ends = chunks_of(path, 5)
    cut = path.read_bytes()[: ends[-1]]
    for _ in range(300):
        bad = bytearray(cut)
        at = int(rng.integers(len(cut)))
        count = int(rng.choice([1, 8, 40]))
        bad[at : at + count] = rng.integers(0, 256, count, dtype=np.uint8).tobytes()
        path.write_bytes(bad[: len(cut)])
        for read in (lambda: read_bag(path, ROBOT), lambda: inspect(path)):
            with suppress(RecordingError):
                read()


@pytest.mark.parametrize("chunk", [0, 1, 2])
def test_a_damaged_chunk_of_a_cut_file_is_left_out(tmp_path, chunk):
    path = tmp_path / "run.mcap"
    ends = chunks_of(path, 3)
    bad = bytearray(path.read_bytes()[: ends[-1]])
    bad[ends[chunk] - 300] ^= 1  # in a payload
    path.write_bytes(bad)
    info = inspect(path)
    assert info.topics[0].count == 8
    said, cut = info.remarks
    assert re.fullmatch(r"A chunk of the file is damaged \(\d+ bytes .*\); the 4 messages in it were left out\.", said)
    assert cut.endswith("are read.")


@pytest.mark.parametrize("chunk", [0, 1, 2])
def test_a_damaged_chunk_of_a_whole_file_is_left_out_alone(tmp_path, chunk):
    path = tmp_path / "run.mcap"
    ends = chunks_of(path, 3)
    bad = bytearray(path.read_bytes())
    bad[ends[chunk] - 300] ^= 1
    path.write_bytes(bad)
    stamps = 0.01 * np.array([i for i in range(12) if i // 4 != chunk])
    recording = read_bag(path, ROBOT)
    assert [imu.stamp for imu in recording.imu] == pytest.approx(stamps)
    (said,) = recording.remarks
    assert re.fullmatch(r"A chunk of the file is damaged \(\d+ bytes .*\); the 4 messages in it were left out\.", said)
    assert inspect(path).remarks == (said,)
    assert inspect(path).topics[0].count == 8


def test_a_whole_file_without_a_whole_chunk_is_refused(tmp_path):
    path = tmp_path / "run.mcap"
    ends = chunks_of(path, 1)
    bad = bytearray(path.read_bytes())
    bad[ends[0] - 300] ^= 1
    path.write_bytes(bad)
    for read in (lambda: read_bag(path, ROBOT), lambda: inspect(path)):
        with pytest.raises(RecordingError, match="no whole chunk"):
            read()


def mcap_of(path, channels, profile="", index=True):
    """Write an MCAP with a chunk, of (topic, message encoding, type, its encoding, definition, payloads)."""

    def record(opcode, *parts):
        return struct.pack("<BQ", opcode, sum(map(len, parts))) + b"".join(parts)

    def sized(data):
        data = data if isinstance(data, bytes) else data.encode()
        return struct.pack("<I", len(data)) + data

    records, start = b"", b"\x89MCAP0\r\n" + record(1, sized(profile), sized("another writer"))
    for i, (topic, encoding, type, language, definition, payloads) in enumerate(channels, 1):
        if type:
            records += record(3, struct.pack("<H", i), sized(type), sized(language), sized(definition))
        records += record(4, struct.pack("<HH", i, i if type else 0), sized(topic), sized(encoding), sized(""))
        for k, data in enumerate(payloads):
            records += record(5, struct.pack("<HIQQ", i, k, 10**7 * k, 10**7 * k), data)
    body = start + record(
        6, struct.pack("<QQQI", 0, 0, len(records), 0), sized(""), struct.pack("<Q", len(records)), records
    )
    body += record(15, bytes(4))
    summary = len(body) if index else 0
    if index:  # a summary without an index of chunks, as some writers leave it
        body += record(11, struct.pack("<QHIIIIQQ", 0, 0, 0, 0, 0, 1, 0, 0), sized(b""))
    path.write_bytes(body + record(2, struct.pack("<QQI", summary, 0, 0)) + b"\x89MCAP0\r\n")
    return path


def definition(store, type, version=2):
    return store.generate_msgdef(type, ros_version=version)[0]


ROS2 = ("/imu", "cdr", TYPE, "ros2msg", definition(STORE, TYPE), [payload(i) for i in range(5)])
JSON = ("/mood", "json", "Mood", "jsonschema", '{"type": "object"}', [b'{"good": true}'] * 3)
PROTOBUF = ("/pose", "protobuf", "foxglove.Pose", "protobuf", b"\xff\xfe\x00", [b"\x08\x01"])
BARE = ("/raw", "", "", "", "", [b"?"])


@pytest.mark.parametrize("profile", ["", "ros1", "ros2", "anything"])
@pytest.mark.parametrize("index", [True, False])
def test_channels_are_read_by_their_own_encodings_whatever_the_profile_says(tmp_path, profile, index):
    recording = read_bag(mcap_of(tmp_path / "run.mcap", [ROS2], profile, index), ROBOT)
    assert [imu.stamp for imu in recording.imu] == pytest.approx(0.01 * np.arange(5))
    assert recording.remarks == ()


def ros1(i):
    """Return an IMU's message of ROS 1, and its type as MCAP writes it."""
    store = get_typestore(Stores.ROS1_NOETIC)
    header = store.types["std_msgs/msg/Header"](7, store.types["builtin_interfaces/msg/Time"](5, 10**7 * i), "imu")
    vector = store.types["geometry_msgs/msg/Vector3"](1.0, 2.0, 3.0)
    turned = store.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    zero = np.zeros(9)
    message = store.types[TYPE](header, turned, zero, vector, zero, vector, zero)
    return bytes(store.serialize_ros1(message, TYPE)), definition(store, TYPE, 1)


def test_messages_of_ros_1_and_2_stand_side_by_side_and_others_are_named(tmp_path):
    older = ("/old", "ros1", "sensor_msgs/Imu", "ros1msg", ros1(0)[1], [ros1(i)[0] for i in range(4)])
    path = mcap_of(tmp_path / "run.mcap", [JSON, older, ROS2, PROTOBUF, BARE])
    said = "Topics whose messages are not of ROS are left out: /mood (json), /pose (protobuf), /raw (no encoding)."
    info = inspect(path)
    assert [(t.topic, t.type, t.count) for t in info.topics] == [("/imu", TYPE, 5), ("/old", TYPE, 4)]
    assert info.remarks == (said,)
    for topic, stamps in (("/old", 5.0 + 0.01 * np.arange(4)), ("/imu", 0.01 * np.arange(5))):
        recording = read_bag(path, RobotDescription(name="r", topics=Topics(imu=topic)))
        assert [imu.stamp for imu in recording.imu] == pytest.approx(stamps)
        assert recording.remarks == (said,)
    assert read_bag(path, RobotDescription(name="r", topics=Topics(imu="/old"))).imu[0].angular_velocity[2] == 3.0


def test_a_file_without_any_message_of_ros_says_what_it_has(tmp_path):
    path = mcap_of(tmp_path / "run.mcap", [JSON, PROTOBUF])
    with pytest.raises(RecordingError, match=r"holds no messages of ROS, only /mood \(json\), /pose \(protobuf\); "):
        inspect(path)


def test_a_damaged_first_chunk_takes_no_topic_with_it(tmp_path):
    path = tmp_path / "run.mcap"
    with McapWriter(path) as file:
        bag = BagWriter(file)
        for i in range(4):  # the third chunk has messages of both
            bag.write_cdr(*(("/two", TEXT, SMALL) if i % 2 else ("/one", TYPE, payload(i))), 0.01 * i)
            if i != 2:
                file.flush()
            if i == 0:
                first = path.stat().st_size
        cut = path.stat().st_size
    bad = bytearray(path.read_bytes()[:cut])
    bad[first - 200] ^= 1
    path.write_bytes(bad)
    assert [(topic.topic, topic.count) for topic in inspect(path).topics] == [("/one", 1), ("/two", 2)]


def test_zeros_behind_the_last_chunk_as_a_power_cut_leaves_them_are_no_records(tmp_path):
    path = tmp_path / "run.mcap"
    ends = chunks_of(path, 2)
    path.write_bytes(path.read_bytes()[: ends[-1]] + bytes(5000))
    assert inspect(path).topics[0].count == 8


@pytest.mark.parametrize("compressed", [True, False])
def test_cut_files_of_other_writers_are_read_too(tmp_path, compressed):
    """Of rosbags, which has no CRCs."""
    writer = Ros2Writer(tmp_path / "run", version=8, storage_plugin=StoragePlugin.MCAP)
    if compressed:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/imu", TYPE, typestore=STORE)
        for i in range(6000):
            writer.write(connection, 10**7 * i, payload(i))
    path = tmp_path / "run" / "run.mcap"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    imu = read_bag(path, ROBOT).imu
    assert 1000 < len(imu) < 6000
    assert [one.stamp for one in imu] == pytest.approx(0.01 * np.arange(len(imu)))


def test_a_cut_file_without_chunks_is_read(tmp_path):
    """As the preset fastwrite of ROS 2 writes it: what a chunk holds stands in the file itself."""
    path = tmp_path / "run.mcap"
    chunks_of(path, 1, each=10)
    whole = path.read_bytes()
    start = 8
    while whole[start] != 6:  # the chunk's record
        start += 9 + int.from_bytes(whole[start + 1 : start + 9], "little")
    size = int.from_bytes(whole[start + 9 + 16 : start + 9 + 24], "little")
    records = start + 9 + 28 + 4 + 8
    path.write_bytes(whole[:start] + whole[records : records + size - 1])  # the last message lacks a byte
    assert len(read_bag(path, ROBOT).imu) == 9


def test_messages_of_overlapping_chunks_come_in_the_order_of_time(tmp_path):
    path = tmp_path / "run.mcap"
    with McapWriter(path) as file:
        bag = BagWriter(file)
        for k, stamps in enumerate(([3, 1, 5], [2, 4, 9], [6, 8, 7])):
            for i in stamps:
                bag.write_cdr("/imu", TYPE, payload(i), 0.01 * i)
            file.flush()
            if k == 2:
                cut = path.stat().st_size
    with open_bag(path) as bag:
        whole = list(bag.raw_messages([("/imu", TYPE)]))
    path.write_bytes(path.read_bytes()[:cut])
    with open_bag(path) as bag:
        assert bag.remarks
        found = list(bag.raw_messages([("/imu", TYPE)]))
    assert [stamp for *_, stamp, _ in found] == [10**7 * i for i in range(1, 10)]
    assert [raw for *_, raw in found] == [raw for *_, raw in whole]


def test_memory_does_not_grow_with_what_is_written(tmp_path):
    raw = payload(0)
    with McapWriter(tmp_path / "run.mcap") as file:
        bag = BagWriter(file)

        def write(chunks):
            for i in range(chunks):
                bag.write_cdr("/imu", TYPE, raw, 0.01 * i)
                file.flush()

        write(10)  # connections are made
        tracemalloc.start()
        try:
            write(1000)
            grown, _ = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
    assert grown < 20_000
    assert inspect(tmp_path / "run.mcap").topics[0].count == 1010
