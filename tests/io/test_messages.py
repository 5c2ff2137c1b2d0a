"""Messages say what the records say."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from longreach.errors import RecordingError
from longreach.geometry import so3
from longreach.io import messages, records
from longreach.io.frames import _matrix
from longreach.measurement import Imu, LaserScan, Odometry, PoseMeasurement

TYPES = get_typestore(Stores.ROS2_HUMBLE).types


@given(st.integers(0, 2**31 - 1), st.integers(0, 999_999_999))
def test_a_stamp_of_nanoseconds_survives_the_way_there_and_back(seconds, rest):
    stamp = (seconds * 10**9 + rest) / 10**9
    assert messages.nanoseconds(stamp) / 10**9 == stamp


@pytest.mark.parametrize("stamp", [-0.1, 2.0**31, math.nan, math.inf])
def test_a_time_that_ros_does_not_have_is_refused(stamp):
    with pytest.raises(RecordingError, match="ROS cannot hold the stamp"):
        messages.nanoseconds(stamp)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1.0, math.pi - 1e-7, math.pi])
def test_a_rotation_survives_its_quaternion(rng, size):
    axis = rng.normal(size=3)
    R = so3.exp(size * axis / np.linalg.norm(axis))
    q = messages.quaternion_xyzw(R)
    assert np.linalg.norm(q) == pytest.approx(1.0)
    np.testing.assert_allclose(_matrix(np.concatenate([np.zeros(3), 2.0 * q]))[:3, :3], R, atol=1e-12)


def test_the_heading_of_a_tilted_pose_is_the_turn_of_its_x_axis(rng):
    for _ in range(50):
        R = so3.from_roll_pitch_yaw(*rng.uniform(-1.5, 1.5, 3))
        q = TYPES["geometry_msgs/msg/Quaternion"](*(3.0 * messages.quaternion_xyzw(R)).tolist())
        pose = records.planar_pose(TYPES["geometry_msgs/msg/Point"](1.0, 2.0, 3.0), q)
        np.testing.assert_allclose(pose, [1.0, 2.0, math.atan2(R[1, 0], R[0, 0])], atol=1e-12)


def test_the_planar_part_of_a_covariance_is_x_y_and_the_turn_about_z():
    message = messages.pose_with_covariance(TYPES, 1.0, PoseMeasurement(1.0, np.zeros(3), np.eye(3)))
    message.pose.covariance = np.arange(36.0)
    _, covariance = records.stamped_pose(message)
    np.testing.assert_array_equal(covariance, np.arange(36.0).reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])])


@pytest.mark.parametrize("diagonal", [[0, 0, 0], [-1, 1, 1], [1, 1, math.nan]])
def test_a_covariance_left_at_zero_or_nonsense_is_unknown(diagonal):
    message = messages.odometry(TYPES, 1.0, Odometry(1.0, np.zeros(3), np.zeros(3)))
    message.twist.covariance[[0, 7, 35]] = diagonal
    message.pose.covariance[[0, 7, 35]] = [0.1, 0.2, 0.3]
    if diagonal[0] == -1:  # that alone would say that there is no twist
        message.twist.covariance[[0, 7, 35]] = [1, -1, 1]
    record = records.odometry(message)(stamp=1.0)
    assert record.twist_covariance is None
    np.testing.assert_array_equal(record.pose_covariance, np.diag([0.1, 0.2, 0.3]))


def test_numbers_that_are_none_are_left_out():
    odometry = messages.odometry(TYPES, 1.0, Odometry(1.0, np.zeros(3), np.array([0.0, math.nan, 0.0])))
    assert records.odometry(odometry)(stamp=1.0).twist is None
    odometry.pose.pose.position.x = math.inf
    assert records.odometry(odometry) == "has neither a pose nor a twist that is measured and finite"
    pose = messages.pose_stamped(TYPES, 1.0, np.array([0.0, math.nan, 0.0]))
    assert records.stamped_pose(pose) is None
    assert records.fix(pose) is None


def test_an_imu_that_says_it_measured_no_turn_is_left_out():
    message = messages.imu(TYPES, 1.0, Imu(1.0, np.ones(3), np.ones(3)))
    assert not isinstance(records.imu(message), str)
    message.angular_velocity_covariance[0] = -1
    assert records.imu(message) == "marks its angular velocity as not measured"


def test_a_fix_without_covariance_is_good_to_a_centimetre():
    known, make = records.fix(messages.pose_stamped(TYPES, 1.0, np.array([1.0, 2.0, 0.5])))
    found = make(stamp=1.0)
    assert not known
    np.testing.assert_allclose(found.covariance, 1e-4 * np.eye(3))


def test_a_fix_without_heading_does_not_measure_it():
    _, make = records.fix(messages.pose_stamped(TYPES, 1.0, np.array([1.0, 2.0, 0.5]), has_heading=False))
    found = make(stamp=1.0)
    np.testing.assert_array_equal(found.pose, [1.0, 2.0, 0.0])
    np.testing.assert_allclose(found.covariance, np.diag([1e-4, 1e-4, math.inf]))


def test_the_last_beam_of_a_scan_is_at_its_angle_max():
    scan = LaserScan(1.0, np.ones(5), -1.0, 0.25, 0.1, 9.0)
    message = messages.laser_scan(TYPES, 1.0, scan)
    assert message.angle_max == pytest.approx(scan.angles[-1])
