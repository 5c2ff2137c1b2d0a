"""The outline of a robot on the floor covers what its shapes cover."""

import numpy as np
import pytest

import longreach as lr
from longreach.robot.footprint import footprint_of


@pytest.fixture(scope="module")
def thing():
    return lr.load_robot("thing")


def test_the_rectangle_covers_body_and_wheels_of_the_base(thing):
    least_x, most_x, least_y, most_y = footprint_of(thing).rectangle
    assert (least_x, most_x) == pytest.approx((-0.48, 0.48), abs=0.02)  # the body's box: 0.96 m by 0.793 m
    assert (least_y, most_y) == pytest.approx((-0.3965, 0.3965), abs=0.02)


def test_the_arms_capsules_follow_its_joints(thing, rng):
    footprint = footprint_of(thing)
    for _ in range(5):
        arm = rng.uniform(-2.0, 2.0, 6)
        q = np.concatenate([np.zeros(3), arm])
        rows = footprint.capsules(arm)
        at = thing.frame("wrist_3_link", q)[:2, 3]
        nearest = min(
            np.linalg.norm(at - (a + t * (b - a)))
            for a, b in zip(rows[:, :2], rows[:, 2:4], strict=True)
            for t in np.linspace(0.0, 1.0, 21)
        )
        assert nearest < 0.1
        turned = footprint.capsules(arm + np.array([0.5, 0, 0, 0, 0, 0]))
        base = thing.frame("shoulder_link", q)[:2, 3]  # about which the first joint turns all of them
        np.testing.assert_allclose(
            np.linalg.norm(turned[:, :2] - base, axis=1), np.linalg.norm(rows[:, :2] - base, axis=1), atol=1e-9
        )


@pytest.mark.parametrize("name", ["panda_cart", "intel"])
def test_a_robot_without_shapes_has_an_outline_around_its_wheels(name):
    robot = lr.load_robot(name)
    least_x, most_x, least_y, most_y = footprint_of(robot).rectangle
    assert most_x > 0.1
    assert most_y > 0.1
    assert (least_x, least_y) == (-most_x, -most_y) or robot.urdf is not None
