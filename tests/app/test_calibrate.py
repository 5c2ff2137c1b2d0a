import json

import numpy as np
import pytest
from typer.testing import CliRunner

import longreach as lr
from longreach.app.calibrate import calibrate, write_calibration
from longreach.cli.main import app
from longreach.errors import CalibrationError
from longreach.geometry import se2
from longreach.io.config import load_description, validated
from longreach.io.tum import write_tum
from longreach.measurement import Odometry, Recording
from longreach.odometry.wheel import wheel_odometry
from longreach.robot.bases import MecanumBase
from longreach.robot.description import RobotDescription
from longreach.trajectory import PoseTrajectory

DRIVER = RobotDescription(name="driven")


@pytest.fixture(scope="module")
def drive():
    """Odometry of a driver that is off by its scales, and the truth: straight and turning, for a minute."""
    stamps = np.arange(0.0, 60.0, 0.05)
    turn = (stamps // 5).astype(int) % 2 == 1
    twists = np.column_stack((np.where(turn, 0.0, 0.4), np.zeros(len(stamps)), np.where(turn, 0.6, 0.0)))
    truth, odometry = np.zeros((len(stamps), 3)), np.zeros((len(stamps), 3))
    for i in range(1, len(stamps)):
        truth[i] = se2.retract(truth[i - 1], twists[i] * 0.05)
        odometry[i] = se2.retract(odometry[i - 1], twists[i] * 0.05 / [1.03, 1.0, 0.98])
    wheels = tuple(Odometry(float(t), pose=p) for t, p in zip(stamps, odometry, strict=True))
    return Recording("drive", wheels=wheels, truth=PoseTrajectory(stamps, truth))


def test_scales_of_a_drivers_odometry_are_found_from_a_reference_and_used_from_now_on(drive):
    found = calibrate(drive, DRIVER, use_truth=True)
    np.testing.assert_allclose(found.robot.odometry_scale, [1.03, 1.0, 0.98], atol=2e-3)
    assert [name for name, p in found.parameters.items() if not p.observable] == ["scale_y"]
    assert found.remarks == ("scale_y is not observable from this run: drive sideways for 2 m, and back.",)
    before, after = (wheel_odometry(drive.wheels, robot).measurements for robot in (DRIVER, found.robot))
    step = next(i for i, m in enumerate(before) if m.pose[0] > 0.01)
    assert after[step].pose[0] == pytest.approx(0.02, rel=1e-3)
    assert before[step].pose[0] == pytest.approx(0.02 / 1.03, rel=1e-6)


def test_two_recordings_say_more_than_one(drive):
    one, two = calibrate(drive, DRIVER, use_truth=True), calibrate([drive, drive], DRIVER, use_truth=True)
    assert len(two.used) == 2 * len(one.used)
    assert two.parameters["scale_x"].value == pytest.approx(one.parameters["scale_x"].value, abs=1e-4)


def test_without_scans_or_reference_the_sentence_says_what_is_missing(drive):
    with pytest.raises(CalibrationError, match="has 0 scans; where there is no LIDAR, give a reference with --truth"):
        calibrate(drive, DRIVER)
    with pytest.raises(CalibrationError, match="has no reference with headings"):
        calibrate(drive.replace(truth=None), DRIVER, use_truth=True)
    with pytest.raises(CalibrationError, match="has 0 wheel records"):
        calibrate(drive.replace(wheels=()), DRIVER, use_truth=True)


def test_three_seconds_of_data_and_standing_still_are_refused_with_what_to_drive(drive):
    short = drive.replace(
        wheels=drive.wheels[:60], truth=PoseTrajectory(drive.truth.stamps[:60], drive.truth.poses[:60])
    )
    with pytest.raises(CalibrationError, match="a calibration takes 20 at least; drive for a minute"):
        calibrate(short, DRIVER, use_truth=True)
    still = tuple(Odometry(w.stamp, pose=np.zeros(3)) for w in drive.wheels)
    with pytest.raises(CalibrationError, match="No parameter is observable from this run by itself: drive straight"):
        calibrate(
            drive.replace(wheels=still, truth=PoseTrajectory(drive.truth.stamps, np.zeros((1200, 3)))),
            DRIVER,
            use_truth=True,
        )


def test_what_is_written_is_whole_and_can_be_used(drive, tmp_path):
    found = calibrate(drive, DRIVER, use_truth=True)
    write_calibration(found, tmp_path / "out")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names >= {"robot.yaml", "calibration.json", "covariance.npz", "metrics.json", "report.html"}
    assert load_description(tmp_path / "out" / "robot.yaml") == found.robot
    said = json.loads((tmp_path / "out" / "calibration.json").read_text(encoding="utf-8"))
    assert set(said["scale_x"]) == {"value", "sigma", "nominal", "unit", "observable"}
    assert said["scale_y"] == {"value": 1.0, "sigma": None, "nominal": 1.0, "unit": "1", "observable": False}
    after = found.after[found.used]
    assert np.linalg.norm(after) < 0.2 * np.linalg.norm(found.before[found.used])


def test_the_laser_and_the_wheels_of_a_simulated_base_are_found_from_its_scans(unchecked, tmp_path):
    thing = load_description("thing")
    true = thing.lidar.mount
    recording = lr.make_recording(thing, seed=1, duration=40.0, lidar_rate=10.0, beams=361)
    wrong = validated(
        RobotDescription,
        thing.model_dump(exclude_unset=True)
        | {"lidar": thing.lidar.model_dump() | {"mount": true.model_dump() | {"x": true.x - 0.04, "yaw": 0.05}}},
        "wrong",
    )
    found = lr.calibrate(recording, wrong)
    mount = found.robot.lidar.mount
    assert abs(mount.x - true.x) < 0.02
    assert abs(mount.y - true.y) < 0.02
    assert abs(mount.yaw - true.yaw) < 0.01
    assert (mount.z, mount.roll, mount.pitch) == pytest.approx((true.z, true.roll, true.pitch))
    np.testing.assert_allclose(found.robot.base.radii, thing.base.radii, rtol=0.02)
    write_calibration(found, tmp_path / "out")
    again = load_description(tmp_path / "out" / "robot.yaml")
    np.testing.assert_array_equal(again.base.forward_matrix, found.robot.base.forward_matrix)
    assert again.lidar == found.robot.lidar


def test_a_base_with_a_radius_a_wheel_undoes_its_own_inverse():
    base = MecanumBase(wheel_radius=0.1, wheel_radii=(0.1, 0.101, 0.102, 0.103), half_length=0.2, half_width=0.2)
    np.testing.assert_allclose(base.forward_matrix @ base.inverse_matrix, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(base.residual_matrix @ base.inverse_matrix, 0.0, atol=1e-15)
    with pytest.raises(ValueError, match="must have a radius for each of the 4 wheels, but has 2"):
        MecanumBase(wheel_radius=0.1, wheel_radii=(0.1, 0.1), half_length=0.2, half_width=0.2)


def test_one_reference_file_for_two_recordings_is_refused_before_anything_is_written(tmp_path):
    recording, truth = tmp_path / "still.txt", tmp_path / "truth.tum"
    write_tum(truth, PoseTrajectory(np.arange(3.0), np.zeros((3, 3))))
    recording.write_text("nothing\n", encoding="utf-8")
    arguments = ["calibrate", str(recording), str(recording), "--robot", "thing", "--truth", str(truth)]
    ended = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")])
    assert ended.exit_code == 2
    assert not (tmp_path / "out").exists()
