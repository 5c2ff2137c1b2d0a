import numpy as np
import pytest
from hypothesis import given
from jacobians import assert_is_jacobian
from numpy.testing import assert_allclose
from scipy.linalg import expm
from tangents import away_from_pi, tangents

from longreach.geometry import se2

twists = tangents(2, 1)
IDENTITY = np.zeros(3)


def as_matrix(pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0.0, 0.0, 1.0]])


def hat(xi):
    return np.array([[0.0, -xi[2], xi[0]], [xi[2], 0.0, xi[1]], [0.0, 0.0, 0.0]])


def assert_same_pose(a, b, atol=1e-12):
    assert_allclose(as_matrix(a), as_matrix(b), atol=atol)


@given(twists, twists, twists)
def test_composition_is_associative(a, b, c):
    a, b, c = se2.exp(a), se2.exp(b), se2.exp(c)
    assert_same_pose(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)))


@given(twists, twists)
def test_composition_is_the_product_of_matrices(a, b):
    a, b = se2.exp(a), se2.exp(b)
    assert_allclose(as_matrix(se2.compose(a, b)), as_matrix(a) @ as_matrix(b), atol=1e-12)


@given(twists)
def test_the_identity_changes_nothing(xi):
    pose = se2.exp(xi)
    assert_same_pose(se2.compose(pose, IDENTITY), pose)
    assert_same_pose(se2.compose(IDENTITY, pose), pose)


@given(twists)
def test_the_inverse_undoes_from_both_sides(xi):
    pose = se2.exp(xi)
    assert_same_pose(se2.compose(pose, se2.inverse(pose)), IDENTITY)
    assert_same_pose(se2.compose(se2.inverse(pose), pose), IDENTITY)


@given(twists, twists)
def test_between_is_inverse_then_compose(a, b):
    a, b = se2.exp(a), se2.exp(b)
    assert_same_pose(se2.between(a, b), se2.compose(se2.inverse(a), b))


@given(twists)
def test_exp_is_the_matrix_exponential(xi):
    assert_allclose(as_matrix(se2.exp(xi)), expm(hat(xi)), atol=1e-12)


@given(twists)
def test_log_undoes_exp(xi):
    assert_allclose(se2.log(se2.exp(xi)), xi, rtol=1e-9, atol=1e-15)


@given(twists)
def test_exp_undoes_log(xi):
    pose = se2.compose(se2.exp(xi), np.array([1.0, -2.0, 3.0]))
    assert_same_pose(se2.exp(se2.log(pose)), pose)


def test_turning_on_the_spot_leaves_position_unchanged():
    assert_allclose(se2.exp(np.array([0.0, 0.0, 1.3])), [0.0, 0.0, 1.3])


def test_half_a_turn_while_driving_is_half_a_circle():
    assert_allclose(se2.exp(np.array([np.pi, 0.0, np.pi])), [0.0, 2.0, np.pi], atol=1e-15)


@pytest.mark.parametrize(
    "angle", [np.pi, -np.pi, np.nextafter(np.pi, 0), np.nextafter(-np.pi, 0), 3 * np.pi, 1e4, -1e4]
)
def test_headings_lie_above_minus_pi_and_up_to_pi(angle):
    heading = se2.compose(np.array([0.0, 0.0, angle]), IDENTITY)[2]
    assert -np.pi < heading <= np.pi
    assert_allclose([np.cos(heading), np.sin(heading)], [np.cos(angle), np.sin(angle)], atol=1e-11)


@given(twists, twists)
def test_the_adjoint_carries_a_twist_to_the_other_side(a, xi):
    pose = se2.exp(a)
    moved = se2.compose(se2.exp(se2.adjoint(pose) @ xi), pose)
    assert_same_pose(se2.retract(pose, xi), moved, atol=1e-10)


@given(twists, twists)
def test_difference_undoes_retract(a, xi):
    pose = se2.exp(a)
    assert_same_pose(se2.exp(se2.difference(pose, se2.retract(pose, xi))), se2.exp(xi), atol=1e-10)


@given(twists)
def test_the_right_jacobian_is_the_derivative_of_exp(xi):
    J = se2.right_jacobian(xi)
    assert_is_jacobian(se2.exp, J, xi, difference=se2.difference, atol=1e-7)


@given(twists)
def test_the_inverse_right_jacobian_is_the_derivative_of_log(xi):
    xi = away_from_pi(xi, 1)
    assert_is_jacobian(se2.log, se2.right_jacobian_inverse(xi), se2.exp(xi), retract=se2.retract, atol=1e-6)


@given(twists)
def test_the_two_right_jacobians_are_inverse(xi):
    assert_allclose(se2.right_jacobian(xi) @ se2.right_jacobian_inverse(xi), np.eye(3), atol=1e-11)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.00999, 0.01001, 0.5, -2.0])
def test_the_right_jacobian_is_its_power_series_on_both_sides_of_the_switch(angle):
    ad = np.array([[0.0, -angle, 2.0], [angle, 0.0, -1.0], [0.0, 0.0, 0.0]])  # of [1, 2, angle]
    term, series = np.eye(3), np.zeros((3, 3))
    for k in range(40):
        series += term
        term = term @ -ad / (k + 2)
    assert_allclose(se2.right_jacobian(np.array([1.0, 2.0, angle])), series, atol=1e-11)


@given(twists, twists)
def test_interpolation_starts_at_one_pose_and_ends_at_the_other(a, b):
    a, b = se2.exp(a)[None], se2.exp(b)[None]
    assert_same_pose(se2.interpolate(a, b, np.array([0.0]))[0], a[0])
    assert_same_pose(se2.interpolate(a, b, np.array([1.0]))[0], b[0], atol=1e-10)


@given(twists, twists)
def test_interpolation_moves_at_constant_speed(a, b):
    a, b = se2.exp(a), se2.exp(b)
    fractions = np.linspace(0.0, 1.0, 6)
    path = se2.interpolate(np.tile(a, (6, 1)), np.tile(b, (6, 1)), fractions)
    steps = se2.difference(path[:-1], path[1:])
    assert_allclose(steps, np.tile(se2.difference(a, b) / 5, (5, 1)), atol=1e-9)


def test_batches_give_what_single_poses_give(rng):
    a, b = rng.normal(size=(2, 4, 5, 3))
    together = se2.retract(a, b)
    for i in np.ndindex(4, 5):
        assert_allclose(together[i], se2.retract(a[i], b[i]), atol=1e-15)
    assert_allclose(se2.compose(a[0, 0], b)[1, 2], se2.compose(a[0, 0], b[1, 2]))
    assert se2.exp(np.zeros((0, 3))).shape == (0, 3)


@given(twists)
def test_transform_carries_points_as_the_matrix_does(xi):
    pose = se2.exp(xi)
    points = np.array([[1.0, 2.0], [-3.0, 0.5]])
    expected = (as_matrix(pose) @ np.column_stack([points, np.ones(2)]).T).T[:, :2]
    assert_allclose(se2.transform(pose, points), expected, atol=1e-12)


def test_arguments_stay_as_they_were(rng):
    a = rng.normal(size=(3, 3))
    before = a.copy()
    for transformation in (se2.exp, se2.log, se2.inverse):
        transformation(a)
    assert_allclose(a, before, atol=0)
