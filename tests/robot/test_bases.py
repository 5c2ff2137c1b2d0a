"""Wheel kinematics: there and back, rolling without residual, and the wheels in any order."""

import numpy as np
import pytest
from pydantic import ValidationError

from longreach.robot.bases import DifferentialBase, MecanumBase

ROLES = ("front_left", "rear_left", "rear_right", "front_right")
RADIUS, LENGTH, WIDTH = 0.0759, 0.319, 0.2755


def mecanum(names=ROLES):
    return MecanumBase(wheel_radius=RADIUS, half_length=LENGTH, half_width=WIDTH, wheel_names=names)


def differential(names=("left", "right")):
    return DifferentialBase(wheel_radius=0.1, track_width=0.5, wheel_names=names)


def contact_speeds(base, twist):
    """Speed that each mecanum wheel must turn with, from where it stands and how its rollers lie."""
    speeds = []
    for name in base.wheel_names:
        x = base.half_length if "front" in name else -base.half_length
        y = base.half_width if "left" in name else -base.half_width
        velocity = np.array([twist[0] - twist[2] * y, twist[1] + twist[2] * x])  # of the floor contact
        roller = np.array([1.0, -1.0 if x * y > 0 else 1.0])  # its axis, along which it cannot roll
        speeds.append(velocity @ roller / (base.wheel_radius * roller[0]))
    return np.array(speeds)


def test_the_mecanum_matrix_is_that_of_the_thesis():
    k = LENGTH + WIDTH
    wanted = RADIUS / 4 * np.array([[1, 1, 1, 1], [-1, 1, -1, 1], [-1 / k, -1 / k, 1 / k, 1 / k]])
    np.testing.assert_allclose(mecanum().forward_matrix, wanted, rtol=1e-14)


def test_mecanum_wheels_turn_as_their_rollers_demand(rng):
    twist = rng.normal(size=3)
    base = mecanum()
    np.testing.assert_allclose(base.inverse_matrix @ twist, contact_speeds(base, twist), atol=1e-12)


def test_forward_undoes_inverse():
    np.testing.assert_allclose(mecanum().forward_matrix @ mecanum().inverse_matrix, np.eye(3), atol=1e-14)
    base = differential()
    np.testing.assert_allclose(base.forward_matrix @ base.inverse_matrix, np.diag([1.0, 0.0, 1.0]), atol=1e-14)
    np.testing.assert_allclose(base.inverse_matrix @ base.forward_matrix, np.eye(2), atol=1e-14)


def test_forward_is_the_least_squares_answer():
    for base in (mecanum(), differential()):
        np.testing.assert_allclose(base.forward_matrix, np.linalg.pinv(base.inverse_matrix), atol=1e-14)


def test_rolling_leaves_no_residual_and_the_residual_is_all_that_the_twist_does_not_see():
    base = mecanum()
    np.testing.assert_allclose(base.residual_matrix @ base.inverse_matrix, 0.0, atol=1e-15)
    np.testing.assert_allclose(base.residual_matrix @ np.array([4.0, -4.0, -4.0, 4.0]), [4.0 * RADIUS])
    assert np.linalg.matrix_rank(np.vstack([base.forward_matrix, base.residual_matrix])) == 4
    assert differential().residual_matrix.shape == (0, 2)


@pytest.mark.parametrize("order", [(0, 3, 1, 2), (2, 0, 3, 1)])
def test_matrices_follow_the_order_of_the_names(order, rng):
    names = tuple(f"/robot/{ROLES[i]}_wheel_joint" for i in order)
    shuffled, speeds = mecanum(names), rng.normal(size=4)
    np.testing.assert_allclose(shuffled.forward_matrix @ speeds[list(order)], mecanum().forward_matrix @ speeds)
    np.testing.assert_allclose(shuffled.residual_matrix @ speeds[list(order)], mecanum().residual_matrix @ speeds)
    np.testing.assert_allclose(shuffled.inverse_matrix, mecanum().inverse_matrix[list(order)])
    flipped = differential(("right", "left"))
    np.testing.assert_allclose(flipped.forward_matrix, differential().forward_matrix[:, ::-1])


def test_a_faster_right_wheel_turns_to_the_left():
    twist = differential().forward_matrix @ np.array([1.0, 2.0])
    np.testing.assert_allclose(twist, [0.15, 0.0, 0.2])


@pytest.mark.parametrize(
    "names",
    [ROLES[:3], (*ROLES[:3], "front_left_2"), ("a", "b", "c", "d"), ("front_rear_left", *ROLES[1:])],
)
def test_names_that_do_not_say_which_wheel_is_where_are_refused(names):
    with pytest.raises(ValidationError, match="front or rear and left or right"):
        mecanum(names)


@pytest.mark.parametrize("names", [("left", "left"), ("left", "other"), ("left",), ("left", "right", "right_2")])
def test_a_differential_base_needs_a_left_and_a_right_wheel(names):
    with pytest.raises(ValidationError, match="must be a left and a right wheel"):
        differential(names)


def test_a_base_cannot_be_changed():
    base = mecanum()
    for matrix in (base.forward_matrix, base.inverse_matrix, base.residual_matrix):
        with pytest.raises(ValueError, match="read-only"):
            matrix[0, 0] = 1.0
    with pytest.raises(ValidationError):
        base.wheel_radius = 1.0
    with pytest.raises(ValidationError):
        MecanumBase(wheel_radius=-1.0, half_length=1.0, half_width=1.0)
