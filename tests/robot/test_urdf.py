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


def two_trees():
    more = '<link name="islet"/><link name="buoy"/><joint name="rope" type="fixed"><parent link="islet"/>'
    return edited("</robot>", f'{more}<child link="buoy"/></joint></robot>')


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "not XML"),
        ("<sdf/>", "outermost element is <robot>, this one's is <sdf>"),
        (
            '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:arm/></robot>',
            r"This is xacro, not URDF \(<xacro:arm>\); expand it first",
        ),
        ("<robot/>", "There is no <link> in it"),
        ('<robot><robot name="inner"/></robot>', "A <robot> stands inside of another one"),
        (
            edited('xyz="0 0 0.3"', 'xyz="0 0 ${height}"'),
            r"This is xacro, not URDF \(0 0 \$\{height\}\); expand it first",
        ),
        (edited("</robot>", "<xacro:arm/></robot>"), "This is xacro, not URDF \\(<xacro:arm>\\); expand it first"),
        (edited('<child link="hand"/>', '<child link="plate"/>'), "plate hangs on two joints, lift and grip: a loop"),
        (edited('<child link="hand"/>', '<child link="foot"/>'), "Joint lift is in a loop"),
        (edited('<parent link="plate"/>', '<parent link="hand"/>'), "Joint turn is in a loop"),
        (edited('<parent link="plate"/>', '<parent link="nowhere"/>'), "names the link nowhere, which is not there"),
        (edited('<parent link="plate"/>', ""), "Joint turn must name a parent and a child"),
        (two_trees(), "foot, islet hang on no joint, so there are 2 trees; say which link ends the chain"),
        (edited('<link name="hand"/>', '<link name="hand"/><link name="head"/>'), "two links named head"),
        (edited('name="grip"', 'name="turn"'), "two joints named turn"),
        (edited('<link name="hand"/>', "<link/>"), "A <link> has no name"),
        (edited('<cylinder radius="0.5" ', '<cone radius="0.5" '), "a <cone>; there are box, cylinder, sphere, mesh"),
        (
            edited('<geometry><cylinder radius="0.5" length="2"/></geometry>', ""),
            "Link foot: A <collision> has no geom",
        ),
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


FAULTS = [
    (edited('type="continuous"', 'type="helical"'), "Joint turn: It is of the type 'helical'; there are fixed, revol"),
    (edited('type="continuous"', 'type="floating"'), "Joint turn is floating; a chain's joints are revolute"),
    (
        edited('type="continuous"', 'type="planar"'),
        "Joint turn is planar; .*Make it fixed: a mobile base moves by x, y",
    ),
    (edited('<axis xyz="0 1 0"/>', '<axis xyz="0 1 0"/><mimic joint="lift"/>'), "Joint turn mimics lift"),
    (edited('lower="0" upper="0.5"', 'lower="0.5" upper="0"'), "Joint lift: .*lower limit 0.5 is not below"),
    (edited('lower="0" upper="0.5"', ""), "Joint lift: Its lower and upper limit are both 0 .*cannot move"),
    (edited('velocity="0.1"', 'velocity="-1"'), "Joint lift: Its velocity limit is -1; give one above 0"),
    (edited('effort="100"', 'effort="much"'), "Joint lift: The effort of <limit> is 'much'; expected 1 finite number"),
    (edited('xyz="0 0 2"', 'xyz="0 0 0"'), "Joint lift: The axis has no direction"),
    (edited('xyz="0 0 0.3"', 'xyz="0 0 nan"'), "xyz of <origin> is '0 0 nan'; expected 3 finite numbers"),
    (edited('xyz="0 0 0.3"', 'xyz="0 0"'), "expected 3 finite numbers"),
]


@pytest.mark.parametrize(("text", "message"), FAULTS)
def test_what_is_wrong_with_a_joint_matters_only_in_a_chain_that_it_is_part_of(text, message):
    urdf = parse_urdf(text)
    with pytest.raises(ModelError, match=message):
        KinematicChain.from_joints(urdf.joints, "foot", "hand")
    assert KinematicChain.from_joints(urdf.joints, "foot", "foot").dof == 0
    assert "hand" not in KinematicChain.from_joints(urdf.joints, "foot", "foot").frames


def test_values_that_have_no_meaning_are_ignored():
    fixed = '<joint name="grip" type="fixed"><axis xyz="0 0 0"/><limit lower="x" upper="-1" velocity="-1"/>'
    endless = '<axis xyz="0 1 0"/><limit lower="3" upper="-3"/><mimic joint="turn"/>'.replace(
        '<mimic joint="turn"/>', ""
    )
    text = edited('<joint name="grip" type="fixed">', fixed).replace('<axis xyz="0 1 0"/>', endless)
    chain = KinematicChain.from_joints(parse_urdf(text).joints, "foot", "hand")
    assert chain.joint_names == ("lift", "turn")
    np.testing.assert_array_equal(chain.limits.upper, [0.5, np.inf])


@pytest.mark.parametrize(
    "content",
    [
        "\ufeff \n" + LIFT,
        b"\xef\xbb\xbf" + LIFT.encode(),
        LIFT.encode("utf-16"),
        LIFT.replace("\n", "\r\n").encode(),
        edited("<material", "<!-- f\xfcr --><material").encode("latin-1"),
        b'<?xml version="1.0" encoding="ISO-8859-1"?>'
        + edited("<material", "<!-- \xfc --><material").encode("latin-1"),
        edited(
            '<robot name="lift">', '<robot name="lift" xmlns="http://ros.org" xmlns:xacro="http://ros.org/wiki/xacro">'
        ),
        edited("</robot>", "<gazebo><plugin><joint/></plugin></gazebo><sensor:camera/><transmission/></robot>"),
        edited("</robot>", '<ros2_control type="system"><joint name="lift"><param/></joint></ros2_control></robot>'),
        edited("</robot>", '<link name="world"/></robot>'),
        edited('<box size="1 2 3"/>', '<cone size="1 2 3"/>').replace('rgba="1 0 0 1"', 'rgba="1 0 0"'),
    ],
)
def test_encodings_and_elements_of_other_tools_change_nothing(content):
    lift = parse_urdf(content)
    assert (lift.root, [joint.name for joint in lift.joints]) == ("foot", ["lift", "turn", "grip"])


def test_of_several_trees_the_one_with_the_chains_end_is_taken():
    assert parse_urdf(two_trees(), "hand").root == "foot"
    other = parse_urdf(two_trees(), "buoy")
    assert (other.root, list(other.links)) == ("islet", ["islet", "buoy"])
