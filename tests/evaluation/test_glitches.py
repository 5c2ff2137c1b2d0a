from dataclasses import replace

import numpy as np

from longreach.evaluation.glitches import drop_glitches
from longreach.trajectory import PoseTrajectory


def straight(n=200, rate=100.0, speed=0.5):
    t = np.arange(n) / rate
    return PoseTrajectory(t, np.stack((speed * t, 0 * t, 0 * t), axis=1))


def with_rows(trajectory, rows, poses):
    changed = trajectory.poses.copy()
    changed[rows] = poses
    return replace(trajectory, poses=changed)


def test_a_clean_path_stays_as_it_is():
    kept, count = drop_glitches(straight(), 1.0)
    assert count == 0
    np.testing.assert_array_equal(kept.poses, straight().poses)


def test_rows_out_of_place_are_dropped_at_once_or_in_a_run():
    truth = with_rows(straight(), [50, 120, 121, 122], [[3.0, 1.0, 0.0]] * 4)
    kept, count = drop_glitches(truth, 1.0)
    assert count == 4
    np.testing.assert_array_equal(kept.stamps, np.delete(truth.stamps, [50, 120, 121, 122]))


def test_a_run_that_itself_jumps_is_dropped_whole():
    truth = with_rows(straight(), [50, 51, 52], [[3.0, 1.0, 0.0], [-2.0, 1.0, 0.0], [5.0, 0.0, 0.0]])
    assert drop_glitches(truth, 1.0)[1] == 3


def test_a_jump_that_stays_is_kept():
    truth = straight()
    moved = with_rows(truth, slice(100, None), truth.poses[100:] + np.array([0.0, 1.0, 0.0]))
    assert drop_glitches(moved, 1.0)[1] == 0


def test_a_pose_held_until_a_jump_is_dropped_but_for_its_first_row():
    truth = straight()
    held = with_rows(truth, slice(81, 95), truth.poses[80])
    kept, count = drop_glitches(held, 1.0)
    assert count == 14
    np.testing.assert_array_equal(kept.poses, np.delete(truth.poses, slice(81, 95), axis=0))


def test_standing_still_is_no_glitch():
    truth = with_rows(straight(), slice(0, 100), straight().poses[99])
    assert drop_glitches(truth, 1.0)[1] == 0


def test_steps_within_the_noise_are_no_jumps_however_near_their_stamps(rng):
    stamps = np.sort(rng.uniform(0, 1, size=2000))
    truth = PoseTrajectory(stamps, rng.uniform(-0.005, 0.005, size=(2000, 3)))
    assert drop_glitches(truth, 1.0)[1] == 0


def test_the_covariance_keeps_step_with_the_rows():
    truth = with_rows(straight(), [50], [[3.0, 1.0, 0.0]])
    truth = replace(truth, covariance=np.arange(1.0, 201.0)[:, None, None] * np.eye(3))
    kept, _ = drop_glitches(truth, 1.0)
    assert kept.covariance is not None
    np.testing.assert_array_equal(kept.covariance[49:51, 0, 0], [50.0, 52.0])


def test_short_trajectories_are_taken_as_they_are():
    for n in range(3):
        assert drop_glitches(straight(n), 1.0)[1] == 0
