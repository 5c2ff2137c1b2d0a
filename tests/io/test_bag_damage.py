"""A bag that cannot be used is one sentence that says why."""

import bz2
import gzip
import json
import lzma
import re
import shutil
import sqlite3
from contextlib import suppress

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.rosbag2.storage_mcap import zstd
from rosbags.typesys import Stores, get_typestore

from longreach.errors import RecordingError
from longreach.io import messages
from longreach.io.bag import read_bag
from longreach.io.bag_info import inspect
from longreach.io.bag_writer import new_bag
from longreach.measurement import Imu
from longreach.robot.description import RobotDescription, Topics

ROBOT = RobotDescription(name="r")


def write(path, count=3000, strange=False, start=0):
    reading = Imu(0.0, np.ones(3), np.zeros(3))
    with new_bag(path) as bag:
        for i in range(start, start + count):
            bag.write("/imu", messages.imu(bag.types, 0.01 * i, reading), 0.01 * i)
        if strange:
            bag.write("/strange", bag.types["std_msgs/msg/String"]("x"), 1.0)
    return path


def refused(path, pattern):
    for read in (lambda: read_bag(path, ROBOT), lambda: inspect(path)):
        with pytest.raises(RecordingError, match=pattern) as caught:
            read()
        assert "\n" not in str(caught.value)
        assert str(caught.value).endswith(".")


def write_chunks(path, rng, compression=None):
    """Write 600 readings, 10 ms apart, to a bag of ROS 1 in about 12 chunks; return where its index begins."""
    bag = Ros1Writer(path)
    bag.chunk_threshold = 20_000
    if compression is not None:
        bag.set_compression(compression)
    store = get_typestore(Stores.ROS1_NOETIC)
    with bag:
        connection = bag.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        for i in range(600):
            message = messages.imu(store.types, 0.01 * i, Imu(0.0, rng.normal(size=3), rng.normal(size=3)))
            bag.write(connection, 10**7 * i, bytes(store.serialize_ros1(message, "sensor_msgs/msg/Imu")))
    whole = path.read_bytes()
    at = whole.index(b"index_pos=") + 10
    return int.from_bytes(whole[at : at + 8], "little")


@pytest.mark.parametrize("compression", [None, Ros1Writer.CompressionFormat.BZ2, Ros1Writer.CompressionFormat.LZ4])
def test_a_ros1_bag_is_read_up_to_where_it_is_cut(tmp_path, rng, compression):
    path = tmp_path / "run.bag"
    end = write_chunks(path, rng, compression)
    whole = path.read_bytes()
    for part in (0.3, 0.5, 0.9, 1.0):
        path.write_bytes(whole[: int(part * end)])
        recording = read_bag(path, ROBOT)
        lost = 0.03 if compression is None else 0.13  # a chunk that is not compressed is read to its last whole message
        assert 600 * (part - lost) <= len(recording.imu) <= 600 * (part + 0.03)
        assert [imu.stamp for imu in recording.imu] == pytest.approx(0.01 * np.arange(len(recording.imu)))
        assert recording.remarks[0].startswith("The bag has no whole index, as if its recording was cut off: the ")
        assert "damaged" not in recording.remarks[0]
    assert len(recording.imu) == 600
    path.write_bytes(whole[:100])
    refused(path, "cannot be read as a ROS bag, it is damaged or cut short")


def test_a_chunk_whose_size_was_never_written_is_read(tmp_path):
    path = write(tmp_path / "run.bag", count=50)
    whole = path.read_bytes()
    at = whole.find(b"compression=none")
    size = whole.index(b"size=", at - 60) if b"size=" in whole[at - 60 : at + 60] else -1
    assert size > 0
    start = max(size + 9, at + 16)
    length = int.from_bytes(whole[start : start + 4], "little")
    path.write_bytes(whole[:start] + bytes(4) + whole[start + 4 : start + 4 + length - 10])
    assert len(read_bag(path, ROBOT).imu) == 49


def test_a_damaged_chunk_of_a_bag_without_index_is_left_out(tmp_path, rng):
    path = tmp_path / "run.bag"
    end = write_chunks(path, rng, Ros1Writer.CompressionFormat.BZ2)
    data = bytearray(path.read_bytes()[:end])
    second = data.find(b"BZh", data.find(b"BZh") + 3)
    data[second + 40 : second + 80] = bytes(40)
    path.write_bytes(data)
    recording = read_bag(path, ROBOT)
    assert 500 < len(recording.imu) < 600
    assert recording.remarks[0].endswith("; 1 damaged chunks are left out.")


def test_chunks_after_one_without_a_size_are_read(tmp_path, rng):
    path = tmp_path / "run.bag"
    end = write_chunks(path, rng)
    data = bytearray(path.read_bytes()[:end])
    at = data.find(b"compression=none")
    size = data.index(b"size=", at - 60)
    start = max(size + 9, at + 16)
    assert int.from_bytes(data[start : start + 4], "little") > 1000
    data[start : start + 4] = bytes(4)
    path.write_bytes(data)
    recording = read_bag(path, ROBOT)
    assert len(recording.imu) == 600
    assert "damaged" not in recording.remarks[0]


@pytest.mark.parametrize("part", [0.0001, 0.1, 0.5, 0.9])
def test_a_database_cut_short_is_refused(tmp_path, part):
    file = write(tmp_path / "run") / "run.db3"
    whole = file.read_bytes()
    file.write_bytes(whole[: int(part * len(whole))])
    refused(tmp_path / "run", "cannot be read as a ROS bag, it is damaged or cut short")


@pytest.mark.parametrize("name", ["run.bag", "run.mcap", "run"])
def test_bytes_that_changed_are_read_or_refused_but_never_crash(tmp_path, rng, name):
    path = write(tmp_path / name, count=300)
    file = path / "run.db3" if path.is_dir() else path
    whole = file.read_bytes()
    for _ in range(15):
        bad = bytearray(whole)
        at = int(rng.integers(len(whole)))
        bad[at : at + 40] = rng.integers(0, 256, 40, dtype=np.uint8).tobytes()
        file.write_bytes(bad[: len(whole)])
        for read in (lambda: read_bag(path, ROBOT), lambda: inspect(path)):
            with suppress(RecordingError):
                read()


@pytest.mark.parametrize("name", ["run.bag", "run.mcap", "run"])
def test_a_bag_without_messages_is_refused(tmp_path, name):
    path = write(tmp_path / name, count=0)
    with pytest.raises(RecordingError, match="holds no messages"):
        read_bag(path, ROBOT)


@pytest.mark.parametrize("name", ["run.bag", "run.mcap"])
def test_an_empty_file_is_refused(tmp_path, name):
    (tmp_path / name).touch()
    refused(tmp_path / name, "is empty; record or copy it again")


NAMES = "rosbag2_bagfile_information: {relative_file_paths: [%s], storage_identifier: ''}"


@pytest.mark.parametrize("text", [None, "", "a: [", "rosbag2_bagfile_information: {version: 99}", json.dumps({"x": 1})])
def test_a_folder_whose_metadata_is_missing_or_nonsense_is_read_by_its_files(tmp_path, text):
    path = write(tmp_path / "run", count=3)
    (path / "metadata.yaml").unlink() if text is None else (path / "metadata.yaml").write_text(text)
    said = "run has no metadata.yaml that says which its files are; run.db3 were read."
    recording = read_bag(path, ROBOT)
    assert (len(recording.imu), recording.remarks) == (3, (said,))
    assert inspect(path).remarks == (said,)


def test_a_folder_without_any_bag_is_refused(tmp_path):
    (tmp_path / "metadata.yaml").touch()
    refused(tmp_path, r"cannot be read as a ROS bag: it holds neither a \.db3 nor an \.mcap")


def test_a_folder_that_lacks_a_file_is_refused_by_its_name(tmp_path):
    path = write(tmp_path / "run", count=3)
    (path / "metadata.yaml").write_text(NAMES % "run.db3, run_1.db3")
    refused(path, r"lacks run_1\.db3 of those that its metadata\.yaml names; copy it again, or name a file in it")


def test_the_storage_of_a_folder_is_known_by_its_files_alone(tmp_path):
    path = write(tmp_path / "run", count=3)
    write(path / "run.mcap", count=5)
    (path / "metadata.yaml").write_text(NAMES % "run.mcap")
    assert len(read_bag(path, ROBOT).imu) == 5
    assert read_bag(path, ROBOT).remarks == ()


@pytest.mark.parametrize("kind", ["db3", "mcap"])
def test_the_files_of_a_bag_are_read_alone_or_together(tmp_path, kind):
    parts = []
    for i in range(11):
        (tmp_path / str(i)).mkdir()
        made = write(tmp_path / str(i) / ("run" if kind == "db3" else "run.mcap"), count=2, start=2 * i)
        (tmp_path / "run").mkdir(exist_ok=True)
        parts.append(tmp_path / "run" / f"run_{i}.{kind}")
        shutil.copy(made / "run.db3" if kind == "db3" else made, parts[-1])
    alone = read_bag(parts[3], ROBOT)
    assert [imu.stamp for imu in alone.imu] == pytest.approx([0.06, 0.07])
    assert alone.remarks == (f"run_3.{kind} is one of 11 files of a bag; name its folder to read all of them.",)
    assert [imu.stamp for imu in read_bag(tmp_path / "run", ROBOT).imu] == pytest.approx(0.01 * np.arange(22))
    (tmp_path / "run" / "metadata.yaml").write_text(NAMES % f"/home/me/run/run_0.{kind}, run_1.{kind}")
    assert len(read_bag(tmp_path / "run", ROBOT).imu) == 4


def test_what_is_in_the_log_of_a_database_is_said_to_be_missing(tmp_path):
    path = write(tmp_path / "run", count=3)
    (path / "run.db3-wal").write_bytes(b"pages")
    assert any(
        "run.db3-wal holds messages that are not read" in said for said in read_bag(path / "run.db3", ROBOT).remarks
    )


@pytest.mark.parametrize("suffix", [".gz", ".bz2", ".xz", ".zst", ".zstd"])
@pytest.mark.parametrize("name", ["run.bag", "run.mcap", "run"])
def test_a_file_that_is_compressed_as_a_whole_is_read(tmp_path, name, suffix):
    path = write(tmp_path / name, count=30)
    file = path / "run.db3" if path.is_dir() else path
    squeeze = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}.get(suffix, zstd.compress)
    packed = file.with_name(file.name + suffix)
    packed.write_bytes(squeeze(file.read_bytes()))
    file.unlink()
    assert len(read_bag(packed, ROBOT).imu) == 30
    assert inspect(packed).topics[0].count == 30
    if path.is_dir():  # its metadata name the file without the suffix, or with it
        assert len(read_bag(path, ROBOT).imu) == 30
        (path / "metadata.yaml").write_text(NAMES % packed.name)
        assert len(read_bag(path, ROBOT).imu) == 30
    packed.write_bytes(packed.read_bytes()[:200])
    refused(packed, "cannot be read as a ROS bag, it is damaged or cut short")


def test_messages_that_are_compressed_each_are_read_without_metadata(tmp_path):
    with Ros2Writer(tmp_path / "run", version=8) as writer:
        store = get_typestore(Stores.ROS2_HUMBLE)
        connection = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        message = messages.imu(store.types, 1.0, Imu(0.0, np.ones(3), np.zeros(3)))
        raw = bytes(store.serialize_cdr(message, "sensor_msgs/msg/Imu"))
        writer.write(connection, 10**9, zstd.compress(raw))
    assert read_bag(tmp_path / "run" / "run.db3", ROBOT).imu[0].stamp == 1.0
    assert inspect(tmp_path / "run").topics[0].count == 1


def test_a_bag_without_any_known_sensor_tells_what_it_has(tmp_path):
    path = write(tmp_path / "run.mcap", count=0, strange=True)
    with pytest.raises(
        RecordingError, match=r"neither wheels nor LIDAR nor IMU; it has /strange \(std_msgs/msg/String\)"
    ):
        read_bag(path, ROBOT)


@pytest.mark.parametrize("name", ["run.bag", "run.mcap", "run"])
def test_a_type_nobody_knows_is_ignored_unless_it_is_asked_for(tmp_path, name, monkeypatch):
    monkeypatch.setattr("longreach.io.mcap_file.zlib.crc32", lambda data: 0)  # none: bytes are changed below
    path = write(tmp_path / name, count=300, strange=True)
    file = path / "run.db3" if path.is_dir() else path
    raw = file.read_bytes()
    for known, unknown in (("std_msgs/msg/String", "acme_ms/msg/Gadgets"), ("std_msgs/String", "acme_ms/Gadgets")):
        raw = raw.replace(known.encode(), unknown.encode())
    file.write_bytes(raw.replace(b"string data", b"9trin? data"))  # nor can its definition be read
    if path.is_dir():
        meta = path / "metadata.yaml"
        meta.write_text(meta.read_text().replace("std_msgs/msg/String", "acme_ms/msg/Gadgets"))
    assert len(read_bag(path, ROBOT).imu) == 300
    assert [(t.topic, t.count) for t in inspect(path).topics] == [("/imu", 300), ("/strange", 1)]
    with pytest.raises(RecordingError, match=re.escape("/strange is of type acme_ms/msg/Gadgets")):
        read_bag(path, RobotDescription(name="r", topics=Topics(imu="/strange")))


def test_a_bag_older_than_its_definitions_is_read(tmp_path):
    """Before ROS 2 Iron a database did not hold them."""
    path = write(tmp_path / "run", count=10)
    with sqlite3.connect(path / "run.db3") as database:
        for table in ("schema", "message_definitions", "metadata"):
            database.execute(f"DROP TABLE {table}")
    database.close()
    assert len(read_bag(path, ROBOT).imu) == 10
    assert inspect(path).topics[0].count == 10
