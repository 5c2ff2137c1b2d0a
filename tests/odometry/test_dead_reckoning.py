"""Dead reckoning: composition, the covariance's growth, and rows that nothing ends at."""

from itertools import pairwise

import numpy as np
import pytest

from longreach.errors import EstimationError
from longreach.geometry import se2
from longreach.measurement import RelativePoseMeasurement
from longreach.odometry.dead_reckoning import integrate

Q = np.diag([0.01, 0.02, 0.015]) ** 2


def steps(rng, stamps):
    return [RelativePoseMeasurement(a, b, rng.normal(0.0, 0.3, 3), Q) for a, b in pairwise(stamps)]


def test_a_chain_composes_and_carries_the_covariance_along(rng):
    stamps = [0.0, 0.5, 1.0, 1.7]
    measurements = steps(rng, stamps)
    start = np.array([3.0, -2.0, 1.0])
    path = integrate(measurements, stamps, start)
    pose, P = start, np.zeros((3, 3))
    for i, m in enumerate(measurements, 1):
        pose, A = se2.compose(pose, m.pose), se2.adjoint(se2.inverse(m.pose))
        P = A @ P @ A.T + Q
        np.testing.assert_allclose(path.poses[i], pose, atol=1e-14)
        np.testing.assert_allclose(path.covariance[i], P, atol=1e-16)
    np.testing.assert_array_equal(path.poses[0], start)
    np.testing.assert_array_equal(path.covariance[0], 0.0)
    np.testing.assert_array_equal(path.clock, stamps)


def test_the_covariance_of_a_chain_is_that_of_many_noisy_ones(rng):
    stamps = np.arange(21) * 0.1
    twist = np.array([0.1, 0.02, 0.1])
    L = np.linalg.cholesky(Q)
    path = integrate([RelativePoseMeasurement(a, b, se2.exp(twist), Q) for a, b in pairwise(stamps.tolist())], stamps)
    ends = np.zeros((20000, 3))
    for _ in stamps[1:]:
        ends = se2.compose(ends, se2.compose(se2.exp(twist), se2.exp(rng.normal(size=ends.shape) @ L.T)))
    errors = se2.difference(path.poses[-1], ends)
    whitened = np.linalg.solve(np.linalg.cholesky(path.covariance[-1]), errors.T)
    np.testing.assert_allclose(whitened @ whitened.T / len(ends), np.eye(3), atol=0.05)


def test_a_match_to_a_keyframe_starts_from_the_keyframes_row(rng):
    key, near = rng.normal(size=3), rng.normal(size=3)
    measurements = [RelativePoseMeasurement(0.0, 1.0, near, Q), RelativePoseMeasurement(0.0, 2.0, key, Q)]
    path = integrate(measurements, [0.0, 1.0, 2.0])
    np.testing.assert_allclose(path.poses[2], se2.exp(se2.log(key)), atol=1e-12)
    np.testing.assert_allclose(path.covariance[2], Q)


def test_a_row_that_nothing_ends_at_keeps_the_row_before(rng):
    measurements = steps(rng, [0.0, 1.0, 2.0, 3.0])
    path = integrate([measurements[0], measurements[2]], [0.0, 1.0, 1.0, 1.5, 2.0, 3.0])
    for row in (2, 3, 4):
        np.testing.assert_array_equal(path.poses[row], path.poses[1])
        np.testing.assert_array_equal(path.covariance[row], path.covariance[1])
    np.testing.assert_allclose(path.poses[5], se2.compose(path.poses[1], measurements[2].pose), atol=1e-14)


def test_no_rows_and_no_measurements_are_fine():
    assert len(integrate([], [])) == 0
    np.testing.assert_array_equal(integrate([], [1.0, 2.0]).poses, 0.0)


def test_rows_that_cannot_be_are_refused(rng):
    measurements = steps(rng, [0.0, 1.0, 2.0])
    with pytest.raises(EstimationError, match="run backwards"):
        integrate(measurements, [0.0, 2.0, 1.0])
    for stamps in ([0.0, 1.0], [0.0, 0.9, 2.0]):
        with pytest.raises(EstimationError, match="is not one of the path's"):
            integrate(measurements, stamps)
    with pytest.raises(EstimationError, match="earlier stamp"):
        integrate([RelativePoseMeasurement(1.0, 1.0, np.zeros(3), Q)], [0.0, 1.0])
