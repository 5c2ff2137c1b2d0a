from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from longreach.errors import LongreachError
from longreach.evaluation.alignment import associate, moved
from longreach.evaluation.consistency import PoseErrors, chi2_bounds, consistency_metrics, nees, nis, pose_errors
from longreach.geometry import se2


def test_bounds_are_the_quantiles_of_chi_squared():
    for dof, samples in ((3, 1), (2, 50), (6, 100)):
        np.testing.assert_allclose(chi2_bounds(dof, samples), chi2.ppf([0.025, 0.975], dof * samples) / samples)
    np.testing.assert_allclose(chi2_bounds(1, 1, 0.5), chi2.ppf([0.25, 0.75], 1))


def test_bounds_without_samples_are_refused():
    with pytest.raises(LongreachError, match="positive"):
        chi2_bounds(3, 0)


def gaussian_errors(rng, n=2000, scale=1.0):
    A = rng.normal(size=(n, 3, 3)) * np.array([1.0, 0.1, 0.01])[:, None]
    P = A @ A.swapaxes(1, 2) + 1e-6 * np.eye(3)
    xi = (np.linalg.cholesky(P) @ rng.normal(size=(n, 3, 1)))[..., 0]
    return PoseErrors(np.arange(float(n)), xi, scale * P)


def test_errors_drawn_from_the_stated_gaussian_are_inside_the_bounds(rng):
    found = nees(gaussian_errors(rng))
    assert found.skipped == 0
    assert found.bounds[0] < found.mean < found.bounds[1]
    assert found.inside == pytest.approx(0.95, abs=0.02)


def test_a_covariance_that_is_four_times_too_small_shows_as_four_times_the_nees(rng):
    errors = gaussian_errors(rng)
    small = replace(errors, covariance=errors.covariance / 4)
    np.testing.assert_allclose(nees(small).values, 4 * nees(errors).values)
    assert nees(small).mean > nees(small).bounds[1]


def test_the_error_is_the_one_whose_covariance_is_stated(drive, disturb):
    estimate = disturb(drive)
    errors = pose_errors(associate(estimate, drive), relative_to_start=False)
    np.testing.assert_allclose(se2.difference(se2.retract(estimate.poses, errors.xi), drive.poses), 0, atol=1e-9)
    found = nees(errors)
    assert len(found.values) == len(drive)
    assert found.bounds[0] < found.mean < found.bounds[1]


def test_relative_to_the_start_the_frame_of_the_estimate_does_not_matter(drive, disturb):
    estimate = disturb(drive)
    here, there = (pose_errors(associate(e, drive)) for e in (estimate, moved(estimate, np.array([9.0, 8.0, 7.0]))))
    np.testing.assert_allclose(here.xi, there.xi, atol=1e-9)
    np.testing.assert_allclose(here.xi[0], 0, atol=1e-12)


def test_rows_that_cannot_be_inverted_are_skipped_and_counted(rng):
    errors = gaussian_errors(rng, 6)
    P, xi = errors.covariance.copy(), errors.xi.copy()
    P[0] = 0
    P[1, 0, 0] = np.nan
    P[2] = np.ones((3, 3))
    P[3] = np.diag([1.0, -1.0, 1.0])
    xi[4] = np.inf
    found = nees(PoseErrors(errors.clock, xi, P))
    assert found.skipped == 5
    np.testing.assert_array_equal(found.clock, [5.0])
    assert np.all(np.isfinite(found.values))


def test_a_corridor_known_well_across_and_hardly_along_is_not_singular():
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    P = turn @ np.diag([1e4, 1e-6, 1e-6]) @ turn.T
    found = nees(PoseErrors(np.zeros(1), (turn @ np.array([100.0, 1e-3, 0.0]))[None], P[None]))
    assert found.values[0] == pytest.approx(2.0, rel=1e-4)


def test_what_cannot_be_compared_is_refused_in_words(drive, disturb):
    with pytest.raises(LongreachError, match="no covariance"):
        pose_errors(associate(drive, drive))
    with pytest.raises(LongreachError, match="positions only"):
        pose_errors(associate(disturb(drive), replace(drive, has_heading=False)))


def test_innovations_are_sorted_by_source_and_anchors_left_out(rng):
    values = np.concatenate((rng.chisquare(3, 500), rng.chisquare(2, 500), [0.0, np.nan]))
    sources = ["wheels"] * 500 + ["gps"] * 500 + ["lidar", "gps"]
    found = nis(np.arange(1002.0), sources, values, [3] * 500 + [2] * 500 + [0, 2])
    assert list(found) == ["wheels", "gps"]
    assert (len(found["gps"].values), found["gps"].skipped) == (500, 1)
    for c in found.values():
        assert c.bounds[0] < c.mean < c.bounds[1]
        assert c.inside == pytest.approx(0.95, abs=0.03)


def test_nothing_to_compare_gives_unknown_metrics():
    found = nees(PoseErrors(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3, 3))))
    metrics = consistency_metrics("nees", found)
    assert metrics["nees_mean"]["value"] is None
    assert metrics["nees_upper"]["value"] is None
    assert metrics["nees_rows"]["value"] == 0
