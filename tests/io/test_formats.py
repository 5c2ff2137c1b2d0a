"""The format of a recording is told from its name and first bytes."""

import pytest

from longreach.errors import RecordingError
from longreach.io.formats import MCAP_MAGIC, recording_format


def made(path, content=b"text"):
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("name", "content", "format"),
    [
        ("a.bag", b"anything", "ros1"),
        ("a.mcap", b"anything", "mcap"),
        ("a.clf", b"FLASER", "carmen"),
        ("a.log", b"FLASER", "carmen"),
        ("a.b.LOG.gz", b"\x1f\x8b", "carmen"),
        ("a.clf.bz2", b"BZh", "carmen"),
        ("a.bag.active", b"#ROSBAG V2.0\n", "ros1"),
        ("a", MCAP_MAGIC, "mcap"),
    ],
)
def test_files_are_known_by_suffix_or_first_bytes(tmp_path, name, content, format):
    assert recording_format(made(tmp_path / name, content)) == format


def test_folders_are_known_by_what_is_in_them(tmp_path):
    made(tmp_path / "ros2" / "metadata.yaml")
    made(tmp_path / "brenner" / "robot4_motors.txt")
    made(tmp_path / "brenner" / "robot4_scan.txt")
    assert recording_format(tmp_path / "ros2") == "ros2"
    assert recording_format(tmp_path / "brenner") == "brenner"


@pytest.mark.parametrize("name", ["a.txt", "a", "a.bag.gz", "a.gz"])
def test_anything_else_is_refused_with_what_is_accepted(tmp_path, name):
    with pytest.raises(RecordingError, match=r"of no known format: a recording is a ROS 1 \.bag, a ROS 2 folder"):
        recording_format(made(tmp_path / name))


def test_a_path_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(RecordingError, match=r"There is no recording at .*nope\.bag; check the path"):
        recording_format(tmp_path / "nope.bag")


@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ("notes.txt", "is a folder without metadata.yaml: a recording is"),
        ("a_0.db3", "has no metadata.yaml beside a_0.db3; make it with `ros2 bag reindex`"),
        ("a.mcap", "has no metadata.yaml; name a file in it instead: a.mcap"),
    ],
)
def test_a_folder_without_metadata_is_refused_with_what_to_do(tmp_path, inside, message):
    made(tmp_path / "folder" / inside)
    with pytest.raises(RecordingError, match=message):
        recording_format(tmp_path / "folder")
