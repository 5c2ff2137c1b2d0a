"""Chains from DH tables and from URDF: the numbers of the thesis, frames, limits, and what is refused."""

import numpy as np
import pytest

from longreach.errors import ModelError
from longreach.geometry import se3, so3
from longreach.robot.chain import JointLimits, KinematicChain
from longreach.robot.dh import DhRow, rows_of
from longreach.robot.joint import Joint, Limits

QUARTER = np.pi / 2
TABLE_B1 = [
    (0, QUARTER, 0, QUARTER, "fixed"),
    (0, QUARTER, 0, QUARTER, "prismatic"),
    (0, QUARTER, 0, QUARTER, "prismatic"),
    (0, 0, 0, 0),
    (0.653, 0, 0.27, 0, "fixed"),
    (0, QUARTER, 0.01, 0, "fixed"),
    (0.1273, 0, 0, QUARTER),
    (0, 0, -0.612, 0),
    (0, 0, -0.5723, 0),
    (0.163941, 0, 0, QUARTER),
    (0.1157, 0, 0, -QUARTER),
    (0.0922, 0, 0, 0),
]


def row_by_row(table, q):
    """(3.7) and (3.8), written out: the independent road."""
    T, numbers = np.eye(4), iter(q)
    for d, theta, a, alpha, *kind in table:
        if not kind or kind[0] == "revolute":
            theta += next(numbers)
        elif kind[0] == "prismatic":
            d += next(numbers)
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T = T @ [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
    return T


def test_table_b1_puts_the_flange_where_the_thesis_has_it():
    chain = KinematicChain.from_dh(rows_of(TABLE_B1))
    T = chain.forward(np.array([1, 2, 0.3, 0, -QUARTER, 0, 0, 0, 0]))
    np.testing.assert_allclose(T[:3, 3], [1.5339, 2.0545, 1.9646], atol=5e-5)
    np.testing.assert_array_equal(chain.prismatic, [True, True] + [False] * 7)


def test_any_table_gives_what_its_rows_multiply_to(rng):
    for kinds in (["revolute"] * 5, ["prismatic", "revolute", "fixed", "prismatic", "revolute"]):
        table = [(*rng.uniform(-2, 2, 4), kind) for kind in kinds]
        chain = KinematicChain.from_dh(rows_of(table))
        for q in rng.uniform(-3, 3, (20, chain.dof)):
            np.testing.assert_allclose(chain.forward(q), row_by_row(table, q), atol=1e-13)


def test_frames_of_a_table_stand_at_the_ends_of_its_rows(rng):
    rows = [DhRow(d=0.3, a=0.1, alpha=1.0, frame="elbow"), DhRow(a=0.5, theta=0.2), DhRow(d=0.1, frame="hand")]
    chain = KinematicChain.from_dh(rows, root="foot")
    assert chain.end == "hand"
    assert {"foot", "elbow", "link_2", "hand"} <= set(chain.frames)
    q = rng.uniform(-3, 3, 3)
    expected = row_by_row([(0.3, 0, 0.1, 1.0)], q)
    np.testing.assert_allclose(chain.ending("elbow").forward(q), expected, atol=1e-14)


def test_limits_of_a_table_are_those_of_its_rows():
    rows = [DhRow(lower=-1, upper=2, velocity=3, acceleration=4, effort=5), DhRow(joint="prismatic")]
    limits = KinematicChain.from_dh(rows).limits
    np.testing.assert_array_equal(limits.lower, [-1, -np.inf])
    np.testing.assert_array_equal(limits.upper, [2, np.inf])
    np.testing.assert_array_equal(
        [limits.velocity, limits.acceleration, limits.effort], [[3, np.inf], [4, np.inf], [5, np.inf]]
    )


@pytest.mark.parametrize("axis", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
def test_a_joint_turns_about_its_axis_and_quarter_turns_leave_no_rounding(axis):
    joint = Joint("j", "revolute", "a", "b", axis=tuple(map(float, axis)))
    chain = KinematicChain.from_joints([joint], "a", "b")
    np.testing.assert_allclose(chain.forward(np.array([0.7]))[:3, :3], so3.exp(0.7 * np.array(axis, float)), atol=1e-15)
    np.testing.assert_array_equal(chain.fixed, np.rint(chain.fixed))


def test_what_a_joint_outside_the_chain_moves_is_no_frame_of_it_and_what_is_fixed_to_it_is():
    T = se3.exp(np.array([0.1, 0.2, 0.3, 0.0, 0.0, 0.4]))
    joints = [
        Joint("j1", "revolute", "base", "arm"),
        Joint("finger", "revolute", "arm", "fingertip"),
        Joint("nail_joint", "fixed", "fingertip", "nail"),
        Joint("camera_joint", "fixed", "arm", "camera", T),
        Joint("lens_joint", "fixed", "camera", "lens", T),
    ]
    chain = KinematicChain.from_joints(joints, "base", "arm")
    assert tuple(chain.frames) == ("base", "arm", "camera", "lens")
    q = np.array([0.3])
    np.testing.assert_allclose(chain.ending("lens").forward(q), chain.forward(q) @ T @ T, atol=1e-15)
    further = chain.with_frame("flash", "camera", T).ending("flash")
    np.testing.assert_allclose(further.forward(q), chain.ending("lens").forward(q), atol=1e-15)
    assert KinematicChain.from_joints(joints, "base", "nail").joint_names == ("j1", "finger")
    np.testing.assert_allclose(chain.relative("camera", "lens"), T, atol=1e-15)


def test_an_unknown_frame_is_refused_with_the_list_of_those_there_are():
    chain = KinematicChain.from_dh(rows_of(TABLE_B1[6:]))
    for use in (chain.ending, lambda name: chain.with_frame("new", name, np.eye(4))):
        with pytest.raises(ModelError, match=r"no frame 'wrist'; there are base_link, .*link_6"):
            use("wrist")
    with pytest.raises(ModelError, match=r"no frame 'wrist' beyond base_link; there are base_link, .*link_6"):
        KinematicChain.from_dh(rows_of(TABLE_B1[6:]), end="wrist")
    with pytest.raises(ModelError, match="a frame link_6 already"):
        chain.with_frame("link_6", "base_link", np.eye(4))


def test_limits_that_cannot_be_are_refused():
    with pytest.raises(ModelError, match=r"lower limit 2 is not below its upper limit 1; exchange them"):
        Limits(2.0, 1.0)
    with pytest.raises(ModelError, match="must be above 0"):
        Limits(velocity=0.0)
    good = {name: np.ones(2) for name in ("velocity", "acceleration", "effort")}
    with pytest.raises(ModelError, match=r"lower limit 3 of joint 1 \(from 0\) is not below"):
        JointLimits(np.array([0.0, 3.0]), np.array([1.0, 2.0]), **good)
    with pytest.raises(ModelError, match="have a NaN"):
        JointLimits(np.array([0.0, np.nan]), np.array([1.0, 2.0]), **good)
    limits = JointLimits(np.zeros(2), np.ones(2), **good)
    with pytest.raises(ModelError, match="limits for 2 joints, but the chain has 6"):
        KinematicChain.from_dh(rows_of(TABLE_B1[6:])).with_limits(limits)


def test_a_chain_is_not_made_of_joints_it_cannot_move():
    for kind in ("planar", "floating"):
        with pytest.raises(ModelError, match=f"is {kind}"):
            KinematicChain.from_joints([Joint("j", kind, "a", "b")], "a", "b")
    with pytest.raises(ModelError, match="mimics other"):
        KinematicChain.from_joints([Joint("j", "revolute", "a", "b", mimic="other")], "a", "b")
    with pytest.raises(ModelError, match="at least one row"):
        KinematicChain.from_dh([])
