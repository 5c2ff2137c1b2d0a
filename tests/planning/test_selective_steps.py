"""Selectively damped steps at poses of a real robot, singular ones among them."""

import numpy as np
import pytest

from longreach.io.robots import load_robot
from longreach.planning.pose_error import pose_error_and_jacobian
from longreach.planning.pseudoinverse import Inverse


def poses(rng, robot, n):
    """Random configurations; every fourth at or near a singular one: elbow straight, wrist in line, or both."""
    Q = rng.uniform(np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi), (n, robot.dof))
    near = 10.0 ** rng.uniform(-15, -2, n)
    Q[::4, -4] = near[::4]
    Q[1::8, -2] = near[1::8]
    Q[::16, -2] = 0.0
    return Q


@pytest.mark.parametrize("name", ["thing", "ur10"])
def test_no_joint_goes_farther_than_its_bound_in_5000_poses(rng, name):
    robot = load_robot(name)
    inverse = Inverse(method="selective")
    bound = inverse.max_step(robot.prismatic)
    longest = np.zeros(robot.dof)
    for q, target in zip(poses(rng, robot, 5000), robot.forward(poses(rng, robot, 5000)), strict=True):
        T, J = robot.forward_and_jacobian(q)
        e, J_e = pose_error_and_jacobian(T, J, target)
        step = inverse.step(J_e, -e, robot.prismatic)
        assert np.all(np.isfinite(step))
        longest = np.maximum(longest, np.abs(step))
    assert np.all(longest <= bound * (1 + 1e-12))
    assert np.all(longest[-6:] > 0.3 * bound[-6:])  # it does use what it may
