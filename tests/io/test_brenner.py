"""Text folders: counts, ranges and positions in milliseconds and millimetres."""

import numpy as np
import pytest

from longreach.errors import RecordingError
from longreach.io.brenner import inspect, read_brenner, read_positions
from longreach.io.config import load_description
from longreach.robot.description import RobotDescription

BRENNER = load_description("brenner")
MOTORS = "M 1000 10 0 0 0 20 0 0 0\nM 1200 15 0 0 0 26 0 0 0\n"
SCANS = "S 1100 3 500 1000 1500\nS 1300 3 510 990 0\n"
REFERENCE = "P 1000 1850 1897\nP 1200 1860 1897\n"


@pytest.fixture
def folder(tmp_path):
    for name, text in {"motors": MOTORS, "scan": SCANS, "reference": REFERENCE}.items():
        (tmp_path / f"robot9_{name}.txt").write_text(text)
    return tmp_path


def test_counts_ranges_and_positions_are_read_in_seconds_and_metres(folder):
    found = read_brenner(folder, BRENNER)
    assert [w.stamp for w in found.wheels] == [1.0, 1.2]
    np.testing.assert_array_equal([w.ticks for w in found.wheels], [[10, 20], [15, 26]])
    assert [s.stamp for s in found.scans] == [1.1, 1.3]
    np.testing.assert_allclose(found.scans[1].ranges, [0.51, 0.99, 0.0])
    assert found.scans[0].angle_min == BRENNER.lidar.angle_min
    assert found.scans[0].range_max == 5.0
    np.testing.assert_allclose(found.truth.poses, [[1.85, 1.897, 0.0], [1.86, 1.897, 0.0]])
    assert not found.truth.has_heading


def test_without_a_reference_there_is_no_truth(folder):
    (folder / "robot9_reference.txt").unlink()
    assert read_brenner(folder, BRENNER).truth is None


def test_positions_are_read_from_a_file_alone(folder):
    found = read_positions(folder / "robot9_reference.txt")
    np.testing.assert_allclose(found.stamps, [1.0, 1.2])


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("scan", "S 1100 3 500 1000\n", r"the scan at 1100 ms has 2 of 3 ranges"),
        ("scan", "", r"scan.txt is empty"),
        ("motors", "M 1000 10 0 0\n", r"motors.txt, line 1: expected M and at least 7 numbers"),
        ("motors", MOTORS + "P 1200 1 2\n", r"motors.txt, line 3: expected M"),
        ("motors", MOTORS.replace("26", "2b"), r"motors.txt, line 2: '2b' is not a number"),
        ("reference", "P 1000 1850\n", r"reference.txt, line 1: expected P and at least 3 numbers"),
    ],
)
def test_lines_cut_short_are_said(folder, name, text, sentence):
    (folder / f"robot9_{name}.txt").write_text(text)
    with pytest.raises(RecordingError, match=sentence):
        read_brenner(folder, BRENNER)


def test_a_second_recording_in_the_folder_is_said(folder):
    (folder / "robot8_scan.txt").write_text(SCANS)
    with pytest.raises(RecordingError, match=r"must hold just one file \*_scan.txt, but holds 2"):
        read_brenner(folder, BRENNER)


def test_a_robot_that_does_not_know_the_beams_is_refused(folder):
    with pytest.raises(RecordingError, match="does not say angle_min and angle_increment of its lidar"):
        read_brenner(folder, RobotDescription(name="r"))


def test_inspect_counts_the_lines_of_each_file(folder):
    found = inspect(folder)
    assert [(t.topic, t.count) for t in found.topics] == [
        ("robot9_motors.txt", 2),
        ("robot9_scan.txt", 2),
        ("robot9_reference.txt", 2),
    ]
    assert found.start == 1.0
    assert found.duration == pytest.approx(0.3)
