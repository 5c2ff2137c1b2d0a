"""The outline of a robot on the floor covers what its shapes cover."""

from dataclasses import replace

import numpy as np
import pytest

import longreach as lr
from longreach.robot.bases import DifferentialBase
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


def as_mesh(shape):
    return replace(shape, kind="mesh", size=(1.0, 1.0, 1.0), mesh="body.stl")


def of_meshes(robot, names):
    """A robot whose links of these names collide by meshes."""
    links = {
        name: replace(link, collisions=tuple(as_mesh(shape) for shape in link.collisions)) if name in names else link
        for name, link in robot.urdf.links.items()
    }
    return replace(robot, urdf=replace(robot.urdf, links=links))


def test_a_base_of_meshes_alone_has_an_outline_around_its_wheels(thing):
    footprint = footprint_of(of_meshes(thing, thing.urdf.links))
    base = thing.description.base
    x, y = base.half_length + base.wheel_radius, base.half_width
    assert footprint.rectangle == pytest.approx([-x, x, -y - 0.05, y + 0.05])
    assert footprint.capsules(thing.home[3:]).shape == (0, 5)


def test_a_base_that_nothing_is_known_of_has_the_outline_of_a_usual_one(thing):
    meshes = of_meshes(thing, thing.urdf.links)
    unknown = replace(meshes, description=thing.description.model_copy(update={"base": None}))
    assert footprint_of(unknown).rectangle == pytest.approx([-0.3, 0.3, -0.25, 0.25])


@pytest.mark.parametrize("base", ["mecanum", DifferentialBase(wheel_radius=0.1, track_width=0.551)])
def test_wheels_beyond_the_shapes_count(thing, base):
    """What is left as a primitive shape is a pedestal in the middle, narrower than the wheels stand apart."""
    meshes = of_meshes(thing, set(thing.urdf.links) - {"pedestal"})
    if base != "mecanum":
        meshes = replace(meshes, description=thing.description.model_copy(update={"base": base}))
    least_x, most_x, least_y, most_y = footprint_of(meshes).rectangle
    assert most_x == pytest.approx(0.27 + 0.15)  # the pedestal's
    assert least_x == pytest.approx(-0.319 - 0.0759 if base == "mecanum" else -0.1)
    assert (least_y, most_y) == pytest.approx((-0.3255, 0.3255))
