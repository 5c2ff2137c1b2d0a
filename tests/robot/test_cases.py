"""Descriptions as users have them, with the right answers."""

import numpy as np
import pytest

import longreach as lr
from longreach.geometry import so3


@pytest.mark.parametrize(
    ("case", "mount"), [("a01_fixed_joint_axis_zero", "mount"), ("a02_link_named_world", "robot_world")]
)
def test_meaningless_axes_and_links_with_our_names_are_no_trouble(cases, case, mount):
    robot = lr.load_robot(cases / case / "robot.yaml")
    assert robot.joint_names == ("base_x", "base_y", "base_theta", "j1", "j2")
    assert robot.urdf.root == mount
    turned = so3.exp(np.array([0.0, 0.0, 0.7]))
    np.testing.assert_allclose(
        robot.forward(np.array([1.0, 2.0, 0.3, 0.4, 0.5]))[:3, 3], [1, 2, 0.3] + turned @ [0.3, 0, 0]
    )


@pytest.mark.parametrize("name", ["back", "short"])
def test_mecanum_wheels_of_any_names_load(cases, name):
    base = lr.load_robot(cases / "a14_wheel_names" / f"{name}.yaml").description.base
    assert base.wheel_corners == ("front_left", "rear_left", "rear_right", "front_right")


def test_a_skid_steered_base_loads(cases):
    base = lr.load_robot(cases / "a14_wheel_names" / "skid.yaml").description.base
    np.testing.assert_allclose(base.forward_matrix @ [1.0, 2.0, 1.0, 2.0], [0.165 * 1.5, 0.0, 0.165 / 0.57])
