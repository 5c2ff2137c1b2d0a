"""The doctor: what it puts right, what it leaves out, and that it has nothing to say of a good recording."""

import numpy as np
import pytest

from longreach.app.doctor import examine
from longreach.geometry import so3
from longreach.measurement import Imu, LaserScan, Odometry, Recording
from longreach.robot.description import ImuSensor, RobotDescription

ROBOT = RobotDescription(name="r", drive="differential", imu=ImuSensor())
G = 9.80665


def imu(rng, n=200, turn=1.0, felt=(0.0, 0.0, G)):
    return tuple(
        Imu(0.01 * i, turn * np.array([0.0, 0.0, np.sin(0.05 * i)]), np.array(felt) + rng.normal(0, 0.05, 3))
        for i in range(n)
    )


def scans(rng, n=120):
    made = []
    for i in range(n):
        ranges = 3.0 + 2.0 * np.sin(np.linspace(0, 5, 181) + 0.1 * i) + rng.normal(0, 0.01, 181)
        made.append(LaserScan(0.1 * i, ranges, -1.5, 0.0167, 0.05, 20.0))
    return tuple(made)


def odometry(n=200, twist=lambda i: np.array([0.5, 0.0, 0.4])):
    return tuple(Odometry(0.02 * i, twist=twist(i)) for i in range(n))


def found(T=None, **sensors):
    return examine(Recording("made", **sensors), ROBOT, np.eye(4) if T is None else T)


def test_of_a_good_recording_there_is_nothing_to_say(rng):
    recording = Recording("made", wheels=odometry(), scans=scans(rng), imu=imu(rng))
    same, remarks = examine(recording, ROBOT, np.eye(4))
    assert remarks == ()
    assert same is recording


@pytest.mark.parametrize(
    ("felt", "words"),
    [
        ((0.0, 0.0, 0.0), "no gravity in them"),
        ((0.0, 0.0, -G), "downwards"),
        ((0.0, 0.0, 5.0), "where gravity is 9.81"),
        ((1e-9, 0.0, 0.0), "no gravity in them"),
    ],
)
def test_accelerations_that_are_no_specific_force_are_left_out_and_the_gyro_stays(rng, felt, words):
    readings = imu(rng, felt=felt)
    changed, (remark,) = found(imu=readings)
    assert words in remark
    assert all(one.acceleration is None for one in changed.imu)
    np.testing.assert_array_equal(changed.imu[7].angular_velocity, readings[7].angular_velocity)


def test_accelerations_that_are_zero_or_never_change_were_not_measured():
    for felt, words in ((np.zeros(3), "no accelerometer"), (np.array([0.0, 0.0, G]), "same number")):
        readings = tuple(Imu(0.01 * i, np.array([0.0, 0.0, 0.1]), felt) for i in range(50))
        changed, (remark,) = found(imu=readings)
        assert words in remark
        assert changed.imu[0].acceleration is None


def test_accelerations_in_g_become_metres(rng):
    readings = tuple(
        Imu(0.01 * i, np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, 1.0]) + rng.normal(0, 0.01, 3)) for i in range(100)
    )
    changed, (remark,) = found(imu=readings)
    assert "taken in g" in remark
    np.testing.assert_allclose(changed.imu[3].acceleration, G * readings[3].acceleration)


@pytest.mark.parametrize("roll", [np.pi / 2, -np.pi / 2, np.pi / 4])
def test_where_gravity_leans_the_turns_are_taken_about_gravity(rng, roll):
    R = so3.from_roll_pitch_yaw(roll, 0.0, 0.0)  # of the IMU in the base, which nobody says
    true = imu(rng)
    felt = tuple(Imu(one.stamp, R.T @ one.angular_velocity, R.T @ one.acceleration) for one in true)
    changed, (remark,) = found(imu=felt)
    assert "Gravity leans" in remark
    np.testing.assert_allclose(
        [one.angular_velocity[2] for one in changed.imu], [one.angular_velocity[2] for one in true], atol=0.01
    )


def test_a_mount_that_says_how_the_imu_stands_is_no_finding(rng):
    T = np.eye(4)
    T[:3, :3] = so3.from_roll_pitch_yaw(np.pi, 0.0, 0.3)
    felt = tuple(Imu(one.stamp, T[:3, :3].T @ one.angular_velocity, T[:3, :3].T @ one.acceleration) for one in imu(rng))
    assert found(T, imu=felt)[1] == ()


def test_a_gyro_in_degrees_becomes_radians(rng):
    changed, (remark,) = found(imu=imu(rng, turn=np.degrees(1.0)))
    assert "degrees a second" in remark
    assert max(abs(one.angular_velocity[2]) for one in changed.imu) == pytest.approx(1.0, abs=0.01)


def test_a_gyro_that_says_nothing_is_left_out(rng):
    changed, (remark,) = found(imu=imu(rng, turn=0.0))
    assert "no gyro" in remark
    assert changed.imu == ()


def test_ranges_in_millimetres_become_metres(rng):
    true = scans(rng)
    changed, (remark,) = found(
        scans=tuple(LaserScan(s.stamp, 1000.0 * s.ranges, -1.5, 0.0167, 50.0, 20000.0) for s in true)
    )
    assert "millimetres" in remark
    np.testing.assert_allclose(changed.scans[3].returns, true[3].returns)


def test_angles_in_degrees_become_radians(rng):
    changed, (remark,) = found(
        scans=tuple(LaserScan(s.stamp, s.ranges, np.degrees(-1.5), np.degrees(0.0167)) for s in scans(rng))
    )
    assert "degrees" in remark
    assert (changed.scans[0].angle_min, changed.scans[0].angle_increment) == pytest.approx((-1.5, 0.0167))


def test_beams_that_see_the_robot_itself_are_left_out_but_not_of_a_robot_that_stands(rng):
    def with_post(scan):
        ranges = scan.ranges.copy()
        ranges[20:30] = 0.4 + rng.normal(0, 0.003, 10)
        return LaserScan(scan.stamp, ranges, -1.5, 0.0167, 0.05, 20.0)

    moving = scans(rng)
    changed, (remark,) = found(scans=tuple(with_post(scan) for scan in moving))
    assert "10 of 181 beams, between number 20 and 29" in remark
    assert not changed.scans[5].returns[20:30].any()
    assert np.count_nonzero(changed.scans[5].returns) == 171
    near = (LaserScan(0.1 * i, 0.5 + rng.normal(0, 0.003, 181), -1.5, 0.0167) for i in range(120))
    assert found(scans=tuple(near))[1] == ()


def test_scans_that_repeat_are_left_out(rng):
    made = scans(rng)
    hung = tuple(
        LaserScan(s.stamp, made[50].ranges if 50 <= i < 60 else s.ranges, -1.5, 0.0167) for i, s in enumerate(made)
    )
    changed, remarks = found(scans=hung)
    assert "9 scans repeat" in remarks[0]
    assert len(changed.scans) == 111


def test_a_twist_in_the_axes_of_odom_is_turned_into_those_of_the_base():
    def in_odom(i):
        theta = 0.4 * 0.02 * i
        return np.array([0.5 * np.cos(theta), 0.5 * np.sin(theta), 0.4])

    changed, (remark,) = found(wheels=odometry(400, in_odom))
    assert "axes of the odometry's frame" in remark
    np.testing.assert_allclose([one.twist for one in changed.wheels], np.tile([0.5, 0.0, 0.4], (400, 1)), atol=1e-9)


def test_gaps_and_sensors_of_another_time_are_said(rng):
    early = imu(rng)
    late = tuple(Odometry(one.stamp + 1000.0, twist=one.twist) for one in odometry())
    remarks = found(imu=early, wheels=late)[1]
    assert any("another time than" in remark for remark in remarks)
    broken = tuple(one for one in odometry(400) if not 2.0 < one.stamp < 5.0)
    assert "the longest of 3.0" in found(wheels=broken)[1][0]


def test_wheels_that_never_turn_are_said():
    still = tuple(Odometry(0.02 * i, pose=np.zeros(3)) for i in range(100))
    assert "never change" in found(wheels=still)[1][0]
