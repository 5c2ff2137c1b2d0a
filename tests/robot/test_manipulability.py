"""Manipulability: values against LAPACK, gradients against finite differences, sliding joints included."""

from typing import get_args

import numpy as np
import pytest
from jacobians import assert_is_jacobian

from longreach.errors import ModelError
from longreach.io.robots import load_robot
from longreach.robot.manipulability import Measure, Part, manipulability

THING, PANDA = load_robot("thing"), load_robot("panda_cart")


def by_lapack(J, measure):
    sigma = np.linalg.svd(J, compute_uv=False)
    M, kappa = np.sqrt(np.linalg.det(J @ J.T)), sigma[0] / sigma[-1]
    return {"m": M, "log_m": np.log(M), "kappa": kappa, "sqrt_kappa_over_m": np.sqrt(kappa / M)}[measure]


@pytest.mark.parametrize("robot", [THING, PANDA], ids=lambda robot: robot.name)
@pytest.mark.parametrize("part", get_args(Part))
@pytest.mark.parametrize("measure", get_args(Measure))
def test_values_are_those_of_lapack_and_gradients_their_derivatives(rng, robot, part, measure):
    for q, length in zip(rng.uniform(-2, 2, (4, robot.dof)), (1.0, 1.0, 0.4, 3.0), strict=True):
        value, gradient = manipulability(robot, q, measure, part, length)
        J = robot.forward_and_jacobian(q)[1][:, robot.arm if part == "arm" else slice(None)]
        A = J / np.array([length] * 3 + [1.0] * 3)[:, None]
        assert value == pytest.approx(by_lapack(A, measure), rel=1e-9)

        def relative(x, length=length, value=value):  # of large and small measures alike
            return np.atleast_1d(manipulability(robot, x, measure, part, length)[0] / value)

        assert_is_jacobian(relative, gradient[None] / value, q, atol=1e-5)


def test_the_arms_own_measure_does_not_depend_on_the_base(rng):
    q = rng.uniform(-2, 2, 9)
    value, gradient = manipulability(THING, q, "m", "arm")
    np.testing.assert_allclose(gradient[THING.base], 0.0, atol=1e-13)
    ur10 = load_robot("ur10")
    assert manipulability(ur10, q[3:])[0] > 0
    flange = THING.with_tool("flange")
    np.testing.assert_allclose(manipulability(flange, q, "m", "arm")[0], manipulability(ur10, q[3:])[0], rtol=1e-10)
    assert value == pytest.approx(manipulability(flange, q, "m", "arm")[0])  # a square J's determinant moves along


def test_the_full_measure_does_not_depend_on_where_the_base_is_nor_on_its_heading(rng):
    q = rng.uniform(-2, 2, 9)
    for measure in get_args(Measure):
        np.testing.assert_allclose(manipulability(THING, q, measure)[1][THING.base], 0.0, atol=1e-10)


def test_many_configurations_give_what_single_ones_give(rng):
    Q = rng.uniform(-2, 2, (2, 3, 9))
    values, gradients = manipulability(THING, Q, "sqrt_kappa_over_m", "arm")
    assert (values.shape, gradients.shape) == ((2, 3), (2, 3, 9))
    value, gradient = manipulability(THING, Q[1, 2], "sqrt_kappa_over_m", "arm")
    assert value == pytest.approx(values[1, 2], rel=1e-12)
    np.testing.assert_allclose(gradient, gradients[1, 2], rtol=1e-9)


def test_a_singular_arm_gives_finite_numbers():
    stretched = np.zeros(9)  # the UR10's arm straight out, its wrist folded flat
    for part in get_args(Part):
        for measure in get_args(Measure):
            value, gradient = manipulability(THING, stretched, measure, part)
            assert np.isfinite(value)
            assert np.all(np.isfinite(gradient))
    assert manipulability(THING, stretched, "m", "arm")[0] < 1e-9
    assert manipulability(THING, stretched, "kappa", "arm")[0] > 1e9


@pytest.mark.parametrize(
    ("robot", "arguments", "message"),
    [
        ("thing", {"measure": "m", "part": "arm", "length": 0.0}, "length is 0 m"),
        ("intel", {}, "needs six joints, but intel has 3 in its full Jacobian"),
    ],
)
def test_what_cannot_be_measured_is_refused(robot, arguments, message):
    robot = load_robot(robot)
    with pytest.raises(ModelError, match=message):
        manipulability(robot, np.zeros(robot.dof), **arguments)
