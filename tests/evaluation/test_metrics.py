from dataclasses import replace

import numpy as np
import pytest

from longreach.errors import LongreachError
from longreach.evaluation.alignment import Pairs, associate, moved
from longreach.evaluation.metrics import (
    absolute_metrics,
    ate,
    mse_over_time,
    relative_metrics,
    rpe_over_distance,
    rpe_over_time,
    stretches,
)
from longreach.evaluation.statistics import statistics


def test_equal_trajectories_have_no_error(drive):
    pairs = associate(drive, drive)
    for align in ("rigid", "first", "none"):
        errors = ate(pairs, align)
        assert errors.heading is not None
        np.testing.assert_allclose(errors.position, 0, atol=1e-12)
        np.testing.assert_allclose(errors.heading, 0, atol=1e-12)
    for relative in (*rpe_over_distance(pairs, [1.0]).values(), *rpe_over_time(pairs, [1.0]).values()):
        assert len(relative.start) > 10
        np.testing.assert_allclose(relative.translation, 0, atol=1e-12)
        np.testing.assert_allclose(relative.rotation, 0, atol=1e-12)


def test_errors_do_not_see_a_rigid_motion_of_the_estimate(drive, disturb):
    estimate = disturb(drive)
    before, after = (associate(e, drive) for e in (estimate, moved(estimate, np.array([20.0, -7.0, 2.9]))))
    for align in ("rigid", "first"):
        a, b = ate(before, align), ate(after, align)
        assert a.heading is not None
        assert b.heading is not None
        np.testing.assert_allclose(a.position, b.position, atol=1e-9)
        np.testing.assert_allclose(a.heading, b.heading, atol=1e-9)
    a, b = (rpe_over_distance(pairs, [2.0])[2.0] for pairs in (before, after))
    np.testing.assert_allclose(a.translation, b.translation, atol=1e-9)
    assert np.max(np.abs(ate(after, "none").position - ate(before, "none").position)) > 1.0


def test_rigid_alignment_gives_the_smallest_rmse(drive, disturb):
    pairs = associate(disturb(drive), drive)
    rmse = {align: statistics(ate(pairs, align).position).rmse for align in ("rigid", "first", "none")}
    assert rmse["rigid"] < rmse["none"] < rmse["first"]


def test_a_heading_error_is_signed_and_wraps():
    poses = np.array([[0.0, 0.0, 3.1], [1.0, 0.0, -3.1]])
    pairs = Pairs(np.arange(2.0), poses, poses * [1, 1, -1])
    heading = ate(pairs, "none").heading
    np.testing.assert_allclose(heading, [6.2 - 2 * np.pi, 2 * np.pi - 6.2], atol=1e-12)


def test_a_scaled_path_errs_by_the_same_part_of_every_length():
    x = np.linspace(0, 20, 201)
    truth = np.stack((x, 0 * x, 0 * x), axis=1)
    errors = rpe_over_distance(Pairs(x, truth * [1.03, 1, 1], truth), [1.0, 5.0], tolerance=1e-6)
    for length, relative in errors.items():
        np.testing.assert_allclose(relative.translation, 0.03 * length, rtol=1e-9)
        assert len(relative.start) == 201 - round(length * 10)


def test_stretches_end_to_end_do_not_overlap_and_reach_their_length(rng):
    along = np.cumsum(rng.exponential(size=500))
    start, end = stretches(along, 7.0, all_pairs=False)
    np.testing.assert_array_equal(start[1:], end[:-1])
    assert np.all(along[end] - along[start] >= 7.0 - 1e-5)
    assert np.all(along[end - 1] - along[start] < 7.0)


def test_rounding_does_not_lengthen_a_stretch():
    start, end = stretches(np.cumsum(np.full(100, 0.1)), 1.0, all_pairs=False)
    np.testing.assert_array_equal(end - start, 10)


def test_all_pairs_are_the_nearest_within_the_tolerance(rng):
    along = np.concatenate((np.zeros(3), np.cumsum(rng.exponential(size=300))))
    start, end = stretches(along, 5.0, tolerance=0.1)
    for i, j in zip(start, end, strict=True):
        off = np.abs(along[i + 1 :] - along[i] - 5.0)
        assert off.min() <= 0.5
        assert j == i + 1 + np.argmin(off)
    off = [np.min(np.abs(along[i + 1 :] - along[i] - 5.0), initial=np.inf) for i in range(len(along))]
    assert len(start) == np.sum(np.array(off) <= 0.5)


def test_of_two_rows_equally_near_the_earlier_is_taken():
    np.testing.assert_array_equal(stretches(np.arange(6.0), 1.5, tolerance=0.5)[1], [1, 2, 3, 4, 5])


@pytest.mark.parametrize("all_pairs", [True, False])
@pytest.mark.parametrize("n", [0, 1, 3])
def test_a_path_that_is_too_short_has_no_stretches(n, all_pairs):
    start, end = stretches(np.arange(float(n)), 10.0, all_pairs=all_pairs)
    assert len(start) == len(end) == 0


def test_a_robot_that_stands_has_no_stretches_over_distance():
    pairs = Pairs(np.arange(9.0), np.zeros((9, 3)), np.zeros((9, 3)))
    assert len(rpe_over_distance(pairs, [1.0])[1.0].start) == 0


def test_relative_errors_need_headings(drive):
    pairs = associate(drive, replace(drive, has_heading=False))
    with pytest.raises(LongreachError, match="compare relative poses"):
        rpe_over_time(pairs, [1.0])


def test_the_running_mean_ends_at_the_mean_squared_error(drive, disturb):
    squared = mse_over_time(associate(disturb(drive), drive), "none")
    assert squared.heading is not None
    assert squared.heading_mean is not None
    assert squared.position_mean[-1] == pytest.approx(np.mean(squared.position))
    assert squared.heading_mean[-1] == pytest.approx(np.mean(squared.heading))
    assert squared.position_mean[0] == squared.position[0]


def test_metrics_are_in_metres_and_degrees(drive):
    turned = replace(drive, poses=drive.poses + np.array([0.0, 0.3, np.radians(2.0)]))
    metrics = absolute_metrics(ate(associate(turned, drive), "none"))
    assert metrics["ate_rmse"]["value"] == pytest.approx(0.3)
    assert metrics["ate_rmse"]["unit"] == "m"
    assert metrics["heading_rms"]["value"] == pytest.approx(2.0)
    assert metrics["heading_rms"]["unit"] == "deg"
    assert metrics["pairs"] == {"value": len(drive), "unit": ""}


def test_without_headings_there_is_no_heading_metric(drive):
    pairs = associate(drive, replace(drive, has_heading=False))
    assert "heading_rms" not in absolute_metrics(ate(pairs))
    assert mse_over_time(pairs, "rigid").heading_mean is None


def test_a_length_that_was_never_driven_is_unknown_and_not_nan(drive):
    metrics = relative_metrics(rpe_over_distance(associate(drive, drive), [1e4]), "m")
    assert metrics["rpe_10000m_translation_mean"] == {"value": None, "unit": "m"}
