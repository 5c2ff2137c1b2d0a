"""The URDF reader: what it keeps, and a sentence for each file that is wrong."""

import numpy as np
import pytest

from longreach.errors import ModelError
from longreach.geometry import so3
from longreach.robot.chain import KinematicChain
from longreach.robot.urdf import parse_urdf, read_urdf

LIFT = """<robot name="lift">
  <material name="red"><color rgba="1 0 0 1"/></material>
  <link name="foot">
    <visual><origin xyz="0 0 0.1"/><geometry><box size="1 2 3"/></geometry><material name="red"/></visual>
    <collision><geometry><cylinder radius="0.5" length="2"/></geometry></collision>
    <inertial><mass value="12"/><inertia ixx="1" iyy="2" izz="3" ixy="0.1"/></inertial>
  </link>
  <link name="plate"><visual><geometry><sphere radius="0.2"/></geometry></visual></link>
  <link name="head"><visual><geometry><mesh filename="head.stl" scale="2 2 2"/></geometry></visual></link>
  <link name="hand"/>
  <joint name="lift" type="prismatic">
    <parent link="foot"/><child link="plate"/><origin xyz="0 0 1"/><axis xyz="0 0 2"/>
    <limit lower="0" upper="0.5" velocity="0.1" effort="100"/>
  </joint>
  <joint name="turn" type="continuous">
    <parent link="plate"/><child link="head"/><origin xyz="0.1 0 0" rpy="0.1 0.2 0.3"/><axis xyz="0 1 0"/>
  </joint>
  <joint name="grip" type="fixed"><parent link="head"/><child link="hand"/><origin xyz="0 0 0.3"/></joint>
</robot>"""


def test_shapes_masses_and_limits_are_kept():
    lift = parse_urdf(LIFT)
    assert (lift.name, lift.root, [joint.name for joint in lift.joints]) == ("lift", "foot", ["lift", "turn", "grip"])
    foot = lift.links["foot"]
    assert (foot.visuals[0].kind, foot.visuals[0].size, foot.visuals[0].colour) == ("box", (1, 2, 3), (1, 0, 0, 1))
    assert foot.visuals[0].T_link_shape[2, 3] == 0.1
    assert (foot.collisions[0].kind, foot.collisions[0].size) == ("cylinder", (0.5, 2))
    assert foot.inertial.mass == 12
    np.testing.assert_array_equal(foot.inertial.inertia, [[1, 0.1, 0], [0.1, 2, 0], [0, 0, 3]])
    assert lift.links["plate"].visuals[0].size == (0.2,)
    assert (lift.links["head"].visuals[0].mesh, lift.links["head"].visuals[0].size) == ("head.stl", (2, 2, 2))
    assert (lift.joints[0].limits.upper, lift.joints[0].limits.velocity, lift.joints[0].axis) == (0.5, 0.1, (0, 0, 1))
    assert lift.joints[1].limits.upper == np.inf


def test_a_chain_of_sliding_and_turning_joints_is_read(tmp_path):
    (tmp_path / "lift.urdf").write_text(LIFT)
    chain = KinematicChain.from_urdf(tmp_path / "lift.urdf")
    assert (chain.joint_names, chain.end, chain.dof) == (("lift", "turn"), "hand", 2)
    T = chain.forward(np.array([0.25, 0.7]))
    R = so3.from_roll_pitch_yaw(0.1, 0.2, 0.3) @ so3.exp(np.array([0.0, 0.7, 0.0]))
    np.testing.assert_allclose(T[:3, :3], R, atol=1e-15)
    np.testing.assert_allclose(T[:3, 3], [0.1, 0, 1.25] + R @ [0, 0, 0.3], atol=1e-15)
    assert KinematicChain.from_urdf(tmp_path / "lift.urdf", root="plate", end="head").joint_names == ("turn",)


def edited(old, new):
    assert old in LIFT
    return LIFT.replace(old, new)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "not XML"),
        ("<sdf/>", "outermost element is <robot>, this one's is <sdf>"),
        ('<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arm/></robot>', "xacro, not URDF; expand it first"),
        ("<robot/>", "no link at all"),
        (edited('type="continuous"', 'type="helical"'), "Joint turn is of the type 'helical'; there are fixed, revol"),
        (edited('<child link="hand"/>', '<child link="plate"/>'), "plate hangs on two joints, lift and grip: a loop"),
        (edited('<child link="hand"/>', '<child link="foot"/>'), "The links hand hang|Joint lift is in a loop"),
        (edited('<parent link="plate"/>', '<parent link="hand"/>'), "Joint turn is in a loop"),
        (edited('<parent link="plate"/>', '<parent link="nowhere"/>'), "names the link nowhere, which is not there"),
        (edited('<parent link="plate"/>', ""), "Joint turn must name a parent and a child"),
        (edited('lower="0" upper="0.5"', 'lower="0.5" upper="0"'), "Joint lift: .*lower limit 0.5 is not below"),
        (edited('xyz="0 0 2"', 'xyz="0 0 0"'), "Joint lift: The axis has no direction"),
        (edited('xyz="0 0 0.3"', 'xyz="0 0 nan"'), "xyz of <origin> is '0 0 nan'; expected 3 finite numbers"),
        (edited('xyz="0 0 0.3"', 'xyz="0 0"'), "expected 3 finite numbers"),
        (edited('<link name="hand"/>', '<link name="hand"/><link name="island"/>'), "foot, island hang on no joint"),
        (edited('<link name="hand"/>', '<link name="hand"/><link name="head"/>'), "two links named head"),
        (edited('name="grip"', 'name="turn"'), "two joints named turn"),
        (edited('<link name="hand"/>', "<link/>"), "A <link> has no name"),
        (edited('<box size="1 2 3"/>', '<cone size="1 2 3"/>'), "a <cone>; there are box, cylinder, sphere, mesh"),
        (edited('<geometry><box size="1 2 3"/></geometry>', ""), "Link foot: A <visual> has no geometry"),
        (edited('radius="0.5" ', ""), "radius of <cylinder> is missing"),
        (edited('<mass value="12"/>', ""), "no mass"),
    ],
)
def test_a_urdf_that_is_wrong_is_refused_with_a_sentence(text, message):
    with pytest.raises(ModelError, match=message):
        parse_urdf(text)


def test_a_ring_of_links_is_a_loop():
    links = "".join(f'<link name="{name}"/>' for name in "abc")
    ring = "".join(
        f'<joint name="{a}{b}" type="fixed"><parent link="{a}"/><child link="{b}"/></joint>' for a, b in ("ab", "ba")
    )
    with pytest.raises(ModelError, match="Joint ab is in a loop"):
        parse_urdf(f"<robot>{links}{ring}</robot>")


def test_a_file_that_is_not_there_and_a_file_that_is_wrong_are_named(tmp_path):
    with pytest.raises(ModelError, match=r"nothing\.urdf cannot be read"):
        read_urdf(tmp_path / "nothing.urdf")
    (tmp_path / "bad.urdf").write_text("<robot>")
    with pytest.raises(ModelError, match=r"bad\.urdf: This is not XML"):
        KinematicChain.from_urdf(tmp_path / "bad.urdf")


def test_a_robot_that_branches_must_be_told_its_end(tmp_path):
    (tmp_path / "a.urdf").write_text(edited('<parent link="head"/>', '<parent link="plate"/>'))
    with pytest.raises(ModelError, match="say which of head, hand, or another link, ends the chain"):
        KinematicChain.from_urdf(tmp_path / "a.urdf")
