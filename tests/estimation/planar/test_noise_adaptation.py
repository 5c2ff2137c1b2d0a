"""What of a match's covariance is its own."""

import numpy as np
import pytest

from longreach.estimation.planar._measurement_kernels import own_part
from longreach.geometry import se2

POSE = np.array([0.4, -0.2, 0.5])


def definite(rng):
    A = rng.standard_normal((3, 3))
    return A @ A.T


def test_a_small_common_part_is_taken_off_as_it_is(rng):
    C, shared, out = definite(rng), 1e-3 * definite(rng), np.empty((3, 3))
    A = se2.adjoint(se2.inverse(POSE))
    shared *= 0.5 / np.linalg.eigvals(np.linalg.solve(C, A @ shared @ A.T)).real.max()
    assert own_part(C, POSE, shared, 0.05, out)
    np.testing.assert_allclose(out, C - A @ shared @ A.T, atol=1e-12)


@pytest.mark.parametrize("factor", [1.0, 30.0])
def test_something_is_left_in_every_direction_and_nowhere_more_than_all(factor, rng):
    C, out = definite(rng), np.empty((3, 3))
    assert own_part(C, POSE, factor * definite(rng), 0.05, out)
    parts = np.linalg.eigvals(np.linalg.solve(C, out)).real
    assert parts.min() == pytest.approx(0.05)
    assert parts.max() < 1.0
    np.testing.assert_allclose(out, out.T, atol=1e-12)


def test_a_corridor_is_as_wide_as_before_along_and_less_across(rng):
    C, out = np.diag([900.0, 1e-6, 1e-8]), np.empty((3, 3))
    assert own_part(C, np.zeros(3), np.diag([0.0, 0.5e-6, 0.5e-8]), 0.05, out)
    np.testing.assert_allclose(np.diag(out), [900.0, 0.5e-6, 0.5e-8], rtol=1e-9)


def test_what_is_not_definite_is_reported():
    assert not own_part(np.diag([1.0, -1.0, 1.0]), POSE, np.eye(3), 0.05, np.empty((3, 3)))
