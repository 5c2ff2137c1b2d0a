"""Recordings as users report them: each as good as the same drive recorded well, or what is wrong is said."""

import numpy as np
import pytest

from longreach.app.doctor import examine
from longreach.app.estimate import sensor_mount
from longreach.app.inputs import open_run
from longreach.io.config import load_description
from longreach.io.recording import read_recording

# The position's RMSE [m] of the same drive recorded well; errors may be twice that and 2 mm.
GOOD = {
    "a03_rplidar_every_scan_differs": (0.0017, "differ from scan to scan"),
    "a04_frame_prefix": (0.0032, ""),
    "a05_gyro_only_zero_acceleration": (0.0131, "no accelerometer"),
    "a06_acceleration_marked_not_measured": (0.0131, ""),
    "a07_imu_clock_since_boot": (0.002, "/imu is on another clock"),
    "a08_odometry_of_a_mounted_camera": (0.0, "carried to base_link"),
    "a09_one_bad_scan": (0.0021, "1 messages of /scan cannot be used"),
}


@pytest.mark.parametrize("case", GOOD)
def test_the_fused_path_is_as_good_as_if_it_were_recorded_well(cases, case, estimate_of):
    result = estimate_of(
        cases / case / "drive.mcap", cases / case / "robot.yaml", truth=str(cases / case / "truth.tum")
    )
    good, words = GOOD[case]
    metrics = {name: one["value"] for name, one in result.metrics["fused"].items()}
    assert metrics["ate_rmse"] < 2.0 * good + 0.002
    assert metrics["path_length"] == pytest.approx(5.164, abs=0.06)
    assert metrics["final_heading_error"] < (1.35 if case[:3] in ("a05", "a06") else 0.2)
    assert any(words in remark for remark in result.remarks) or not words
    assert not any("left out" in remark for remark in result.remarks if "cannot" not in remark and "acc" not in remark)


REAL = [
    ("intel/intel.clf.bz2", "intel", ["run backwards", "gaps", "gaps"]),
    ("aces/aces.clf.bz2", "aces", ["gaps", "gaps"]),
    ("fr079/fr079.clf.bz2", "fr079", []),
    ("csail/csail.clf.bz2", "csail", []),
    ("polimi/bag1.bag", "polimi", []),
    ("polimi/bag3.bag", "polimi", []),
    ("brenner", "brenner", []),
]


@pytest.mark.parametrize(("name", "robot", "words"), REAL)
def test_the_doctor_says_of_a_real_recording_what_is_so_and_nothing_else(data, name, robot, words):
    described = load_description(robot)
    recording = read_recording(data / name, described)
    examined, remarks = examine(recording, described, sensor_mount(recording, described, "imu"))
    said = (*recording.remarks, *remarks)
    assert len(said) == len(words)
    assert all(any(word in remark for remark in said) for word in words)
    assert len(examined.scans) == len(recording.scans)


def test_the_doctor_finds_an_imu_on_its_side_and_turns_with_the_wheels_then(data, tmp_path, estimate_of):
    """A Husky's IMU stands upright on its edge, as its URDF says, which the bag does not hold."""
    robot = tmp_path / "husky.yaml"
    robot.write_text(
        "name: husky\ndrive: differential\nimu: {}\ntopics: {wheels: /husky_velocity_controller/odom, imu: /imu/data}\n"
    )
    run = open_run(data / "robot_localization" / "test1.bag", robot)
    _, remarks = examine(run.recording, run.robot, np.eye(4))
    assert any("Gravity leans by 90°" in remark for remark in remarks)
    result = estimate_of(data / "robot_localization" / "test1.bag", robot)
    assert not any("times as far" in remark or "nothing to do" in remark for remark in result.remarks)
