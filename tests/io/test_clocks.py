"""Stamps of several topics on one clock: other origins, clocks that are set, coarse clocks, blocks, outliers."""

import numpy as np
import pytest

from longreach.io.clocks import Stamped, on_one_clock

T = 1.7e9 + np.arange(0.0, 20.0, 0.02)


def stamped(topic, stamps, way=0.01, at=T):
    return Stamped(topic, np.asarray(stamps, dtype=float), at + way)


def others():
    return {"wheels": stamped("/odom", T), "lidar": stamped("/scan", T[::5], 0.02, T[::5])}


def test_stamps_on_one_clock_stay_bit_for_bit():
    stamps, remarks = on_one_clock(others())
    np.testing.assert_array_equal(stamps["wheels"], T)
    np.testing.assert_array_equal(stamps["lidar"], T[::5])
    assert remarks == []


@pytest.mark.parametrize("off", [-1.7e9 + 75.0, 3600.0, -20.0, 0.5])
def test_a_topic_on_another_clock_is_moved_to_that_of_the_others_and_said(off):
    stamps, (remark,) = on_one_clock({**others(), "imu": stamped("/imu", T + off, 0.003)})
    np.testing.assert_allclose(stamps["imu"], T, atol=0.015)
    np.testing.assert_array_equal(stamps["wheels"], T)
    assert remark.startswith("/imu is on another clock")


def test_a_topic_that_is_recorded_late_keeps_its_stamps_for_they_may_be_right():
    stamps, (remark,) = on_one_clock({**others(), "imu": stamped("/imu", T, 1.9)})
    np.testing.assert_array_equal(stamps["imu"], T)
    assert "recorded 1.90 s after their stamps" in remark


@pytest.mark.parametrize("by", [-5.0, -0.5, 0.4, 3600.0])
def test_a_clock_that_is_set_for_all_topics_is_set_back_once_and_said_once(by):
    set_at = T[400]
    topics = {role: one._replace(header=one.header + by * (one.header >= set_at)) for role, one in others().items()}
    stamps, remarks = on_one_clock(topics)
    np.testing.assert_allclose(stamps["wheels"], T, atol=1e-6)
    np.testing.assert_allclose(stamps["lidar"], T[::5], atol=1e-6)
    assert [remark for remark in remarks if "was set by" in remark and "/odom, /scan" in remark]


def test_messages_of_one_topic_that_come_later_from_some_time_on_keep_their_stamps():
    late = T + 0.01 + 1.0 * (T[500] < T)
    stamps, _ = on_one_clock({**others(), "imu": Stamped("/imu", T, late)})
    np.testing.assert_array_equal(stamps["imu"], T)


def test_a_queue_that_is_held_up_and_runs_empty_is_no_clock_that_was_set():
    received = np.maximum(T + 0.01, np.where((T[300] < T) & (T[400] > T), T[400], 0.0))
    stamps, remarks = on_one_clock({"wheels": Stamped("/odom", T, received), "lidar": others()["lidar"]})
    np.testing.assert_array_equal(stamps["wheels"], T)
    assert remarks == []


def test_a_clock_of_whole_tenths_is_replaced_by_the_times_of_recording():
    coarse = np.floor(10.0 * T) / 10.0
    stamps, (remark,) = on_one_clock({**others(), "imu": stamped("/imu", coarse, 0.003)})
    np.testing.assert_allclose(stamps["imu"], T, atol=0.005)
    assert "equal to the one before" in remark


def test_blocks_with_one_stamp_are_spread_over_the_time_before_it():
    block = np.repeat(T[4::5], 5)
    received = block + 0.01 + 1e-6 * np.tile(np.arange(5), len(block) // 5)
    stamps, (remark,) = on_one_clock({**others(), "imu": Stamped("/imu", block, received)})
    np.testing.assert_allclose(stamps["imu"], T, atol=1e-6)
    assert "spread" in remark


def test_stamps_that_run_backwards_are_taken_from_the_times_of_recording(rng):
    wrong = T - 0.15 * (rng.random(len(T)) < 0.05)
    stamps, (remark,) = on_one_clock({**others(), "imu": stamped("/imu", wrong)})
    np.testing.assert_allclose(stamps["imu"], T, atol=1e-6)
    assert "run backwards" in remark


def test_times_of_recording_that_are_all_one_number_say_nothing():
    topics = {role: one._replace(received=np.zeros(len(one.header))) for role, one in others().items()}
    topics["imu"] = Stamped("/imu", T - 1e9, np.zeros(len(T)))
    stamps, remarks = on_one_clock(topics)
    np.testing.assert_array_equal(stamps["imu"], T - 1e9)
    assert remarks == []


def test_the_clock_of_recording_takes_the_place_of_all_stamps_when_asked_for():
    stamps, remarks = on_one_clock({"imu": stamped("/imu", T - 1e9)}, "record")
    np.testing.assert_array_equal(stamps["imu"], T + 0.01)
    assert remarks == []
