"""A bag that cannot be used is one sentence that says why."""

import json
import re
import sqlite3
from contextlib import suppress

import numpy as np
import pytest

from longreach.errors import RecordingError
from longreach.io import messages
from longreach.io.bag import read_bag
from longreach.io.bag_info import inspect
from longreach.io.bag_writer import new_bag
from longreach.measurement import Imu
from longreach.robot.description import RobotDescription, Topics

ROBOT = RobotDescription(name="r")


def write(path, count=3000, strange=False):
    reading = Imu(0.0, np.ones(3), np.zeros(3))
    with new_bag(path) as bag:
        for i in range(count):
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


@pytest.mark.parametrize("part", [0.001, 0.1, 0.5, 0.9, 0.999])
def test_a_file_cut_short_is_refused(tmp_path, part):
    path = write(tmp_path / "run.bag")
    whole = path.read_bytes()
    path.write_bytes(whole[: int(part * len(whole))])
    refused(path, "cannot be read as a ROS bag, it is damaged or cut short")


@pytest.mark.parametrize("part", [0.0, 0.0001, 0.1, 0.5, 0.9])
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


def test_a_folder_whose_metadata_is_nonsense_is_refused(tmp_path):
    path = write(tmp_path / "run", count=3)
    for text in ("", "a: [", "rosbag2_bagfile_information: {version: 99}", json.dumps({"x": 1})):
        (path / "metadata.yaml").write_text(text)
        refused(path, "cannot be read as a ROS bag")


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
