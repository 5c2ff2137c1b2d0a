"""A recording is safe from the first messages on, and nobody waits for the disk."""

import errno
import threading
from io import FileIO

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from longreach.errors import RecordingError
from longreach.io import bag_recorder, mcap_file, messages
from longreach.io.bag_info import inspect
from longreach.io.bag_recorder import Recorder
from longreach.measurement import Imu

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPE = "sensor_msgs/msg/Imu"
PAYLOAD = bytes(STORE.serialize_cdr(messages.imu(STORE.types, 1.0, Imu(0.0, np.ones(3), np.zeros(3))), TYPE))


def write(recorder, count, start=0):
    for i in range(start, start + count):
        recorder.write("/imu", TYPE, PAYLOAD, 0.01 * i)


def test_a_recording_that_is_closed_is_whole_and_alone_in_its_folder(tmp_path):
    with Recorder(tmp_path / "new" / "run.mcap") as recorder:
        write(recorder, 500)
    info = inspect(tmp_path / "new" / "run.mcap")
    assert [(topic.topic, topic.count) for topic in info.topics] == [("/imu", 500)]
    assert (info.remarks, recorder.error) == ((), "")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["run.mcap"]


def test_an_error_of_who_records_leaves_a_whole_recording(tmp_path):
    def fail(recorder):
        with recorder:
            write(recorder, 20)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail(Recorder(tmp_path / "run.mcap"))
    assert inspect(tmp_path / "run.mcap").remarks == ()


def test_a_file_stays_until_there_is_something_to_replace_it(tmp_path):
    path = tmp_path / "run.mcap"
    path.write_text("precious")
    with Recorder(path) as recorder:
        pass
    assert path.read_text() == "precious"
    assert recorder.error == "Nothing was recorded: no message has come."
    assert list(tmp_path.iterdir()) == [path]
    with Recorder(path) as recorder:
        write(recorder, 1)
    assert inspect(path).topics[0].count == 1


@pytest.mark.parametrize(("name", "pattern"), [("run.bag", r"end it with \.mcap"), ("run.mcap", "is there already")])
def test_a_place_where_nothing_can_be_recorded_is_refused_at_once(tmp_path, name, pattern):
    (tmp_path / "run.mcap").mkdir()
    with pytest.raises(RecordingError, match=pattern):
        Recorder(tmp_path / name)


def test_a_folder_that_cannot_be_made_is_refused_at_once(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="cannot be written: "):
        Recorder(tmp_path / "file" / "run.mcap")


@pytest.mark.parametrize("what", ["header", "temporary file"])
def test_a_disk_that_is_full_at_the_start_is_refused_and_leaves_no_file(tmp_path, monkeypatch, what):
    class Full(FileIO):
        def write(self, data):
            raise OSError(errno.ENOSPC, "No space left on device")

    def full(dir):
        raise OSError(errno.ENOSPC, "No space left on device")

    if what == "header":
        monkeypatch.setattr(mcap_file, "FileIO", Full)
    else:
        monkeypatch.setattr(mcap_file.tempfile, "TemporaryFile", full)
    with pytest.raises(RecordingError, match=r"run\.mcap cannot be written: No space left on device\."):
        Recorder(tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_takes_nothing_but_the_start_leaves_nothing_and_nothing_is_said_to_be_readable(
    tmp_path, monkeypatch
):
    class Full(FileIO):
        def write(self, data):
            if self.tell() > 0:  # behind the file's header
                raise OSError(errno.ENOSPC, "No space left on device")
            return super().write(data)

    monkeypatch.setattr(mcap_file, "FileIO", Full)
    path = tmp_path / "run.mcap"
    with Recorder(path) as recorder:
        write(recorder, 20)
    assert recorder.error == f"{path} cannot be written any more: No space left on device. Nothing was recorded."
    assert list(tmp_path.iterdir()) == []


def test_a_recording_that_cannot_be_put_in_its_place_says_where_it_is(tmp_path):
    path = tmp_path / "run.mcap"
    with Recorder(path) as recorder:
        path.mkdir()
        write(recorder, 20)
    (hidden,) = tmp_path.glob(".run.*.mcap")
    assert recorder.error.startswith(f"{path} cannot be written any more: ")
    assert recorder.error.endswith(f" What was recorded before can be read in {hidden}.")
    assert inspect(hidden).topics[0].count == 20


def test_on_a_full_disk_the_recording_ends_with_one_sentence_and_stays_readable(tmp_path, monkeypatch, caplog):
    class Full(FileIO):
        def write(self, data):
            room = 20_000 - self.tell()
            if room <= 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            return super().write(data[:room])  # as a disk does it: what still fits

    monkeypatch.setattr(mcap_file, "FileIO", Full)
    monkeypatch.setattr(mcap_file, "_LARGEST_CHUNK", 3_000)
    path = tmp_path / "run.mcap"
    with Recorder(path) as recorder:
        write(recorder, 200)
        recorder._thread.join()  # it has given up
        write(recorder, 50_000)
        assert recorder._waiting.qsize() < 1000
    assert [record.getMessage() for record in caplog.records] == [recorder.error]
    sentence = f"{path} cannot be written any more: No space left on device. What was recorded before can be read."
    assert recorder.error == sentence
    info = inspect(path)
    assert 20 < info.topics[0].count < 200
    assert "cut off" in info.remarks[0]
    assert list(tmp_path.iterdir()) == [path]


def test_who_gives_messages_does_not_wait_for_a_disk_that_hangs(tmp_path, monkeypatch, caplog):
    hangs, goes_on = threading.Event(), threading.Event()

    class Slow(FileIO):
        def write(self, data):
            if self.tell() > 100:  # behind the file's header
                hangs.set()
                goes_on.wait()
            return super().write(data)

    monkeypatch.setattr(mcap_file, "FileIO", Slow)
    monkeypatch.setattr(mcap_file, "_LARGEST_CHUNK", 1_000)
    monkeypatch.setattr(bag_recorder, "_WAITING", 50)
    with Recorder(tmp_path / "run.mcap") as recorder:
        write(recorder, 10)
        hangs.wait()
        write(recorder, 1000)  # comes back although nothing is written
        goes_on.set()
    written = inspect(tmp_path / "run.mcap").topics[0].count
    assert 50 <= written <= 60
    lacks = f"{tmp_path / 'run.mcap'} lacks {1010 - written} messages that the disk was too slow for."
    assert recorder.error == caplog.records[-1].getMessage() == lacks
