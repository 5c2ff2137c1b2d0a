"""The whole-body law: the tool stays on its path, whatever the base does, as far as the arm can reach."""

import numpy as np
import pytest

import longreach as lr
from longreach.control import whole_body
from longreach.control.whole_body import Reference, WholeBodyConfig
from longreach.geometry import so3


@pytest.fixture(scope="module")
def thing():
    return lr.load_robot("thing")


def _followed(robot, config, q, reference, twist_error, seconds, dt=0.008):
    """Let arm and base do as told for a while, the base with an error of its twist; return where that ends."""
    for _ in range(round(seconds / dt)):
        wish = whole_body.step(robot, config, q, reference)
        u = wish.base + twist_error
        c, s = np.cos(q[2]), np.sin(q[2])
        q = q + dt * np.concatenate([[c * u[0] - s * u[1], s * u[0] + c * u[1], u[2]], wish.arm])
    return q


def _apart(robot, q, reference):
    T, T_ref = robot.forward(q), robot.forward(reference.q)
    return np.linalg.norm(T[:3, 3] - T_ref[:3, 3]), np.linalg.norm(so3.log(T[:3, :3].T @ T_ref[:3, :3]))


def test_on_the_plan_nothing_is_added_to_it(thing, rng):
    q = thing.home + 0.1 * rng.normal(size=9)
    velocity = 0.1 * rng.normal(size=9)
    wish = whole_body.step(thing, WholeBodyConfig(), q, Reference(q, velocity))
    c, s = np.cos(q[2]), np.sin(q[2])
    np.testing.assert_allclose(
        wish.base, [c * velocity[0] + s * velocity[1], -s * velocity[0] + c * velocity[1], velocity[2]]
    )
    np.testing.assert_allclose(wish.arm, velocity[3:], atol=1e-12)


def test_the_tool_arrives_while_the_base_is_still_on_its_way(thing):
    off = thing.home.copy()
    off[:3] += [0.05, -0.04, 0.06]
    reference = Reference(thing.home, np.zeros(9))
    q = _followed(thing, WholeBodyConfig(), off, reference, np.zeros(3), 1.0)
    position, angle = _apart(thing, q, reference)
    assert position < 1e-3
    assert angle < 1e-3
    assert np.linalg.norm(q[:2] - thing.home[:2]) > 0.01  # the base is slower, and the arm made up for it


def test_a_base_that_creeps_does_not_move_the_tool(thing):
    reference, creep = Reference(thing.home, np.zeros(9)), np.array([0.005, -0.004, 0.003])
    closed = _followed(thing, WholeBodyConfig(), thing.home, reference, creep, 3.0)
    open_loop = _followed(thing, WholeBodyConfig(loop="open"), thing.home, reference, creep, 3.0)
    assert _apart(thing, closed, reference)[0] < 1e-3
    assert _apart(thing, open_loop, reference)[0] > 0.01


def test_the_short_way_round_is_taken(thing):
    q = thing.home.copy()
    q[2] = 2.0 * np.pi + 0.1
    wish = whole_body.step(thing, WholeBodyConfig(base_gain=1.0), q, Reference(thing.home, np.zeros(9)))
    assert wish.base[2] == pytest.approx(-0.1)


def test_a_stretched_arm_is_told_no_wild_speeds(thing):
    q = thing.home.copy()
    q[3:] = [0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0]  # elbow and wrist are singular
    ahead = q.copy()
    ahead[2] += 0.3
    wish = whole_body.step(thing, WholeBodyConfig(), q, Reference(ahead, np.zeros(9)))
    assert np.abs(wish.arm).max() < 100.0
    assert np.isfinite(wish.arm).all()
