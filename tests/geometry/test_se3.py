import numpy as np
import pytest
from hypothesis import given
from jacobians import assert_is_jacobian
from numpy.testing import assert_allclose
from scipy.linalg import expm
from tangents import away_from_pi, tangents

from longreach.geometry import se2, se3, so3

twists = tangents(3, 3)


def hat(xi):
    matrix = np.zeros((4, 4))
    matrix[:3, :3], matrix[:3, 3] = so3.hat(xi[3:]), xi[:3]
    return matrix


def ad(xi):
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = so3.hat(xi[3:])
    matrix[:3, 3:] = so3.hat(xi[:3])
    return matrix


@given(twists)
def test_exp_is_the_matrix_exponential(xi):
    assert_allclose(se3.exp(xi), expm(hat(xi)), atol=1e-12)


@given(twists, twists, twists)
def test_composition_is_associative(a, b, c):
    a, b, c = se3.exp(a), se3.exp(b), se3.exp(c)
    assert_allclose(se3.compose(se3.compose(a, b), c), se3.compose(a, se3.compose(b, c)), atol=1e-12)


@given(twists)
def test_the_inverse_undoes_from_both_sides(xi):
    T = se3.exp(xi)
    assert_allclose(se3.compose(T, se3.inverse(T)), np.eye(4), atol=1e-12)
    assert_allclose(se3.compose(se3.inverse(T), T), np.eye(4), atol=1e-12)


@given(twists)
def test_log_undoes_exp(xi):
    assert_allclose(se3.log(se3.exp(xi)), xi, rtol=1e-8, atol=1e-13)


@given(twists, twists)
def test_exp_undoes_log(a, b):
    T = se3.exp(a) @ se3.exp(b)
    assert_allclose(se3.exp(se3.log(T)), T, atol=1e-11)


@given(twists, twists)
def test_the_adjoint_carries_a_twist_to_the_other_side(a, xi):
    T = se3.exp(a)
    assert_allclose(se3.retract(T, xi), se3.exp(se3.adjoint(T) @ xi) @ T, atol=1e-11)


@given(twists, twists)
def test_the_adjoint_of_a_product_is_the_product_of_adjoints(a, b):
    a, b = se3.exp(a), se3.exp(b)
    assert_allclose(se3.adjoint(a @ b), se3.adjoint(a) @ se3.adjoint(b), atol=1e-11)


@given(twists, twists)
def test_difference_undoes_retract(a, xi):
    T = se3.exp(a)
    assert_allclose(se3.exp(se3.difference(T, se3.retract(T, xi))), se3.exp(xi), atol=1e-11)


@given(twists)
def test_the_right_jacobian_is_the_derivative_of_exp(xi):
    assert_is_jacobian(se3.exp, se3.right_jacobian(xi), xi, difference=se3.difference, atol=1e-6)


@given(twists)
def test_the_inverse_right_jacobian_is_the_derivative_of_log(xi):
    xi = away_from_pi(xi, 3)
    assert_is_jacobian(se3.log, se3.right_jacobian_inverse(xi), se3.exp(xi), retract=se3.retract, atol=1e-6)


@given(twists)
def test_the_two_right_jacobians_are_inverse(xi):
    assert_allclose(se3.right_jacobian(xi) @ se3.right_jacobian_inverse(xi), np.eye(6), atol=1e-11)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.0999, 0.1001, 0.1999, 0.2001, 0.5])
def test_the_right_jacobian_is_its_power_series_on_both_sides_of_every_switch(angle, rng):
    axis = rng.normal(size=3)
    xi = np.concatenate([rng.normal(size=3), angle * axis / np.linalg.norm(axis)])
    term, series = np.eye(6), np.zeros((6, 6))
    for k in range(20):
        series += term
        term = term @ -ad(xi) / (k + 2)
    assert_allclose(se3.right_jacobian(xi), series, atol=1e-12)


@given(tangents(2, 1))
def test_a_planar_twist_moves_as_in_the_plane(xi):
    T = se3.exp(np.array([xi[0], xi[1], 0.0, 0.0, 0.0, xi[2]]))
    assert_allclose(se2.from_se3(T), se2.exp(xi), atol=1e-12)


def test_a_motion_is_put_together_from_rotation_and_translation(rng):
    R, p = so3.exp(rng.normal(size=3)), rng.normal(size=3)
    T = se3.from_rotation_translation(R, p)
    point = rng.normal(size=3)
    assert_allclose((T @ np.append(point, 1.0))[:3], R @ point + p)


def test_batches_give_what_single_motions_give(rng):
    xi = rng.normal(size=(4, 5, 6))
    T = se3.exp(xi)
    assert T.shape == (4, 5, 4, 4)
    assert_allclose(T[2, 3], se3.exp(xi[2, 3]), atol=0)
    assert_allclose(se3.log(T)[2, 3], se3.log(T[2, 3]), atol=0)
    assert_allclose(se3.inverse(T)[2, 3], se3.inverse(T[2, 3]), atol=1e-15)
