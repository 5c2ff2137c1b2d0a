"""Base and arm as one robot: the Thing by two roads, its frames and limits, and another make of robot."""

import pickle

import numpy as np
import pytest
from jacobians import assert_is_jacobian

from longreach.errors import ModelError
from longreach.geometry import se3, so3
from longreach.io.config import description_file
from longreach.io.robots import load_robot
from longreach.robot.chain import KinematicChain
from longreach.robot.description import Arm, RobotDescription
from longreach.robot.dh import rows_of
from longreach.robot.footprint import footprint_of
from longreach.robot.mobile_manipulator import MobileManipulator

QUARTER = np.pi / 2
ARM = [
    (0.1273, 0, 0, QUARTER),
    (0, 0, -0.612, 0),
    (0, 0, -0.5723, 0),
    (0.163941, 0, 0, QUARTER),
    (0.1157, 0, 0, -QUARTER),
    (0.0922, 0, 0, 0),
]
TABLE_B1 = [
    (0, QUARTER, 0, QUARTER, "fixed"),
    (0, QUARTER, 0, QUARTER, "prismatic"),
    (0, QUARTER, 0, QUARTER, "prismatic"),
    (0, 0, 0, 0),
    (0.653, 0, 0.27, 0, "fixed"),
    (0, QUARTER, 0.01, 0, "fixed"),
    *ARM,
]
THING, UR10, PANDA = load_robot("thing"), load_robot("ur10"), load_robot("panda_cart")


def planar(x, y, theta):
    return se3.from_rotation_translation(so3.exp(np.array([0.0, 0.0, theta])), np.array([x, y, 0.0]))


def test_the_things_urdf_is_the_chain_of_table_b1(rng):
    table = KinematicChain.from_dh(rows_of(TABLE_B1))
    for q in rng.uniform(-6, 6, (200, 9)):
        T, J = THING.with_tool("flange").forward_and_jacobian(q)
        T_table, J_table = table.forward_and_jacobian(q)
        np.testing.assert_allclose(T, T_table, atol=1e-12)
        np.testing.assert_allclose(J, J_table, atol=1e-12)


def test_the_tool_is_0_290_m_beyond_the_flange(rng):
    q = rng.uniform(-3, 3, 9)
    T = THING.frame("flange", q)
    assert THING.tool == "tool"
    np.testing.assert_allclose(THING.forward(q), T @ se3.exp(np.array([0, 0, 0.29, 0, 0, 0])), atol=1e-14)


def test_the_ur10_alone_is_the_table_from_row_7_on(rng):
    table = KinematicChain.from_dh(rows_of(ARM))
    Q = rng.uniform(-6, 6, (50, 6))
    np.testing.assert_allclose(UR10.forward(Q), table.forward(Q), atol=1e-13)
    assert (UR10.dof, UR10.base, UR10.arm, UR10.tool) == (6, slice(0, 0), slice(0, 6), "flange")


def test_frames_on_the_base_move_with_it_and_not_with_the_arm(rng):
    q = rng.uniform(-3, 3, 9)
    T_world_base = planar(*q[:3])
    np.testing.assert_allclose(THING.frame("base_link", q), T_world_base, atol=1e-15)
    for name, sensor in (("front_laser", THING.description.lidar), ("imu_link", THING.description.imu)):
        np.testing.assert_allclose(THING.frame(name, q), T_world_base @ sensor.mount.matrix(), atol=1e-14)
        _, J = THING.frame_and_jacobian(name, q)
        np.testing.assert_array_equal(J[:, THING.arm], 0.0)
    assert {"kinect2", "realsense", "ft300", "gripper", "tool", "flange", "base_link", "world"} <= set(THING.frames)
    assert not [name for name in THING.frames if "finger" in name or "wheel" in name]
    np.testing.assert_array_equal(THING.frame("world", q), np.eye(4))


@pytest.mark.parametrize("robot", [THING, UR10, PANDA], ids=lambda robot: robot.name)
def test_the_jacobian_and_the_hessian_of_every_robot_are_derivatives(rng, robot):
    q = rng.uniform(-2, 2, robot.dof)
    T, J = robot.forward_and_jacobian(q)

    def motion(a, b):
        return np.concatenate([b[:3, 3] - a[:3, 3], so3.log(b[:3, :3] @ a[:3, :3].T)])

    assert_is_jacobian(robot.forward, J, q, difference=motion)
    flat = np.moveaxis(robot.hessian(q), 0, -1).reshape(-1, robot.dof)
    assert_is_jacobian(lambda x: robot.forward_and_jacobian(x)[1].ravel(), flat, q)
    np.testing.assert_array_equal(robot.forward(q), T)


def test_the_things_limits_are_those_of_its_makers():
    turn = 2 * np.pi
    np.testing.assert_allclose(THING.upper, [10, 10, *[turn] * 7])
    np.testing.assert_allclose(THING.lower, -THING.upper)
    degrees = np.radians([120, 120, 180, 180, 180, 180])
    np.testing.assert_allclose(THING.limits.velocity, [1.1, 1.1, 2.0, *degrees])
    np.testing.assert_allclose(THING.limits.acceleration, [2.5, 2.5, 1.0, *[10] * 6])
    np.testing.assert_allclose(THING.limits.effort[THING.arm], [330, 330, 150, 56, 56, 56])
    for name in ("lower", "upper", "velocity", "acceleration", "effort"):
        np.testing.assert_allclose(getattr(UR10.limits, name), getattr(THING.limits, name)[THING.arm])


def test_the_urdf_keeps_the_grippers_fingers_shapes_and_masses():
    fingers = [joint.name for joint in THING.urdf.joints if joint.moves and joint.name.startswith("finger_")]
    assert len(fingers) == 11
    wheels = [joint.name for joint in THING.urdf.joints if joint.kind == "continuous"]
    assert sorted(wheels) == sorted(THING.description.base.wheel_names)
    masses = {name: link.inertial.mass for name, link in THING.urdf.links.items() if link.inertial}
    arm = ("arm_base_link", "shoulder_link", "upper_arm_link", "forearm_link")
    np.testing.assert_allclose([masses[name] for name in arm], [4.0, 7.778, 12.93, 3.87])
    assert masses["base_link"] + masses["pedestal"] == pytest.approx(165)
    for link in THING.urdf.links.values():
        if link.inertial:
            assert np.all(np.linalg.eigvalsh(link.inertial.inertia) > 0)
            assert link.visuals


def test_with_tool_and_with_limits_give_new_robots_and_leave_the_old_one():
    q = np.zeros(9)
    changed = THING.with_limits(THING.lower / 2, THING.upper / 2).with_tool("gripper")
    assert (changed.tool, THING.tool) == ("gripper", "tool")
    np.testing.assert_array_equal(changed.upper, THING.upper / 2)
    np.testing.assert_array_equal(changed.forward(q), THING.frame("gripper", q))
    np.testing.assert_array_equal(changed.limits.velocity, THING.limits.velocity)
    np.testing.assert_array_equal(changed.with_tool("tool").upper, THING.upper / 2)
    with pytest.raises(ValueError, match="read-only"):
        changed.upper[0] = 0.0


def test_a_robot_survives_being_sent_to_another_process(rng):
    again = pickle.loads(pickle.dumps(THING))
    q = rng.uniform(-2, 2, 9)
    np.testing.assert_array_equal(again.forward_and_jacobian(q)[1], THING.forward_and_jacobian(q)[1])
    assert again.description == THING.description


def test_an_unknown_frame_and_limits_that_cannot_be_are_refused():
    for use in (THING.with_tool, lambda name: THING.frame(name, np.zeros(9))):
        with pytest.raises(ModelError, match=r"no frame 'hand'; there are world, .*flange, ft300, tool, gripper"):
            use("hand")
    with pytest.raises(ModelError, match=r"lower limit 10 of joint 0 \(from 0\) is not below its upper limit -10"):
        THING.with_limits(THING.upper, THING.lower)
    with pytest.raises(ModelError, match="q has 9 numbers"):
        THING.with_limits(THING.lower[:6], THING.upper[:6])
    with pytest.raises(ModelError, match="have a NaN"):
        THING.with_limits(THING.lower * np.nan, THING.upper)


def test_a_panda_on_a_cart_works_like_the_thing(rng):
    assert (PANDA.dof, PANDA.base, PANDA.arm) == (10, slice(0, 3), slice(3, 10))
    assert PANDA.description.base.kind == "differential"
    assert not PANDA.description.holonomic
    # Its maker's modified DH parameters (a, d, α before the joint), written out.
    craig = [
        (0, 0.333, 0),
        (0, 0, -QUARTER),
        (0, 0.316, QUARTER),
        (0.0825, 0, QUARTER),
        (-0.0825, 0.384, -QUARTER),
        (0, 0, QUARTER),
        (0.088, 0, QUARTER),
    ]
    q = rng.uniform(-2, 2, 10)
    T = planar(*q[:3]) @ se3.exp(np.array([0.1, 0, 0.4, 0, 0, 0]))
    for (a, d, alpha), angle in zip(craig, q[3:], strict=True):
        T = T @ se3.exp(np.array([0.0, 0, 0, alpha, 0, 0])) @ se3.exp(np.array([a, 0.0, 0, 0, 0, 0]))
        T = T @ se3.exp(np.array([0.0, 0, d, 0, 0, 0])) @ se3.exp(np.array([0.0, 0, 0, 0, 0, angle]))
    T = T @ se3.exp(np.array([0, 0, 0.107, 0, 0, 0]))
    np.testing.assert_allclose(PANDA.frame("flange", q), T, atol=1e-13)
    assert PANDA.upper[6] == -0.0698


def test_a_description_without_an_arm_is_its_base(tmp_path):
    robot = MobileManipulator.from_description(RobotDescription(name="cart"), tmp_path)
    q = np.array([1.0, 2.0, 0.3])
    assert (robot.dof, robot.tool, robot.arm) == (3, "base_link", slice(3, 3))
    np.testing.assert_allclose(robot.forward(q), planar(*q), atol=1e-15)


def test_a_sensor_that_the_urdf_places_elsewhere_is_refused():
    moved = {"lidar": {"frame": "front_laser", "mount": {"x": 0.1}}}
    description = RobotDescription.model_validate({**THING.description.model_dump(mode="json"), **moved})
    with pytest.raises(ModelError, match="place front_laser differently"):
        MobileManipulator.from_description(description, description_file("thing").parent)


@pytest.mark.parametrize("taken", ["world", "map", "odom", "base_x_link", "base_y_link"])
def test_a_link_with_the_name_of_a_frame_of_ours_is_renamed_and_nothing_loops(tmp_path, taken):
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{a}"/><child link="{b}"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1"/></joint>'
        for name, a, b in (("base_x", taken, "middle"), ("base_theta", "middle", "hand"))
    )
    links = "".join(f'<link name="{name}"/>' for name in (taken, "middle", "hand"))
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm">{links}{joints}</robot>')
    robot = MobileManipulator.from_description(RobotDescription(name="r", arm=Arm(urdf="arm.urdf")), tmp_path)
    assert robot.joint_names == ("robot_base_x", "base_y", "robot_base_theta", "base_x", "base_theta")
    assert robot.urdf.root == f"robot_{taken}"
    assert len(set(robot.frames)) == 6
    assert footprint_of(robot).rectangle.tolist() == [-0.3, 0.3, -0.25, 0.25]
