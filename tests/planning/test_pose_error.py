"""The error of a pose and its derivative, near and far from the target."""

import numpy as np
import pytest
from hypothesis import given
from jacobians import assert_is_jacobian
from tangents import away_from_pi, tangents

from longreach.errors import PlanningError
from longreach.geometry import se3, so3
from longreach.planning.pose_error import orientation_error, pose_error_and_jacobian


def world_aligned(T, twists):
    """A Jacobian (6, n) whose column i moves T by the body twist i."""
    return np.vstack([T[:3, :3] @ twists[:3], T[:3, :3] @ twists[3:]])


@given(tangents(3, 3), tangents(3, 3))
def test_the_error_is_the_logarithm_seen_from_the_target(xi, eta):
    T_target = se3.exp(eta)
    e, _ = pose_error_and_jacobian(se3.retract(T_target, xi), np.eye(6), T_target)
    np.testing.assert_allclose(se3.exp(e), se3.exp(xi), atol=2e-7)
    np.testing.assert_allclose(e, se3.difference(T_target, se3.retract(T_target, xi)), atol=1e-9)


@given(tangents(3, 3), tangents(3, 3))
def test_the_jacobian_is_the_right_jacobians_inverse(xi, eta):
    T_target, xi = se3.exp(eta), away_from_pi(xi, 3)
    T = se3.retract(T_target, xi)
    twists = np.random.default_rng(1).normal(size=(6, 9))
    e, J_e = pose_error_and_jacobian(T, world_aligned(T, twists), T_target)
    np.testing.assert_allclose(J_e, se3.right_jacobian_inverse(e) @ twists, atol=1e-8)


@pytest.mark.parametrize("kind", ["log", "cross"])
@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.1, 0.29, 0.31, 1.2, 1.5])
def test_the_jacobian_is_the_derivative_of_the_error(kind, angle, rng):
    axis = rng.normal(size=3)
    xi = np.concatenate([rng.normal(size=3), angle * axis / np.linalg.norm(axis)])
    T_target = se3.exp(rng.normal(size=6))
    T, twists = se3.retract(T_target, xi), rng.normal(size=(6, 9))
    _, J_e = pose_error_and_jacobian(T, world_aligned(T, twists), T_target, kind)
    assert_is_jacobian(
        lambda d: pose_error_and_jacobian(se3.retract(T, twists @ d), np.eye(6), T_target, kind)[0],
        J_e,
        np.zeros(9),
        atol=1e-4 if angle == 1.5 and kind == "cross" else 1e-6,  # 1/cos² is 200 there
    )


def test_the_log_jacobian_holds_beyond_a_quarter_turn(rng):
    T_target = se3.exp(rng.normal(size=6))
    T = se3.retract(T_target, np.array([0.5, -1.0, 0.3, 1.5, -2.0, 0.9]))
    _, J_e = pose_error_and_jacobian(T, world_aligned(T, np.eye(6)), T_target)
    assert_is_jacobian(lambda d: pose_error_and_jacobian(se3.retract(T, d), np.eye(6), T_target)[0], J_e, np.zeros(6))


def as_the_thesis_has_it(R, R_target):
    """(3.18), current and desired columns, with L not transposed; in the world, from current to desired."""
    pairs = list(zip(R.T, R_target.T, strict=True))
    cross = sum(np.cross(current, desired) for current, desired in pairs)
    L = -0.5 * sum(so3.hat(current) @ so3.hat(desired) for current, desired in pairs)
    return np.linalg.solve(L, 0.5 * cross)  # (3.18a)


def test_the_cross_product_error_is_that_of_the_thesis(rng):
    for _ in range(50):
        R_target, w = so3.exp(rng.normal(size=3)), rng.normal(size=3)
        w *= rng.uniform(0.0, 1.5) / np.linalg.norm(w)
        R = R_target @ so3.exp(w)
        e = orientation_error(R, R_target, kind="cross")
        np.testing.assert_allclose(R_target @ e, -as_the_thesis_has_it(R, R_target), atol=1e-9)
        np.testing.assert_allclose(e, np.tan(np.linalg.norm(w)) * w / np.linalg.norm(w), atol=1e-9)
        np.testing.assert_allclose(orientation_error(R, R_target), w, atol=1e-9)


def test_both_errors_agree_to_first_order(rng):
    R_target, w = so3.exp(rng.normal(size=3)), 1e-4 * rng.normal(size=3)
    R = R_target @ so3.exp(w)
    np.testing.assert_allclose(orientation_error(R, R_target, kind="cross"), w, atol=1e-11)


def test_the_cross_product_error_refuses_a_quarter_turn():
    R = so3.exp(np.array([0.0, 0.0, 1.6]))
    with pytest.raises(PlanningError, match="90°"):
        orientation_error(R, np.eye(3), kind="cross")
    with pytest.raises(PlanningError, match="90°"):
        pose_error_and_jacobian(se3.exp(np.array([0, 0, 0, 0, 0, 1.6])), np.eye(6), np.eye(4), kind="cross")
