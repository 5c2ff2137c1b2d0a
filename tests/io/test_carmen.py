"""CARMEN logs: the order of the lines is the order of motion, whatever the stamps say."""

import bz2
import gzip
import lzma
import re

import numpy as np
import pytest

from longreach.errors import RecordingError
from longreach.io.carmen import inspect, read_carmen, read_corrected_poses
from longreach.robot.description import Lidar, Mount, RobotDescription

ROBOT = RobotDescription(name="r", drive="differential")
STAMPS = [976052857.0, 976052857.2, 976052857.1, 976052857.6, 976052857.8]  # the third runs backwards
POSES = [[0.1 * i, 0.01 * i, 0.02 * i] for i in range(5)]


def flaser(stamp, pose, ranges, laser=None):
    x, y, theta = pose
    laser = laser if laser is not None else pose
    numbers = " ".join(f"{v:.6f}" for v in (*ranges, *laser, x, y, theta))
    return f"FLASER {len(ranges)} {numbers} {stamp:.6f} nohost {stamp - 976052857:.6f}"


def odom(stamp, pose):
    return "ODOM " + " ".join(f"{v:.6f}" for v in pose) + f" 0.1 0.2 0 {stamp:.6f} nohost 0.5"


def robotlaser(
    stamp, pose, ranges, laser=None, first=-1.0, increment=0.4, farthest=81.9, remissions=(), kind="ROBOTLASER1"
):
    """Write a ROBOTLASER line, or without poses a RAWLASER line."""
    scan = f"{kind} 0 {first} {increment * len(ranges)} {increment} {farthest} 0.01 0 {len(ranges)} "
    scan += " ".join(f"{v:.6f}" for v in ranges) + f" {len(remissions)} " + "".join(f"{v} " for v in remissions)
    if kind.startswith("ROBOT"):
        poses = (*(laser if laser is not None else pose), *pose)
        scan += " ".join(f"{v:.6f}" for v in poses) + " 0.3 0.1 0.5 0.4 1e6 "
    return scan + f"{stamp:.6f} nohost {stamp - 976052857:.6f}"


def log(beams=6, offset=0.0):
    lines = ["# CARMEN Logfile", f"PARAM robot_frontlaser_offset {offset} nohost 0", "PARAM other on nohost 0", ""]
    for i, (stamp, pose) in enumerate(zip(STAMPS, POSES, strict=True)):
        lines += [odom(stamp - 0.05, pose), flaser(stamp, pose, [1.0 + 0.1 * i + 0.01 * k for k in range(beams)])]
    return "\n".join(lines) + "\n"


@pytest.fixture
def written(tmp_path):
    def write(text, name="a.log"):
        path = tmp_path / name
        content = text.encode()
        squeeze = {".gz": gzip.compress, ".bz2": bz2.compress, ".xz": lzma.compress}.get(path.suffix, lambda raw: raw)
        path.write_bytes(squeeze(content))
        return path

    return write


@pytest.mark.parametrize("name", ["a.log", "a.clf", "a.log.gz", "a.clf.bz2"])
def test_the_order_of_the_file_is_kept_and_backward_stamps_are_counted(written, name):
    found = read_carmen(written(log(), name), ROBOT)
    clock = np.array([scan.stamp for scan in found.scans])
    assert np.all(np.diff(clock) > 0)
    np.testing.assert_array_equal(found.as_recorded(clock), STAMPS)
    assert [w.stamp for w in found.wheels] == clock.tolist()
    np.testing.assert_allclose([w.pose for w in found.wheels], POSES)
    np.testing.assert_allclose([scan.ranges[0] for scan in found.scans], [1.0, 1.1, 1.2, 1.3, 1.4])
    assert found.remarks[0].startswith("1 of 5 stamps run backwards; the order of the file was kept and a clock repair")
    assert f"repaired at {len(found.recorded_stamps)} of them" in found.remarks[0]


def test_stamps_in_order_are_kept_without_a_remark(written):
    text = log().replace("976052857.100000 nohost", "976052857.400000 nohost")
    found = read_carmen(written(text), ROBOT)
    assert (found.recorded_stamps, found.remarks) == ({}, ())


@pytest.mark.parametrize(("beams", "last"), [(180, np.pi / 2 - np.pi / 180), (181, np.pi / 2), (361, np.pi / 2)])
def test_an_odd_number_of_beams_holds_both_ends(written, beams, last):
    scan = read_carmen(written(log(beams)), ROBOT).scans[0]
    assert scan.angles[0] == pytest.approx(-np.pi / 2)
    assert scan.angles[-1] == pytest.approx(last)


def test_beam_angles_in_the_description_come_first(written):
    robot = ROBOT.model_copy(update={"lidar": Lidar(angle_min=-1.0, angle_increment=0.1)})
    np.testing.assert_allclose(read_carmen(written(log()), robot).scans[0].angles, -1.0 + 0.1 * np.arange(6))


def test_the_mount_is_between_the_two_poses_of_a_scan_where_they_agree(written):
    lines = []
    for i, stamp in enumerate(STAMPS):
        c, s = np.cos(0.5 * i), np.sin(0.5 * i)
        lines.append(flaser(stamp, [i, 0.0, 0.5 * i], [1.0] * 6, [i + 0.2 * c, 0.2 * s, 0.5 * i]))
    mount = read_carmen(written("\n".join(lines)), ROBOT).mounts["laser"]
    np.testing.assert_allclose(mount[:2, 3], [0.2, 0.0], atol=1e-5)
    np.testing.assert_allclose(mount[:3, :3], np.eye(3), atol=1e-5)


def test_the_logs_offset_is_taken_where_the_two_poses_say_nothing(written):
    lines = [flaser(stamp, POSES[i], [1.0] * 6, [0.3 * i**2, 0.0, 0.0]) for i, stamp in enumerate(STAMPS)]
    lines.insert(0, "PARAM robot_frontlaser_offset 0.25 nohost 0")
    mount = read_carmen(written("\n".join(lines)), ROBOT).mounts["laser"]
    np.testing.assert_allclose(mount[:2, 3], [0.25, 0.0])


def test_a_largest_range_that_comes_again_and_again_is_no_return(written, rng):
    lines = []
    for stamp in STAMPS:
        ranges = rng.uniform(1.0, 30.0, 180)
        ranges[::20] = 81.83
        ranges[7::40] = 81.9
        lines.append(flaser(stamp, [0, 0, 0], ranges))
    found = read_carmen(written("\n".join(lines)), ROBOT)
    for scan in found.scans:
        np.testing.assert_array_equal(scan.returns == 0.0, scan.ranges > 81.0)
    assert any("81.49 m and more were taken for no returns" in remark for remark in found.remarks)


def test_a_far_wall_is_no_mark(written, rng):
    lines = [flaser(stamp, [0, 0, 0], rng.uniform(1.0, 30.0, 180)) for stamp in STAMPS]
    found = read_carmen(written("\n".join(lines)), ROBOT)
    assert all(np.all(scan.returns > 0) for scan in found.scans)
    assert not any("no returns" in remark for remark in found.remarks)


def test_the_descriptions_range_comes_before_a_mark(written, rng):
    ranges = np.append(rng.uniform(1.0, 30.0, 170), [81.83] * 10)
    robot = ROBOT.model_copy(update={"lidar": Lidar(range_max=20.0, mount=Mount())})
    found = read_carmen(written("\n".join(flaser(s, [0, 0, 0], ranges) for s in STAMPS)), robot)
    np.testing.assert_array_equal(found.scans[0].returns > 0, ranges <= 20.0)
    assert not any("no returns" in remark for remark in found.remarks)


def test_a_log_of_odometry_alone_has_wheels_and_no_scans(written):
    found = read_carmen(written("\n".join(odom(s, p) for s, p in zip(STAMPS, POSES, strict=True))), ROBOT)
    assert (len(found.wheels), found.scans, found.mounts) == (5, (), {})
    np.testing.assert_allclose([w.pose for w in found.wheels], POSES)


def test_what_is_not_finite_is_left_out_and_said(written):
    lines = log().splitlines()
    words = lines[-1].split()
    words[2 + 6] = "nan"  # x of the laser in the last scan
    found = read_carmen(written("\n".join([*lines[:-1], " ".join(words)])), ROBOT)
    assert (len(found.scans), len(found.wheels)) == (4, 4)
    assert "1 lines with a pose or stamp that is not finite were left out." in found.remarks


def test_a_changing_number_of_beams_is_said(written):
    lines = [flaser(stamp, POSES[i], [2.0] * (180 if i < 3 else 90)) for i, stamp in enumerate(STAMPS)]
    found = read_carmen(written("\n".join(lines)), ROBOT)
    assert [len(scan.ranges) for scan in found.scans] == [180, 180, 180, 90, 90]
    assert "The number of beams changes within the log." in found.remarks


def test_a_second_scanner_is_said(written):
    text = log() + flaser(STAMPS[-1] + 1, POSES[-1], [1.0] * 6).replace("FLASER", "RLASER") + "\n"
    assert "1 RLASER lines (a second scanner) were not used." in read_carmen(written(text), ROBOT).remarks


@pytest.mark.parametrize("remissions", [(), (7, 8, 9)])
@pytest.mark.parametrize("kind", ["ROBOTLASER1", "ROBOTLASER2"])
def test_a_robotlaser_line_says_its_angles_its_range_and_where_laser_and_robot_are(written, kind, remissions):
    lines = []
    for i, stamp in enumerate(STAMPS):
        c, s = np.cos(0.5 * i), np.sin(0.5 * i)
        laser = [i + 0.2 * c, 0.2 * s, 0.5 * i + 0.1]
        ranges = [1.0 + i, 2.0, 20.0, 3.0]
        lines.append(robotlaser(stamp, [i, 0.0, 0.5 * i], ranges, laser, -1.5, 0.25, 20.0, remissions, kind))
    found = read_carmen(written("\n".join(lines)), ROBOT)
    assert len(found.scans) == 5
    for i, scan in enumerate(found.scans):
        np.testing.assert_allclose(scan.angles, [-1.5, -1.25, -1.0, -0.75])
        np.testing.assert_array_equal(scan.returns > 0, [True, True, False, True])
        assert scan.ranges[0] == 1.0 + i
    np.testing.assert_allclose([w.pose for w in found.wheels], [[i, 0.0, 0.5 * i] for i in range(5)])
    np.testing.assert_array_equal(found.as_recorded(np.array([scan.stamp for scan in found.scans])), STAMPS)
    mount = found.mounts["laser"]
    np.testing.assert_allclose(mount[:2, 3], [0.2, 0.0], atol=1e-5)
    assert np.arctan2(mount[1, 0], mount[0, 0]) == pytest.approx(0.1, abs=1e-5)
    assert inspect(written("\n".join(lines))).topics[0].topic == kind


def test_what_the_description_says_of_the_laser_comes_before_a_robotlaser_line(written):
    robot = ROBOT.model_copy(update={"lidar": Lidar(angle_min=-0.5, angle_increment=0.1, range_max=2.5)})
    scan = read_carmen(written(robotlaser(STAMPS[0], [0, 0, 0], [1.0, 2.0, 3.0])), robot).scans[0]
    np.testing.assert_allclose(scan.angles, [-0.5, -0.4, -0.3])
    np.testing.assert_array_equal(scan.returns > 0, [True, True, False])


def test_an_increment_of_zero_is_taken_from_the_field_of_view(written):
    line = robotlaser(STAMPS[0], [0, 0, 0], [1.0, 2.0, 3.0, 4.0], increment=0.5).replace(" 2.0 0.5 ", " 2.0 0 ")
    assert read_carmen(written(line), ROBOT).scans[0].angle_increment == pytest.approx(0.5)


@pytest.mark.parametrize(("kind", "side", "place"), [("RAWLASER1", "front", 0.0), ("RAWLASER2", "rear", np.pi)])
def test_rawlaser_lines_take_the_wheels_of_odom_lines_and_the_lasers_place_of_the_parameters(
    written, kind, side, place
):
    lines = [f"PARAM robot_{side}laser_offset 0.3 nohost 0", f"PARAM robot_{side}laser_side_offset -0.1 nohost 0"]
    for i, stamp in enumerate(STAMPS):
        lines.append(robotlaser(stamp, None, [1.0 + i, 2.0, 3.0], kind=kind))
        lines += [odom(stamp + 0.01, POSES[i]), odom(stamp + 0.02, POSES[i])]
    found = read_carmen(written("\n".join(lines)), ROBOT)
    assert (len(found.scans), len(found.wheels)) == (5, 10)
    np.testing.assert_allclose(found.scans[0].angles, [-1.0, -0.6, -0.2])
    np.testing.assert_array_equal(found.as_recorded(np.array([scan.stamp for scan in found.scans])), STAMPS)
    np.testing.assert_allclose([w.pose for w in found.wheels[::2]], POSES)
    np.testing.assert_allclose(found.mounts["laser"][:2, 3], [0.3, -0.1])
    assert np.arctan2(*found.mounts["laser"][1::-1, 0]) == pytest.approx(place)


def test_rawlaser_lines_alone_are_scans_without_wheels(written):
    found = read_carmen(written("\n".join(robotlaser(s, None, [1.0, 2.0], kind="RAWLASER1") for s in STAMPS)), ROBOT)
    assert (len(found.scans), len(found.wheels)) == (5, 0)


def test_scans_that_stand_in_the_log_by_old_and_new_lines_are_read_once(written):
    lines = log().splitlines()
    for i, stamp in enumerate(STAMPS):
        ranges = [1.0 + 0.1 * i + 0.01 * k for k in range(6)]
        lines.append(robotlaser(stamp, None, ranges, kind="RAWLASER1"))
        lines.append(robotlaser(stamp, POSES[i], ranges))
        lines.append(robotlaser(stamp, POSES[i], [9.0] * 6, kind="ROBOTLASER2"))
    lines.append(robotlaser(976052858.0, [0.5, 0.05, 0.1], [5.0] * 6))
    found = read_carmen(written("\n".join(lines)), ROBOT)
    np.testing.assert_allclose([scan.ranges[0] for scan in found.scans], [1.0, 1.1, 1.2, 1.3, 1.4, 5.0])
    assert found.scans[0].angle_min == -np.pi / 2
    assert found.scans[-1].angle_min == -1.0
    assert found.remarks[:3] == (
        "5 RAWLASER1 lines, which have no poses, were not used.",
        "5 ROBOTLASER2 lines (a second scanner) were not used.",
        "5 scans stand in the log by two kinds of lines; they were read once.",
    )


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (flaser(976052857.0, [0, 0, 0], [1.0] * 6)[:-20], "line 1: a FLASER line of 6 ranges is cut short"),
        (odom(976052857.0, [0, 0, 0])[:-15], "line 1: an ODOM line .* it is cut"),
        ("FLASER\n", "line 1: a FLASER line of -1 ranges is cut short or has no count"),
        ("FLASER many 1 2 3\n", "line 1: a FLASER line of -1 ranges"),
        ("ODOM 1 2 3\n", "line 1: an ODOM line has x y θ tv rv accel and a time; it is cut"),
        ("ODOM 1 2 x 0 0 0 5.0 host 5.0\n", "line 1: 'x' is not a number"),
        (flaser(1.0, [0, 0, 0], [1.0] * 6).replace("1.000000 nohost", "one nohost"), "line 1: 'one' is not a number"),
        (
            robotlaser(976052857.0, [0, 0, 0], [1.0] * 6)[:-20],
            "line 1: a ROBOTLASER1 line of 6 ranges is cut short or has no",
        ),
        ("ROBOTLASER1 0 1 2 3\n", "line 1: a ROBOTLASER1 line of -1 ranges is cut short"),
        ("hello world\n", "holds no FLASER, ROBOTLASER, RAWLASER or ODOM lines, so it is no CARMEN log; it has hello"),
        ("", "it has no lines at all"),
        ("\x89MCAP\x00\n\x01\ufffd\n", "it has nothing that is text"),
        ("ODOM nan 2 3 0 0 0 5.0 host 5.0\n", "holds no line with finite numbers"),
        (flaser(976052857e9, [0, 0, 0], [1.0] * 6), "looks like nanoseconds; stamps are seconds"),
    ],
)
def test_a_log_that_cannot_be_used_is_one_sentence(written, text, sentence):
    with pytest.raises(RecordingError, match=sentence) as caught:
        read_carmen(written(text), ROBOT)
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith(".")


def test_lines_that_cannot_be_read_are_left_out_and_said(written):
    lines = log().splitlines(keepends=True)
    whole = read_carmen(written("".join(lines)), ROBOT)
    cut = read_carmen(written("".join(lines)[:-40]), ROBOT)
    assert len(cut.scans) == len(whole.scans) - 1
    assert re.fullmatch(
        r"A line was left out: .*, line 14: a FLASER line of 6 ranges is cut short or has no count\.", cut.remarks[0]
    )
    lines[4] = lines[4].replace(" 0.", " o.", 1)
    damaged = written("".join(lines)[:-40])
    for remarks in (read_carmen(damaged, ROBOT).remarks, inspect(damaged).remarks):
        assert remarks[0].startswith("2 lines were left out; the first: ")
        assert ", line 5: 'o." in remarks[0]
    with pytest.raises(RecordingError, match=r"A reference has to be whole\. 2 lines were left out"):
        read_corrected_poses(damaged)


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.99])
def test_a_compressed_log_is_read_up_to_where_it_is_cut(written, rng, part):
    text = "\n".join(flaser(976052857.0 + i, [0.1 * i, 0, 0], rng.uniform(1, 9, 180)) for i in range(200))
    path = written(text, "a.log.gz")
    whole = path.read_bytes()
    path.write_bytes(whole[: int(part * len(whole))])
    found = read_carmen(path, ROBOT)
    assert 200 * part - 15 < len(found.scans) < 200
    np.testing.assert_array_equal([scan.stamp for scan in found.scans], 976052857.0 + np.arange(len(found.scans)))
    assert re.search(r"cut short: its compressed data end too early\. It was read up to there\.$", found.remarks[0])


def test_a_compressed_log_of_which_nothing_is_whole_is_refused(written):
    path = written(log(180), "a.clf.bz2")
    path.write_bytes(path.read_bytes()[:200])
    for read in (lambda: read_carmen(path, ROBOT), lambda: inspect(path)):
        with pytest.raises(RecordingError, match=r"is cut short: its compressed data end too early\.$"):
            read()


@pytest.mark.parametrize("name", ["a.log.gz", "a.clf.bz2"])
def test_a_log_that_is_not_compressed_as_its_name_says_is_refused(tmp_path, name):
    (tmp_path / name).write_text(log())
    with pytest.raises(RecordingError, match=f"{name} (is not what its name says|cannot be read): "):
        read_carmen(tmp_path / name, ROBOT)


def test_the_laser_poses_of_a_corrected_log_are_a_trajectory(written):
    text = "\n".join(flaser(s, [9, 9, 9], [1.0] * 6, p) for s, p in zip(STAMPS, POSES, strict=True))
    found = read_corrected_poses(written(text, "corrected.log.gz"))
    np.testing.assert_array_equal(found.stamps, STAMPS)
    np.testing.assert_allclose(found.poses, POSES)
    with pytest.raises(RecordingError, match="has no FLASER lines"):
        read_corrected_poses(written(odom(1.0, [0, 0, 0])))


def test_a_corrected_log_finds_its_scans_in_the_recording_by_their_ranges(written):
    recording = read_carmen(written(log()), ROBOT)
    lines = log().splitlines()
    scans = [line.split() for line in lines if line.startswith("FLASER")]
    corrected = []
    for i in (4, 2, 0):  # fewer, in another order, on another clock
        words = scans[i]
        words[8:11] = [f"{v + 1.0:.3f}" for v in POSES[i]]
        words[14] = f"{float(words[14]) - 976052857.0:.4f}"
        corrected.append(" ".join(words))
    corrected.append(flaser(3.0, [0, 0, 0], [5.0] * 6))  # one that the recording does not have
    found = read_corrected_poses(written("\n".join(corrected), "b.log"), recording)
    np.testing.assert_array_equal(found.stamps, [STAMPS[0], STAMPS[2], STAMPS[4]])
    np.testing.assert_array_equal(found.clock, [recording.scans[i].stamp for i in (0, 2, 4)])
    np.testing.assert_allclose(found.poses, np.array(POSES)[[0, 2, 4]] + 1.0, atol=1e-3)


def test_a_corrected_log_of_something_else_keeps_its_own_stamps(written):
    recording = read_carmen(written(log()), ROBOT)
    text = "\n".join(flaser(s, p, [7.0 + s % 1] * 6) for s, p in zip(STAMPS, POSES, strict=True))
    np.testing.assert_array_equal(read_corrected_poses(written(text, "b.log"), recording).stamps, STAMPS)


def test_inspect_counts_lines_by_kind(written):
    found = inspect(written(log() + "TRUEPOS 1 2 3\n"))
    assert found.format == "CARMEN log"
    assert [(t.topic, t.count, t.backward_stamps) for t in found.topics] == [("FLASER", 5, 1), ("ODOM", 5, 1)]
    assert found.start == pytest.approx(STAMPS[0] - 0.05)
    assert found.duration == pytest.approx(0.85)
    assert found.remarks == ("Scans have 6 beams.", "2 PARAM lines are not used.", "1 TRUEPOS lines are not used.")
