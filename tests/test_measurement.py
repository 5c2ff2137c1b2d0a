import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from longreach import measurement as m
from longreach.errors import RecordingError

TWIST, PLANE = np.zeros(3), np.eye(3)

RECORDS = {
    "LaserScan": lambda stamp: m.LaserScan(stamp, np.ones(4), -0.5, 0.25),
    "WheelSpeeds": lambda stamp: m.WheelSpeeds(stamp, np.ones(4)),
    "WheelTicks": lambda stamp: m.WheelTicks(stamp, np.ones(2)),
    "Odometry": lambda stamp: m.Odometry(stamp, TWIST),
    "Imu": lambda stamp: m.Imu(stamp, np.ones(3), np.ones(3)),
    "TwistMeasurement": lambda stamp: m.TwistMeasurement(stamp, TWIST, PLANE),
    "PoseMeasurement": lambda stamp: m.PoseMeasurement(stamp, TWIST, PLANE),
    "RelativePoseMeasurement": lambda stamp: m.RelativePoseMeasurement(0.0, stamp, TWIST, PLANE),
    "Wrench": lambda stamp: m.Wrench(stamp, np.ones(3), np.ones(3)),
    "JointState": lambda stamp: m.JointState(stamp, ("a",), np.ones(1), np.zeros(0), np.zeros(0)),
}


def test_every_record_is_tested():
    defined = {
        n for n, c in vars(m).items() if isinstance(c, type) and issubclass(c, m._Stamped) and c is not m._Stamped
    }
    assert defined == set(RECORDS)


@pytest.mark.parametrize("kind", RECORDS)
def test_a_record_cannot_be_changed(kind):
    record = RECORDS[kind](1.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        record.stamp = 2.0
    for name in record._shapes:
        array = getattr(record, name)
        if array is not None and array.size:
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1.0


@pytest.mark.parametrize("kind", RECORDS)
@pytest.mark.parametrize("stamp", [np.nan, np.inf, -np.inf])
def test_a_stamp_that_is_no_number_is_refused(kind, stamp):
    with pytest.raises(RecordingError, match=f"{kind} has the stamp.*finite number of seconds"):
        RECORDS[kind](float(stamp))


@pytest.mark.parametrize("kind", RECORDS)
def test_a_stamp_in_nanoseconds_is_recognised(kind):
    with pytest.raises(RecordingError, match="looks like nanoseconds"):
        RECORDS[kind](1.7e18)


def test_a_record_keeps_its_own_copy():
    speeds = np.ones(4)
    record = m.WheelSpeeds(0.0, speeds)
    speeds[0] = 5.0
    assert record.speeds[0] == 1.0


def test_an_array_of_the_wrong_shape_is_named_with_what_was_expected():
    with pytest.raises(RecordingError, match=r"Imu.acceleration has shape \(2,\), expected \(3\)"):
        m.frozen_array([1.0, 2.0], (3,), "Imu.acceleration")
    with pytest.raises(RecordingError, match=r"has shape \(4,\), expected \(any, 3\)"):
        m.frozen_array(np.ones(4), (None, 3), "poses")


def test_beams_point_where_angle_min_and_increment_say_for_any_field_of_view():
    scan = m.LaserScan(0.0, np.ones(3), angle_min=0.1, angle_increment=-0.2)
    assert_allclose(scan.angles, [0.1, -0.1, -0.3])


@pytest.mark.parametrize(("angle_min", "increment"), [(np.nan, 0.1), (0.0, np.inf), (0.0, 0.0)])
def test_a_scan_whose_beams_point_nowhere_is_refused(angle_min, increment):
    with pytest.raises(RecordingError, match="both must be finite and the increment not zero"):
        m.LaserScan(0.0, np.ones(3), float(angle_min), float(increment))


def test_what_is_no_return_counts_as_zero():
    ranges = np.array([1.0, 0.0, -1.0, np.nan, np.inf, -np.inf, 0.05, 10.0, 10.1])
    scan = m.LaserScan(0.0, ranges, 0.0, 0.1, range_min=0.06, range_max=10.0)
    assert_array_equal(scan.returns, [1, 0, 0, 0, 0, 0, 0, 10, 0])
    assert_array_equal(scan.ranges, ranges)
    scan.returns[0] = 7.0  # a fresh array, the caller's own
    assert scan.returns[0] == 1.0


def test_infinity_is_no_return_even_without_a_longest_range():
    assert_array_equal(m.LaserScan(0.0, np.array([np.inf, 500.0]), 0.0, 0.1).returns, [0, 500])


def test_a_scan_without_beams_is_a_scan():
    scan = m.LaserScan(0.0, np.zeros(0), 0.0, 0.1)
    assert len(scan.angles) == len(scan.returns) == 0


def test_odometry_may_have_a_pose_or_a_twist_or_both():
    assert m.Odometry(0.0, twist=TWIST).pose is None
    assert m.Odometry(0.0, pose=TWIST).twist is None


def test_a_recording_gives_stamps_back_as_they_were_recorded():
    recording = m.Recording("run", recorded_stamps={1.25: 0.5})
    assert_array_equal(recording.as_recorded(np.array([1.0, 1.25])), [1.0, 0.5])
    stamps = np.array([1.0, 2.0])
    assert m.Recording("run").as_recorded(stamps) is stamps


def test_a_recording_is_changed_by_making_another():
    recording = m.Recording("run")
    other = recording.replace(remarks=("Two stamps were repaired.",))
    assert recording.remarks == ()
    assert other.remarks == ("Two stamps were repaired.",)
    assert other.name == "run"


def test_an_unknown_field_of_a_recording_is_named():
    with pytest.raises(RecordingError, match="no lidars, wheel"):
        m.Recording("run").replace(wheel=(), lidars=())


def test_a_step_between_two_readings_may_say_how_good_a_reading_is():
    without = m.RelativePoseMeasurement(0.0, 1.0, TWIST, np.eye(3))
    assert without.reading_covariance is None
    R = 0.1 * np.eye(3)
    step = m.RelativePoseMeasurement(0.0, 1.0, TWIST, np.eye(3), "wheels", R)
    R[0, 0] = 7.0
    assert step.reading_covariance[0, 0] == 0.1
    with pytest.raises(ValueError, match="read-only"):
        step.reading_covariance[0, 0] = 1.0
