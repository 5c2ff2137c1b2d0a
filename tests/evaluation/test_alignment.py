from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from longreach.errors import LongreachError
from longreach.evaluation.alignment import Pairs, align_pairs, associate, moved, rigid_alignment
from longreach.geometry import se2
from longreach.trajectory import PoseTrajectory

MOTION = np.array([3.0, -4.0, 2.5])


def line(stamps, speed=1.0):
    stamps = np.asarray(stamps, dtype=float)
    return PoseTrajectory(stamps, np.stack((speed * stamps, 0 * stamps, 0 * stamps), axis=1))


@given(st.floats(-100, 100), st.floats(-100, 100), st.floats(-3.14, 3.14), st.integers(2, 30))
def test_alignment_recovers_a_known_motion(x, y, angle, n):
    points = np.random.default_rng(n).normal(size=(n, 2))
    motion = np.array([x, y, angle])
    found = rigid_alignment(points, se2.transform(motion, points))
    np.testing.assert_allclose(se2.difference(motion, found), 0, atol=1e-9)


def test_no_motion_near_the_one_found_is_better(rng):
    source, target = rng.normal(size=(40, 2)), rng.normal(size=(40, 2))
    found = rigid_alignment(source, target)

    def cost(motion):
        return np.sum((se2.transform(motion, source) - target) ** 2)

    for direction in (*np.eye(3), *-np.eye(3)):
        assert cost(found + 1e-4 * direction) > cost(found)


def test_points_on_a_line_are_turned_and_not_mirrored():
    source = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    np.testing.assert_allclose(rigid_alignment(source, source[:, ::-1]), [0, 0, np.pi / 2], atol=1e-12)


def test_one_point_gives_a_translation_alone():
    found = rigid_alignment(np.array([[1.0, 2.0]]), np.array([[4.0, -1.0]]))
    np.testing.assert_array_equal(found, [3.0, -3.0, 0.0])


def test_points_that_coincide_give_a_translation_alone():
    found = rigid_alignment(np.full((5, 2), 0.1), np.full((5, 2), 0.7))
    np.testing.assert_allclose(found, [0.6, 0.6, 0.0], atol=1e-12)


def test_no_points_give_the_identity():
    np.testing.assert_array_equal(rigid_alignment(np.zeros((0, 2)), np.zeros((0, 2))), np.zeros(3))


def test_equal_stamps_pair_without_interpolation(drive, disturb):
    estimate = disturb(drive)
    pairs = associate(estimate, drive)
    np.testing.assert_array_equal(pairs.clock, drive.clock)
    np.testing.assert_allclose(pairs.estimate, estimate.poses, atol=1e-15)
    np.testing.assert_allclose(pairs.truth, drive.poses, atol=1e-15)
    np.testing.assert_array_equal(pairs.covariance, estimate.covariance)


def test_the_denser_one_is_interpolated_whichever_it_is():
    dense, sparse = line(np.arange(0, 10, 0.1)), line([0.55, 3.33, 7.77])
    for pairs in (associate(dense, sparse), associate(sparse, dense)):
        np.testing.assert_allclose(pairs.clock, sparse.clock)
        np.testing.assert_allclose(pairs.estimate, pairs.truth, atol=1e-12)
        np.testing.assert_allclose(pairs.estimate[:, 0], sparse.clock, atol=1e-12)


def test_nothing_is_interpolated_across_a_long_gap():
    holed = line(np.concatenate((np.arange(0, 3, 0.1), np.arange(6, 9, 0.1))))
    sparse = line([1.05, 2.05, 4.05, 6.55])
    np.testing.assert_allclose(associate(holed, sparse).clock, [1.05, 2.05, 6.55])
    np.testing.assert_allclose(associate(holed, sparse, longest_gap=4.0).clock, [1.05, 2.05, 4.05, 6.55])


def test_a_reference_with_no_row_inside_the_others_span_is_interpolated():
    pairs = associate(line([2.2, 2.4]), line([2.0, 3.0]))
    np.testing.assert_allclose(pairs.clock, [2.2, 2.4])


def test_the_covariance_is_that_of_the_nearest_row():
    dense = line([0.0, 1.0, 2.0, 3.0])
    dense = replace(dense, covariance=np.arange(1.0, 5.0)[:, None, None] * np.eye(3))
    pairs = associate(dense, line([0.2, 2.9]))
    assert pairs.covariance is not None
    np.testing.assert_array_equal(pairs.covariance[:, 0, 0], [1.0, 4.0])


def test_rows_meet_by_recorded_stamps_that_run_backwards():
    recorded = np.array([0.0, 0.1, 0.2, 0.15, 0.25, 0.4, 0.5, 0.6])
    estimate = PoseTrajectory(recorded, np.stack((np.arange(8.0), np.zeros(8), np.zeros(8)), axis=1))
    rows = [1, 3, 6]
    truth = PoseTrajectory(recorded[rows], estimate.poses[rows])
    pairs = associate(estimate, truth)
    np.testing.assert_allclose(pairs.estimate, pairs.truth, atol=1e-12)
    np.testing.assert_array_equal(pairs.clock, estimate.clock[rows])


def test_trajectories_at_different_times_are_refused_with_both_spans():
    with pytest.raises(LongreachError, match=r"0\.000 to 9\.000 s.*100\.000 to 105\.000 s"):
        associate(line(np.arange(10)), line(np.arange(100, 106)))


def test_an_empty_trajectory_is_refused_by_name():
    with pytest.raises(LongreachError, match="The truth has no rows"):
        associate(line([0.0, 1.0]), line([]))


def test_rows_that_are_all_too_far_apart_are_refused():
    with pytest.raises(LongreachError, match="allow a longer gap"):
        associate(line([0.0, 10.0]), line([5.0, 15.0]))


def test_alignment_of_pairs_brings_a_moved_estimate_back(drive):
    estimate = moved(drive, MOTION)
    for align in ("rigid", "first"):
        pairs, motion = align_pairs(associate(estimate, drive), align)
        np.testing.assert_allclose(se2.difference(pairs.truth, pairs.estimate), 0, atol=1e-9)
        np.testing.assert_allclose(se2.compose(motion, MOTION), 0, atol=1e-9)


def test_first_poses_cannot_be_aligned_without_headings(drive):
    pairs = associate(drive, replace(drive, has_heading=False))
    with pytest.raises(LongreachError, match="positions only"):
        align_pairs(pairs, "first")


def test_pairs_cannot_be_written_to():
    pairs = Pairs(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="read-only"):
        pairs.estimate[0] = 1.0
