import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from jacobians import assert_is_jacobian
from numpy.testing import assert_allclose
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from tangents import away_from_pi, tangents

from longreach.geometry import so3

rotation_vectors = tangents(0, 3)


@given(rotation_vectors)
def test_exp_gives_a_rotation(w):
    R = so3.exp(w)
    assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert_allclose(np.linalg.det(R), 1.0, atol=1e-14)


@given(rotation_vectors)
def test_exp_is_the_matrix_exponential(w):
    assert_allclose(so3.exp(w), expm(so3.hat(w)), atol=1e-13)


@given(rotation_vectors, rotation_vectors, rotation_vectors)
def test_composition_is_associative(a, b, c):
    a, b, c = so3.exp(a), so3.exp(b), so3.exp(c)
    assert_allclose(so3.compose(so3.compose(a, b), c), so3.compose(a, so3.compose(b, c)), atol=1e-14)


@given(rotation_vectors)
def test_the_inverse_undoes_from_both_sides(w):
    R = so3.exp(w)
    assert_allclose(so3.compose(R, so3.inverse(R)), np.eye(3), atol=1e-14)
    assert_allclose(so3.inverse(R), so3.exp(-w), atol=1e-14)


@given(rotation_vectors)
def test_log_undoes_exp(w):
    assert_allclose(so3.log(so3.exp(w)), w, rtol=1e-9, atol=1e-14)


@given(rotation_vectors, rotation_vectors)
def test_log_agrees_with_scipy(a, b):
    R = so3.exp(a) @ so3.exp(b)
    w = so3.log(R)
    assert np.linalg.norm(w) <= np.pi + 1e-12
    assert_allclose(Rotation.from_rotvec(w).as_matrix(), R, atol=1e-12)


@given(rotation_vectors)
def test_half_turns_about_any_axis_come_back_up_to_sign(w):
    axis = w / max(float(np.linalg.norm(w)), 1e-300)
    R = 2.0 * np.outer(axis, axis) - np.eye(3)
    back = so3.log(R)
    assert_allclose(np.linalg.norm(back), np.pi, atol=1e-7)
    assert_allclose(so3.exp(back), R, atol=1e-7)


def test_the_identity_has_no_rotation_vector():
    assert_allclose(so3.log(np.eye(3)), np.zeros(3), atol=0)


@given(rotation_vectors, rotation_vectors)
def test_the_adjoint_carries_a_rotation_to_the_other_side(a, w):
    R = so3.exp(a)
    assert_allclose(so3.retract(R, w), so3.exp(so3.adjoint(R) @ w) @ R, atol=1e-13)


@given(rotation_vectors, rotation_vectors)
def test_difference_undoes_retract(a, w):
    R = so3.exp(a)
    assert_allclose(so3.exp(so3.difference(R, so3.retract(R, w))), so3.exp(w), atol=1e-12)


@given(rotation_vectors)
def test_the_right_jacobian_is_the_derivative_of_exp(w):
    assert_is_jacobian(so3.exp, so3.right_jacobian(w), w, difference=so3.difference, atol=1e-8)


@given(rotation_vectors)
def test_the_inverse_right_jacobian_is_the_derivative_of_log(w):
    w = away_from_pi(w, 3)
    assert_is_jacobian(so3.log, so3.right_jacobian_inverse(w), so3.exp(w), retract=so3.retract, atol=1e-7)


@given(rotation_vectors)
def test_the_two_right_jacobians_are_inverse(w):
    assert_allclose(so3.right_jacobian(w) @ so3.right_jacobian_inverse(w), np.eye(3), atol=1e-12)


angles = st.floats(-3.0, 3.0)


@given(angles, angles, angles)
def test_roll_pitch_yaw_turn_about_x_then_y_then_z(roll, pitch, yaw):
    expected = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
    assert_allclose(so3.from_roll_pitch_yaw(roll, pitch, yaw), expected, atol=1e-14)


def test_batches_give_what_single_rotations_give(rng):
    w = rng.normal(size=(4, 5, 3))
    R = so3.exp(w)
    assert R.shape == (4, 5, 3, 3)
    assert_allclose(R[2, 3], so3.exp(w[2, 3]), atol=0)
    assert_allclose(so3.log(R)[2, 3], so3.log(R[2, 3]), atol=0)
    assert so3.log(np.zeros((0, 3, 3))).shape == (0, 3)
