"""Wheel kinematics: there and back, rolling without residual, and the wheels in any order."""

import numpy as np
import pytest
from pydantic import ValidationError

from longreach.robot.bases import DifferentialBase, MecanumBase, OmniBase

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


@pytest.mark.parametrize("names", [("left", "left"), ("left", "other"), ("left",), ("a", "b", "c", "d")])
def test_a_differential_base_needs_a_left_and_a_right_wheel(names):
    with pytest.raises(ValidationError, match=r"must be a left and a right wheel, or several of each, .*give sides"):
        differential(names)


@pytest.mark.parametrize(
    "names",
    [
        ("front_left_wheel_joint", "back_left_wheel_joint", "back_right_wheel_joint", "front_right_wheel_joint"),
        ("fl_wheel_joint", "rl_wheel_joint", "rr_wheel_joint", "fr_wheel_joint"),
        ("FLWheel", "BLWheel", "BRWheel", "FRWheel"),
        ("wheel_lf", "wheel_lb", "wheel_rb", "wheel_rf"),
        ("wheel_f_l", "wheel_r_l", "wheel_r_r", "wheel_f_r"),
        ("left_f", "left_r", "right_r", "right_f"),
        ("lf", "lr", "rr", "rf"),
    ],
)
def test_usual_names_of_wheels_say_their_corners(names):
    assert mecanum(names).wheel_corners == ROLES
    assert differential(names).wheel_sides == ("left", "left", "right", "right")


def test_corners_and_sides_are_said_apart_from_names(rng):
    wheels = dict(zip(ROLES, ("one", "two", "three", "four"), strict=True))
    kind = {"wheel_radius": RADIUS, "half_length": LENGTH, "half_width": WIDTH}
    by_place = MecanumBase(**kind, wheel_names={"front_right": "four", **wheels})
    beside = MecanumBase(**kind, wheel_names=["four", "one", "two", "three"], corners=("fr", "fl", "back_left", "rr"))
    assert by_place == beside == MecanumBase(**by_place.model_dump(mode="json"))
    np.testing.assert_allclose(by_place.forward_matrix, mecanum().forward_matrix[:, [3, 0, 1, 2]])
    tracks = DifferentialBase(wheel_radius=0.1, track_width=0.5, wheel_names={"left": ["a", "b"], "right": ["c", "d"]})
    assert tracks.sides == ("left", "left", "right", "right")


def test_the_wheels_of_a_side_are_averaged():
    base = DifferentialBase(wheel_radius=0.1, track_width=0.5, wheel_names=("l1_left", "l2_left", "right"))
    np.testing.assert_allclose(base.forward_matrix @ [1.0, 3.0, 4.0], differential().forward_matrix @ [2.0, 4.0])
    np.testing.assert_allclose(base.forward_matrix, np.linalg.pinv(base.inverse_matrix), atol=1e-14)


@pytest.mark.parametrize("count", [3, 4])
def test_an_omni_base_rolls_along_its_circle(count, rng):
    angles = np.pi / 4 + 2 * np.pi * np.arange(count) / count
    names = tuple("abcd"[:count])
    base = OmniBase(wheel_radius=0.05, centre_distance=0.2, wheel_angles=tuple(angles.tolist()), wheel_names=names)
    v_x, v_y, omega = twist = rng.normal(size=3)
    places = 0.2 * np.array([np.cos(angles), np.sin(angles)])
    velocities = np.array([v_x - omega * places[1], v_y + omega * places[0]])
    along = np.array([-np.sin(angles), np.cos(angles)])
    np.testing.assert_allclose(base.inverse_matrix @ twist, (velocities * along).sum(axis=0) / 0.05, atol=1e-12)
    np.testing.assert_allclose(base.forward_matrix @ base.inverse_matrix, np.eye(3), atol=1e-14)
    assert base.residual_matrix.shape == (count - 3, count)
    np.testing.assert_allclose(base.residual_matrix @ base.inverse_matrix, 0.0, atol=1e-14)
    with pytest.raises(ValidationError, match="could not move all ways"):
        OmniBase(wheel_radius=0.05, centre_distance=0.2, wheel_angles=(0.0,) * count, wheel_names=names)


def test_a_base_cannot_be_changed():
    base = mecanum()
    for matrix in (base.forward_matrix, base.inverse_matrix, base.residual_matrix):
        with pytest.raises(ValueError, match="read-only"):
            matrix[0, 0] = 1.0
    with pytest.raises(ValidationError):
        base.wheel_radius = 1.0
    with pytest.raises(ValidationError):
        MecanumBase(wheel_radius=-1.0, half_length=1.0, half_width=1.0)
