"""The format of a recording is told from its name and first bytes."""

import gzip

import pytest

from longreach.errors import RecordingError
from longreach.io.formats import MCAP_MAGIC, bag_files, recording_format


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
        ("a.db3", b"anything", "sqlite"),
        ("a", b"SQLite format 3\0", "sqlite"),
        ("a.bag.gz", gzip.compress(b"anything", mtime=0), "ros1"),
        ("a.MCAP.zstd", b"\x28\xb5\x2f\xfd", "mcap"),
        ("a.db3.zst", b"\x28\xb5\x2f\xfd", "sqlite"),
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


@pytest.mark.parametrize("name", ["a.txt", "a", "a.gz"])
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
        ("a_0.db3 b_0.db3", "has no metadata.yaml; name a file in it instead: a_0.db3, b_0.db3"),
        ("a.mcap b.bag c.mcap", "has no metadata.yaml; name a file in it instead: a.mcap, c.mcap, b.bag"),
        ("mav0/imu0", "is a folder of an EuRoC data set, which is not read as a recording; convert it to a bag"),
        ("sequences/00", "is a folder of a KITTI data set, which is not read as a recording; convert it to a bag"),
    ],
)
def test_a_folder_without_metadata_is_refused_with_what_to_do(tmp_path, inside, message):
    for name in inside.split():
        (tmp_path / "folder" / name).parent.mkdir(exist_ok=True, parents=True)
        made(tmp_path / "folder" / name)
    with pytest.raises(RecordingError, match=message):
        recording_format(tmp_path / "folder")


def test_a_folder_with_the_files_of_one_bag_is_that_bag(tmp_path):
    for name in ("a_0.db3", "a_10.db3", "a_2.db3.zstd", "a_2.db3"):
        made(tmp_path / "folder" / name)
    assert recording_format(tmp_path / "folder") == "ros2"
    assert [file.name for file in bag_files(tmp_path / "folder")] == ["a_0.db3", "a_2.db3", "a_10.db3"]


EUROC = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.rawlog", gzip.compress(b"\x8fCSensoryFrame\x02", mtime=0), "an MRPT rawlog, .*; convert it to a bag or an MCAP"),
        ("a.bin", gzip.compress(b"\x8fCSensoryFrame\x02", mtime=0), "an MRPT rawlog"),
        ("a.bin", b"\x9bmrpt::obs::CActionCollection", "an MRPT rawlog"),
        ("a.g2o", b"# a graph\n", "a g2o pose graph, .*; it holds poses and no readings of sensors"),
        ("a.txt", b"VERTEX_SE2 0 0 0 0\n", "a g2o pose graph"),
        ("a.graph", b"VERTEX2 0 0 0 0\n", "a TORO pose graph"),
        ("a.csv", EUROC.encode(), "a file of an EuRoC data set, .*; `longreach evaluate` reads it, and --truth takes"),
        ("data.csv", b"#timestamp [ns],w_RS_S_x [rad s^-1]\n", "a file of an EuRoC data set"),
        ("00.txt", b"1 0 0 0 0 1 0 0 0 0 1 0\n" * 3, "a trajectory in KITTI's format, .*; `longreach evaluate` reads"),
        ("truth.txt", b"# t x\n1.5 0 0 0 0 0 0 1e0\n", "a trajectory in TUM's format"),
        ("truth.tum", b"", "a trajectory in TUM's format"),
        (
            "a.pcap",
            b"\xd4\xc3\xb2\xa1\x02\x00",
            r"a network capture \(pcap\), .*; replay it with that sensor's ROS driver",
        ),
        ("a.bag", b"\n\r\r\n\x1c\x00", r"a network capture \(pcap\)"),
        ("a.bag", b"#ROSBAG V1.2\n", "a ROS bag of a version before 2.0, .*; convert it with `rosbag fix`"),
        ("a.zip", b"PK\x03\x04\x14", "a ZIP archive, .*; unpack it and name what is inside"),
        ("a.ulg", b"ULog\x01\x12\x35\x01", r"a PX4 log \(ULog\)"),
        ("a.h5", b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
    ],
)
def test_a_format_that_is_not_read_is_called_by_its_name(tmp_path, name, content, said):
    with pytest.raises(RecordingError, match=rf"is {said}") as caught:
        recording_format(made(tmp_path / name, content))
    assert "which is not read as a recording; " in str(caught.value)


def test_a_log_that_zstandard_has_compressed_is_said_to_be_one(tmp_path):
    with pytest.raises(RecordingError, match="is a CARMEN log that is compressed by Zstandard; unpack it with"):
        recording_format(made(tmp_path / "a.log.zst"))
