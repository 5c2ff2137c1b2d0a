"""The 15-state filter over readings: masks, mounts, differential and relative poses, late and broken messages."""

from dataclasses import replace

import numpy as np
import pytest

from longreach.errors import EstimationError
from longreach.estimation.spatial import _kernels as kernels
from longreach.estimation.spatial.angles import to_angles
from longreach.estimation.spatial.batch import estimate_in_space, late_and_ahead
from longreach.estimation.spatial.rows import rows_of
from longreach.evaluation.consistency import chi2_bounds
from longreach.geometry import se3, so3
from longreach.spatial_measurement import AccelerationReading, Command, PoseReading, SpatialRecording, TwistReading
from longreach.spatial_settings import ControlSettings, SensorSettings, SpatialSettings

GRAVITY = 9.80665
SIDEWAYS = se3.from_rotation_translation(so3.from_roll_pitch_yaw(0.3, -0.2, 1.2), np.array([0.3, -0.2, 0.5]))


def mask(*names):
    states = ["x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "vroll", "vpitch", "vyaw", "ax", "ay", "az"]
    return tuple(state in names for state in states)


TWIST = mask("vx", "vy", "vz", "vroll", "vpitch", "vyaw")
POSE = mask("x", "y", "z", "roll", "pitch", "yaw")


def sensor(kind="twist", entries=TWIST, **more):
    return SensorSettings(f"{kind}0", kind, kind, entries, **more)


def twist(stamp, values, variance=1e-4, frame="", source="twist0"):
    return TwistReading(stamp, np.array(values, dtype=float), variance * np.eye(6), frame, source)


def pose(stamp, T, covariance=None, frame="", source="pose0", child=""):
    return PoseReading(stamp, T, 1e-4 * np.eye(6) if covariance is None else covariance, frame, source, child)


def recording(readings, commands=(), **frames):
    known = {"": np.eye(4), **frames}
    return SpatialRecording("made", tuple(readings), tuple(commands), mounts=known, origins=known)


def run(readings, *sensors, commands=(), frames=None, **settings):
    return estimate_in_space(recording(readings, commands, **(frames or {})), SpatialSettings(sensors, **settings))


def at(xyz, rpy):
    return se3.from_rotation_translation(so3.from_roll_pitch_yaw(*map(float, rpy)), np.array(xyz, dtype=float))


def drive(count=100, dt=0.05, rates=(0.0, 0.0, 0.4)):
    """Twists of a steady curve, the poses they lead to, and their stamps."""
    u = np.array([1.0, 0.1, 0.0, *rates])
    stamps = 100.0 + dt * np.arange(count)
    return stamps, u, np.array([se3.exp(u * dt * i) for i in range(count)])


def test_a_steady_twist_leads_where_the_exponential_leads():
    stamps, u, poses = drive(rates=(0.05, -0.03, 0.4))
    e = run([twist(t, u, 1e-8) for t in stamps], sensor())
    np.testing.assert_allclose(e.poses[-1], poses[-1], atol=2e-3)
    assert e.stamps[-1] == stamps[-1]
    assert e.used == {"twist0_twist": (100, 0, 0)}


def test_ekf_and_ukf_agree_on_a_gentle_drive(rng):
    stamps, u, _ = drive()
    readings = [twist(t, u + 0.01 * rng.normal(size=6)) for t in stamps]
    a, b = (run(readings, sensor(), filter=name) for name in ("ekf", "ukf"))
    np.testing.assert_allclose(a.states, b.states, atol=1e-5)
    np.testing.assert_allclose(a.state_covariance, b.state_covariance, atol=1e-4)


def test_the_covariance_is_of_the_error_in_the_base():
    stamps, u, _ = drive(rates=(0.2, 0.1, 0.4))
    e = run([twist(t, u) for t in stamps], sensor())
    T, P = e.poses[-1], e.state_covariance[-1]
    base = e.states[-1, :6]

    def log_error(delta):
        return se3.log(se3.inverse(T) @ at(base[:3] + delta[:3], base[3:] + delta[3:]))

    J = np.column_stack([(log_error(d) - log_error(-d)) / 2e-6 for d in np.eye(6) * 1e-6])
    np.testing.assert_allclose(e.covariance[-1], J @ P @ J.T, rtol=1e-5, atol=1e-9)


def test_only_masked_values_are_fused():
    readings = [twist(0.1 * i, [1.0, 5.0, 5.0, 5.0, 5.0, 0.2]) for i in range(20)]
    e = run(readings, sensor(entries=mask("vx", "vyaw")))
    np.testing.assert_allclose(e.states[-1, [6, 11]], [1.0, 0.2], atol=1e-3)
    np.testing.assert_allclose(e.states[-1, [7, 8, 9, 10]], 0.0, atol=1e-9)


def test_a_twist_is_that_of_the_point_where_the_sensor_sits():
    stamps, u, _ = drive(rates=(0.1, 0.2, 0.4))
    seen = se3.adjoint(se3.inverse(SIDEWAYS)) @ u
    e = run([twist(t, seen, 1e-8, "tilted") for t in stamps], sensor(), frames={"tilted": SIDEWAYS})
    np.testing.assert_allclose(e.states[-1, 6:12], u, atol=1e-4)


def test_one_masked_axis_of_a_tilted_sensor_tells_of_that_axis_alone():
    u = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.5])
    seen = se3.adjoint(se3.inverse(SIDEWAYS)) @ u
    seen[3:5] = 77.0  # garbage, which the mask leaves out
    readings = [twist(0.05 * i, seen, 1e-6, "tilted") for i in range(40)]
    gyro = sensor(entries=mask("vyaw"))
    ours = run(readings, gyro, frames={"tilted": SIDEWAYS}).states[-1, 9:12]
    assert SIDEWAYS[:3, 2] @ ours == pytest.approx(SIDEWAYS[2, 2] * 0.5, abs=1e-3)
    assert np.abs(ours).max() < 1.0
    theirs = run(readings, gyro, frames={"tilted": SIDEWAYS}, as_robot_localization=True).states[-1, 9:12]
    assert np.abs(theirs).max() > 10.0


@pytest.mark.parametrize("entries", [POSE, mask("roll", "pitch", "yaw"), mask("roll", "pitch"), mask("yaw")])
def test_an_imu_on_its_side_gives_the_orientation_of_the_base(entries):
    truth = at([0, 0, 0], [0.2, -0.1, 2.0])
    seen = np.eye(4)
    seen[:3, :3] = truth[:3, :3] @ SIDEWAYS[:3, :3]
    imu = sensor("imu", tuple(a and b for a, b in zip(entries, mask("roll", "pitch", "yaw"), strict=True)))
    rows = rows_of([pose(0.0, seen, None, "tilted", "imu0")], recording([], tilted=SIDEWAYS), SpatialSettings((imu,)))
    z, H = rows[0].z[0], rows[0].H[0, : rows[0].k]
    np.testing.assert_allclose(z[3:], [0.2, -0.1, 2.0], atol=1e-12)
    base = np.array([0.2, -0.1, 2.0])

    def angles(rho):
        return to_angles((so3.from_roll_pitch_yaw(*rho) @ SIDEWAYS[:3, :3])[None])[0]

    if sum(imu.mask) < 3:
        numeric = np.column_stack([(angles(base + d) - angles(base - d)) / 2e-6 for d in np.eye(3) * 1e-6])
        np.testing.assert_allclose(H[:, 3:], numeric[list(imu.mask[3:6])], atol=1e-6)


def test_as_robot_localization_a_mounting_is_taken_off_angle_by_angle():
    mount = at([0, 0, 0], [0.0, 0.0, np.pi / 2])
    seen = at([0, 0, 0], [0.1, 0.2, 1.0])
    imu = sensor("imu", mask("roll", "pitch", "yaw"))
    s = SpatialSettings((imu,), as_robot_localization=True)
    z = rows_of([pose(0.0, seen, None, "turned", "imu0")], recording([], turned=mount), s)[0].z[0]
    np.testing.assert_allclose(z[3:], [-0.2, 0.1, 1.0 - np.pi / 2], atol=1e-12)


def test_a_pose_in_another_frame_is_carried_into_the_world():
    stamps, _, poses = drive(20)
    moved = [pose(t, se3.inverse(SIDEWAYS) @ T @ se3.inverse(at([0.1, 0, 0], [0, 0, 0])), None, "other", "odom0", "tip")
             for t, T in zip(stamps, poses, strict=True)]  # fmt: skip
    frames = {"other": SIDEWAYS, "tip": se3.inverse(at([0.1, 0, 0], [0, 0, 0]))}
    e = run(moved, sensor("odom", POSE, child_frame=True), frames=frames)
    np.testing.assert_allclose(e.poses[-1], poses[-1], atol=0.01)


def test_relative_poses_start_at_the_origin():
    stamps, _, poses = drive(40)
    e = run([pose(t, SIDEWAYS @ T) for t, T in zip(stamps, poses, strict=True)], sensor("pose", POSE, relative=True))
    np.testing.assert_allclose(e.poses[0], np.eye(4), atol=1e-6)
    np.testing.assert_allclose(e.poses[-1], poses[-1], atol=0.01)


def test_differential_poses_are_twists_with_the_covariance_of_a_difference(rng):
    stamps, u, poses = drive(3)
    C = np.diag([1e-4, 4e-4, 9e-4, 1e-4, 2e-4, 3e-4])
    readings = [pose(t, SIDEWAYS @ T, C) for t, T in zip(stamps, poses, strict=True)]
    rows = rows_of(readings, recording([]), SpatialSettings((sensor("pose", POSE, differential=True),)))[0]
    assert rows.block == 6
    np.testing.assert_allclose(rows.z, [u, u], atol=1e-9)
    R1, R2 = ((SIDEWAYS @ T)[:3, :3] for T in poses[:2])
    expected = (R1.T @ C[:3, :3] @ R1 + R2.T @ C[:3, :3] @ R2) / 0.05**2
    np.testing.assert_allclose(rows.R[0][:3, :3], expected, rtol=1e-9)
    theirs = SpatialSettings((sensor("pose", POSE, differential=True),), as_robot_localization=True)
    np.testing.assert_allclose(rows_of(readings, recording([]), theirs)[0].R[0], 2 * C * 0.05, rtol=1e-9)


def test_differential_and_relative_poses_ignore_where_the_sensor_thinks_it_is():
    stamps, _, poses = drive(60)
    readings = [pose(t, at([50, -20, 3], [0, 0, 2.5]) @ T) for t, T in zip(stamps, poses, strict=True)]
    e = run(readings, sensor("pose", POSE, differential=True), initial_covariance=1e-9 * np.eye(15))
    np.testing.assert_allclose(e.poses[-1][:3, 3], poses[-2][:3, 3], atol=0.05)


def test_a_differential_pose_and_a_twist_of_one_message_are_told_apart():
    stamps, u, poses = drive(30)
    readings = [
        r for t, T in zip(stamps, poses, strict=True) for r in (pose(t, T, source="odom0"), twist(t, u, source="odom0"))
    ]
    e = run(readings, sensor("odom", (True,) * 12 + (False,) * 3, differential=True))
    assert e.used == {"odom0_pose": (29, 0, 0), "odom0_twist": (30, 0, 0)}


def accelerations(stamps, f, frame="", attitude=None):
    return [AccelerationReading(t, np.array(f), 1e-4 * np.eye(3), frame, "imu0", attitude) for t in stamps]


def test_gravity_is_removed_by_the_orientation_of_the_message():
    R = so3.from_roll_pitch_yaw(0.3, -0.4, 1.0)
    readings = accelerations(0.02 * np.arange(200), R.T @ [0.0, 0.0, GRAVITY] + [0.5, 0.0, 0.0], "", R)
    e = run(readings, sensor("imu", mask("ax", "ay", "az"), remove_gravity=True))
    np.testing.assert_allclose(e.states[-1, 12:], [0.5, 0.0, 0.0], atol=1e-3)


def test_without_one_gravity_is_removed_by_the_filters_and_corrects_its_tilt():
    R = so3.from_roll_pitch_yaw(0.1, -0.2, 0.0)
    readings = accelerations(0.02 * np.arange(500), R.T @ [0.0, 0.0, GRAVITY])
    readings = [r for a in readings for r in (twist(a.stamp, np.zeros(6)), a)]
    P = np.diag([1e-9] * 3 + [0.1, 0.1, 1e-9] + [1e-9] * 9)
    noise = 1e-6 * np.eye(15)
    imu = sensor("imu", mask("ax", "ay", "az"), remove_gravity=True)
    e = run(readings, sensor(), imu, initial_covariance=P, process_noise=noise)
    np.testing.assert_allclose(e.states[-1, 3:5], [0.1, -0.2], atol=5e-3)


def test_a_turning_robots_imu_feels_its_lever_arm_and_its_turn():
    mount = at([0.4, 0.3, 0.0], [0.0, 0.0, 0.0])
    v, w, l = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.8]), mount[:3, 3]
    f = np.cross(w, v) + np.cross(w, np.cross(w, l))  # a steady circle
    stamps = 0.02 * np.arange(400)
    readings = [r for t in stamps for r in (twist(t, [*v, *w], 1e-6), *accelerations([t], f, "imu"))]
    imu = sensor("imu", mask("ax", "ay", "az"))
    ours = run(readings, sensor(), imu, frames={"imu": mount}).states[-1]
    theirs = run(readings, sensor(), imu, frames={"imu": mount}, as_robot_localization=True).states[-1]
    np.testing.assert_allclose(ours[12:], 0.0, atol=1e-3)
    assert theirs[13] > 0.5  # ω × v taken for a growing velocity


def test_two_d_mode_keeps_to_the_plane(rng):
    stamps, _, _ = drive(80)
    readings = [twist(t, [1.0, 0.1, 0.5, 0.3, -0.2, 0.4]) for t in stamps]
    e = run(readings, sensor(), two_d_mode=True)
    np.testing.assert_allclose(e.states[:, [2, 3, 4, 8, 9, 10, 14]], 0.0, atol=1e-6)
    assert np.hypot(*e.states[-1, :2]) > 1.0
    assert np.all(e.state_covariance[-1][[2, 3, 4], [2, 3, 4]] < 1e-5)


def test_rows_go_on_through_a_sensor_holiday():
    readings = [twist(t, [1.0, 0, 0, 0, 0, 0]) for t in [*np.arange(0, 2, 0.1), *np.arange(7, 8, 0.1)]]
    e = run(readings, sensor(), frequency=10.0, sensor_timeout=0.2)
    assert np.diff(e.stamps).max() < 0.35
    i = int(np.argmin(np.abs(e.stamps - 6.0)))
    assert e.states[i, 0] == pytest.approx(e.stamps[i], abs=1e-3)
    variance = e.state_covariance[:, 0, 0]
    assert variance[i] > 2 * variance[int(np.argmin(np.abs(e.stamps - 2.0)))]


def test_late_messages_give_the_result_of_sorted_ones(rng):
    stamps, u, poses = drive(200)
    readings = [twist(t, u + 0.02 * rng.normal(size=6)) for t in stamps]
    readings += [pose(t + 0.01, T) for t, T in zip(stamps[::4], poses[::4], strict=True)]
    readings += [pose(t + 0.013, T, source="odom0") for t, T in zip(stamps[::4], poses[::4], strict=True)]
    sensors = sensor(), sensor("pose", POSE), sensor("odom", POSE, differential=True)
    ordered = sorted(readings, key=lambda r: r.stamp)
    shuffled = sorted(readings, key=lambda r: r.stamp + rng.uniform(0.0, 0.2))
    assert [r.stamp for r in shuffled] != [r.stamp for r in ordered]
    for as_is in (False, True):
        a, b = (run(order, *sensors, as_robot_localization=as_is) for order in (ordered, shuffled))
        np.testing.assert_array_equal(a.states, b.states)
        np.testing.assert_array_equal(a.state_covariance, b.state_covariance)


def test_what_is_later_than_the_history_is_left_out_and_said():
    stamps, u, _ = drive(60)
    late = twist(stamps[0] + 0.5, 50 * u)
    e = run([*(twist(t, u) for t in stamps[:50]), late, *(twist(t, u) for t in stamps[50:])], sensor())
    assert e.used["twist0_twist"][0] == 60
    assert e.remarks == ("1 readings came in more than 1 s late and were left out.",)


@pytest.mark.parametrize("place", [0, 3, 30, 59, 60])
def test_a_stamp_from_the_future_holds_up_nothing(place):
    stamps, u, _ = drive(60)
    readings = [twist(t, u) for t in stamps]
    e = run([*readings[:place], twist(stamps[0] + 3600.0, 50 * u), *readings[place:]], sensor())
    clean = run(readings, sensor())
    np.testing.assert_array_equal(e.states, clean.states)
    assert e.remarks == ("1 readings have stamps ahead of what came in after them and were left out.",)


def test_a_pause_in_the_recording_is_no_future():
    stamps = np.concatenate([np.arange(0, 5, 0.1), np.arange(300, 305, 0.1)])
    late, ahead = late_and_ahead(stamps, 1.0)
    assert not late.any()
    assert not ahead.any()


@pytest.mark.parametrize("as_is", [False, True])
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_numbers_that_are_none_leave_no_trace(kind, as_is):
    stamps, u, poses = drive(60)
    good = [twist(t, u) for t in stamps]
    bad = [replace(r, twist=np.full(6, v)) for r, v in zip(good[10:13], (np.nan, np.inf, -np.inf), strict=True)]
    bad += [replace(r, covariance=np.full((6, 6), np.nan)) for r in good[20:23]]
    T = poses[0].copy()
    T[:3] = np.nan
    bad += [pose(t, T) for t in stamps[30:33]]
    e = run([*good, *bad], sensor(), sensor("pose", POSE), filter=kind, history=100.0, as_robot_localization=as_is)
    clean = run(good, sensor(), filter=kind, as_robot_localization=as_is)
    assert np.all(np.isfinite(e.states))
    np.testing.assert_allclose(e.states[-1], clean.states[-1], atol=1e-6)
    assert "twist0_twist: 6 of 66 measurements hold values that are no numbers" in " ".join(e.remarks)


def test_a_value_that_is_no_number_does_not_take_the_others_along():
    u = np.array([1.0, np.nan, 0, 0, 0, 0.2])
    C = 1e-4 * np.eye(6)
    C[1] = C[:, 1] = np.nan
    readings = [replace(twist(0.1 * i, u), covariance=C) for i in range(20)]
    for entries in (TWIST, mask("vx", "vyaw")):
        e = run(readings, sensor(entries=entries))
        np.testing.assert_allclose(e.states[-1, [6, 11]], [1.0, 0.2], atol=1e-3)


def test_outliers_beyond_the_threshold_are_left_out():
    stamps, u, _ = drive(60)
    readings = [twist(t, 30 * u if i in (20, 21) else u) for i, t in enumerate(stamps)]
    e = run(readings, sensor(twist_gate=5.0))
    assert e.used["twist0_twist"] == (58, 2, 0)
    np.testing.assert_allclose(e.states[:, 6], 1.0, atol=0.01)


def test_the_first_measurement_sets_what_it_measures():
    e = run([pose(0.0, at([3, -2, 1], [0.1, 0.2, 3.0]))], sensor("pose", POSE))
    np.testing.assert_allclose(e.states[0, :6], [3, -2, 1, 0.1, 0.2, 3.0], atol=1e-5)
    np.testing.assert_allclose(e.state_covariance[0], 1e-4 * np.eye(6), rtol=1e-5, atol=1e-12)


def test_an_angle_comes_round():
    readings = [pose(0.05 * i, at([0, 0, 0], [0, 0, 3.0 + 0.1 * i])) for i in range(60)]
    e = run(readings, sensor("pose", POSE))
    yaw = np.unwrap(e.states[:, 5])
    assert yaw[-1] == pytest.approx(3.0 + 0.1 * 59, abs=0.05)
    assert np.abs(e.states[:, 5]).max() <= np.pi


def test_commands_drive_the_prediction_until_they_time_out():
    control = ControlSettings(mask("x")[:6], (2.0,) * 6, (1.0,) * 6, (2.0,) * 6, (1.0,) * 6, 0.5)
    commands = [Command(0.1 * i, np.array([1.0, 0, 0, 0, 0, 0])) for i in range(100)]
    readings = [twist(0.1 * i, [0, 0, 0, 0, 0, 0.0]) for i in range(200)]
    e = run(readings, sensor(entries=mask("vyaw")), commands=commands, control=control)
    speed = np.interp([9.0, 19.0], e.stamps, e.states[:, 6])
    assert speed[0] == pytest.approx(1.0, abs=0.05)
    assert speed[1] == pytest.approx(0.0, abs=0.05)


def test_nothing_to_fuse_is_said():
    with pytest.raises(EstimationError, match="No reading of the recording can be fused"):
        run([twist(0.0, np.zeros(6), source="odom7")], sensor())


def truth_and_readings(rng, settings):
    """Draw a run from the filter's own model: the last truth, and what was measured of it."""
    root, x = np.sqrt(np.diag(settings.process_noise)), np.sqrt(np.diag(settings.initial_covariance))
    x = x * rng.normal(size=15)
    readings, dt = [], 0.05
    for k in range(40):
        if k:
            after = np.empty(15)
            kernels.move(x, dt, 0.5, np.empty((3, 3)), after)
            x = after + np.sqrt(dt) * root * rng.normal(size=15)
        readings.append(twist(k * dt, x[6:12] + 0.02 * rng.normal(size=6), 4e-4))
        if k % 5 == 3:
            angles = x[3:6] + 0.02 * rng.normal(size=3)
            readings.append(
                pose(k * dt, at(x[:3] + 0.05 * rng.normal(size=3), angles), np.diag([25e-4] * 3 + [4e-4] * 3))
            )
    return x, readings


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_the_filter_is_as_sure_as_it_should_be(rng, kind):
    P = np.diag([0.01] * 3 + [0.01] * 3 + [0.5] * 3 + [0.1] * 3 + [0.1] * 3)
    settings = SpatialSettings((sensor(), sensor("pose", POSE)), filter=kind, initial_covariance=P)
    settings = replace(settings, process_noise=0.2 * settings.process_noise)
    values = []
    for _ in range(60):
        x, readings = truth_and_readings(rng, settings)
        e = estimate_in_space(recording(readings), settings)
        error = x[:6] - e.states[-1, :6]
        error[3:] = (error[3:] + np.pi) % (2 * np.pi) - np.pi
        values.append(error @ np.linalg.solve(e.state_covariance[-1], error))
    low, high = chi2_bounds(6, 60, 0.99)
    assert low < np.mean(values) < high
