"""A run as a page shows it, and the scene of it as one file."""

import numpy as np
import pytest

from longreach.errors import RecordingError
from longreach.measurement import JointState, Recording
from longreach.trajectory import PoseTrajectory
from longreach.view.bodies import cylinder, quaternion
from longreach.view.replay import assemble, read_run


def test_the_robot_stands_where_estimate_and_joints_say(drive):
    middle = drive.frames[drive.index(1.0)]
    np.testing.assert_allclose(middle.q[:3], [0.5, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(middle.q[3], 0.1, atol=1e-9)
    np.testing.assert_allclose(middle.wheels, [0.5, 0.05, 0.0], atol=1e-9)


def test_the_fingers_stand_where_they_were_recorded(thing):
    t = np.array([0.0, 1.0])
    names = (*thing.joint_names[thing.arm], "finger_a_joint_1")
    rows = tuple(
        JointState(s, names, np.append(thing.home[thing.arm], 0.8 * s), np.zeros(0), np.zeros(0)) for s in t.tolist()
    )
    fused = PoseTrajectory(t, np.zeros((2, 3)))
    run = assemble("hand", thing, Recording(name="hand", joints=rows), {"fused": fused})
    assert run.frames[run.index(0.5)].joints == pytest.approx({"finger_a_joint_1": 0.4}, abs=0.02)
    assert assemble("none", thing, Recording(name="none"), {"fused": fused}).frames[0].joints == {}


def test_a_wall_is_one_row_of_map_points_that_are_known_when_they_were_seen(drive):
    assert np.all(np.diff(drive.map_times) >= 0)
    assert len(drive.map_points) > 10
    np.testing.assert_allclose(drive.map_points[:, 0].min(), 0.3932 + 2.0, atol=0.05)


def test_a_scan_stands_where_the_base_was_when_it_was_taken(drive):
    for time in (0.43, 1.0, 1.99):
        frame = drive.frames[drive.index(time)]
        x = frame.scan_pose[0] + frame.scan[:, 0]
        np.testing.assert_allclose(x, 0.3932 + 2.0, atol=0.01)  # the wall, through the laser's mount


def test_the_plots_tell_the_error_in_millimetres(drive):
    wheels = next(plot for plot in drive.plots if plot.title == "Error of the wheels alone [mm]")
    np.testing.assert_allclose(wheels.curves[0].values[-1], 100.0, atol=1e-6)
    assert wheels.highest > 100.0


def test_a_time_before_the_start_or_after_the_end_shows_the_first_or_last_moment(drive):
    assert drive.index(-1.0) == 0
    assert drive.index(99.0) == len(drive.frames) - 1


def test_what_is_not_there_is_said_in_a_sentence(tmp_path):
    with pytest.raises(RecordingError, match="There is nothing at"):
        read_run(tmp_path / "none")


def test_a_quaternion_turns_as_its_matrix_does(rng):
    from longreach.geometry import so3

    R = so3.exp(rng.normal(size=3))
    w, *v = quaternion(R)
    p = rng.normal(size=3)
    turned = p + 2 * np.cross(v, np.cross(v, p) + w * p)
    np.testing.assert_allclose(turned, R @ p, atol=1e-9)


def test_a_cylinder_is_closed_and_its_faces_look_outward():
    corners, faces = cylinder(0.1, 0.5)
    a, b, c = (corners[faces[:, i]] for i in range(3))
    volume = np.sum(a * np.cross(b, c)) / 6.0
    np.testing.assert_allclose(volume, np.pi * 0.01 * 0.5, rtol=0.01)


def test_a_report_gets_the_scene_and_still_fetches_nothing(drive, tmp_path, monkeypatch):
    pytest.importorskip("viser")
    from longreach.view import export

    report = tmp_path / "report.html"
    report.write_text("<body><section><h2>Figures</h2></section></body>", encoding="utf-8")
    monkeypatch.setattr(export, "read_run", lambda folder: drive)
    assert not export.add_to_report(tmp_path)  # there is no run
    for name in ("recording.mcap", "fused.tum"):
        (tmp_path / name).touch()
    assert export.add_to_report(tmp_path)
    page = report.read_text(encoding="utf-8")
    assert len(page) < 10e6
    assert page.index("srcdoc=") < page.index("<h2>Figures")
    assert "<script" not in page  # they are in the frame, escaped
    assert "base by its wheels alone" in page
    assert "image/svg+xml" in page


def test_an_estimate_has_its_scene_too(thing, tmp_path):
    pytest.importorskip("viser")
    from longreach.app.estimate import estimate
    from longreach.sim.kinematic import make_recording
    from longreach.view.export import add_to_report
    from longreach.view.replay import of_estimate

    recording = make_recording(thing.description, duration=2.0, lidar_rate=10.0, beams=90)
    run = of_estimate(estimate(recording, thing.description))
    assert len(run.map_points) > 20
    (tmp_path / "report.html").write_text("<body><section><h2>Figures</h2></section></body>", encoding="utf-8")
    assert add_to_report(tmp_path, lambda: run)
    assert 1e5 < (tmp_path / "report.html").stat().st_size < 2e6
