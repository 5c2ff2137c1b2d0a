"""solve_ik and all_solutions against a DH forward kinematics of their own, on arms with and without a closed form."""

import numpy as np
import pytest
from dh_tables import CALIBRATED, PUMA, SLIDING, UR10, limited, table_pose, thing_pose

import longreach as lr
from longreach.errors import PlanningError
from longreach.geometry import se3
from longreach.planning.inverse_kinematics import all_solutions, solve_ik
from longreach.planning.ur_arm import ur_arm
from longreach.robot.chain import KinematicChain
from longreach.robot.dh import rows_of
from longreach.robot.joint import Joint
from longreach.robot.mobile_manipulator import turned_like

HOME = np.array([0.0, -2.0, 2.0, -1.5, -1.57, 0.0])


def thing(reach):
    reach = np.array(reach)
    return lr.load_robot("thing").with_tool("flange").with_limits(-reach, reach)


ELBOW = (np.pi, np.pi, 2.8, np.pi, np.pi, np.pi)
ROBOTS = {
    "thing": (thing([10.0] * 2 + [2 * np.pi] * 7), thing_pose),
    "thing, tight": (thing([0.01, 0.01, 0.1, *ELBOW]), thing_pose),
    "ur10": (limited(UR10, 2 * np.pi), lambda q: table_pose(UR10, q)),
    "ur10, ±π": (limited(UR10, ELBOW), lambda q: table_pose(UR10, q)),
    "calibrated": (limited(CALIBRATED, 2 * np.pi), lambda q: table_pose(CALIBRATED, q)),
    "puma": (limited(PUMA, 3.0), lambda q: table_pose(PUMA, q)),
    "sliding": (limited(SLIDING, [3, 2.5, 0.2, 3, 2, 2, 3]), lambda q: table_pose(SLIDING, q)),
    "panda on a cart": (lr.load_robot("panda_cart"), lr.load_robot("panda_cart").forward),
}
URS = ["ur10", "ur10, ±π", "calibrated"]


def assert_solved(robot, pose, T, solution):
    assert solution.converged
    assert solution.violated == ()
    assert np.all(robot.limits.lower <= solution.q)
    assert np.all(solution.q <= robot.limits.upper)
    np.testing.assert_allclose(pose(solution.q), T, atol=2e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_pose_that_can_be_reached_is_reached_inside_the_limits(name, rng):
    robot, pose = ROBOTS[name]
    lower, upper = np.maximum(robot.limits.lower, -7.0), np.minimum(robot.limits.upper, 7.0)
    seed = 0.5 * (lower + upper)
    for q in rng.uniform(lower, upper, (300, robot.dof)):
        T = pose(q)
        assert_solved(robot, pose, T, solve_ik(robot, T, seed))


@pytest.mark.parametrize("name", ROBOTS)
def test_a_seed_that_is_there_already_is_the_answer(name, rng):
    robot, pose = ROBOTS[name]
    lower, upper = np.maximum(robot.limits.lower, -7.0), np.minimum(robot.limits.upper, 7.0)
    for q in rng.uniform(lower, upper, (20, robot.dof)):
        np.testing.assert_allclose(solve_ik(robot, pose(q), q).q, q, atol=1e-6)


@pytest.mark.parametrize("name", ["thing", "ur10", "calibrated", "panda on a cart"])
def test_a_small_way_of_the_tool_is_a_small_way_of_the_joints(name, rng):
    robot, pose = ROBOTS[name]
    q = np.concatenate([np.zeros(robot.dof - 6), HOME]) if name != "panda on a cart" else robot.lower * 0.3
    for xi in rng.normal(size=(20, 6)) * 0.01:
        solution = solve_ik(robot, se3.compose(pose(q), se3.exp(xi)), q)
        assert np.max(np.abs(solution.q - q)) < 0.15


def test_the_answer_is_the_same_each_time_and_takes_no_part_of_the_seed_along(rng):
    robot, pose = ROBOTS["thing, tight"]
    seed = np.concatenate([np.zeros(3), HOME])
    for q in rng.uniform(robot.lower, robot.upper, (20, 9)):
        first, second = (solve_ik(robot, pose(q), seed) for _ in range(2))
        np.testing.assert_array_equal(first.q, second.q)
        np.testing.assert_array_equal(seed, np.concatenate([np.zeros(3), HOME]))
        assert not first.q.flags.writeable


def test_a_seed_outside_the_limits_is_no_reason_to_fail(rng):
    robot, pose = ROBOTS["thing, tight"]
    for q in rng.uniform(robot.lower, robot.upper, (20, 9)):
        seed = 5.0 * rng.normal(size=9)
        assert_solved(turned_like(robot, seed), pose, pose(q), solve_ik(robot, pose(q), seed))


def test_joints_without_limits_and_joints_beyond_the_tool_are_allowed(rng):
    rows = rows_of(PUMA)
    free = KinematicChain.from_dh(rows)
    assert np.all(np.isinf(free.limits.upper))
    for q in rng.uniform(-3, 3, (20, 6)):
        assert_solved(
            free, lambda x: table_pose(PUMA, x), table_pose(PUMA, q), solve_ik(free, table_pose(PUMA, q), HOME)
        )
    longer = KinematicChain.from_dh(rows_of([*UR10, *PUMA[:2]])).ending("link_6")
    solution = solve_ik(longer, table_pose(UR10, HOME), np.ones(8))
    np.testing.assert_allclose(longer.forward(solution.q), table_pose(UR10, HOME), atol=1e-9)
    np.testing.assert_array_equal(solution.q[6:], 1.0)


@pytest.mark.parametrize("name", URS)
def test_all_solutions_are_solutions_and_the_generating_posture_is_among_them(name, rng):
    robot, pose = ROBOTS[name]
    for q in rng.uniform(robot.limits.lower, robot.limits.upper, (200, 6)):
        T = pose(q)
        Q = all_solutions(robot, T)
        assert 1 <= len(Q) <= 8
        assert np.all((robot.limits.lower <= Q) & (robot.limits.upper >= Q))
        for found in Q:
            np.testing.assert_allclose(pose(found), T, atol=2e-9)
        off = (Q - q + np.pi) % (2 * np.pi) - np.pi
        assert np.min(np.max(np.abs(off), axis=1)) < 1e-5


def test_an_ur10_away_from_its_edges_has_eight_postures_all_different():
    robot, _ = ROBOTS["ur10"]
    Q = all_solutions(robot, table_pose(UR10, HOME))
    assert len(Q) == 8
    apart = np.abs((Q[:, None] - Q[None] + np.pi) % (2 * np.pi) - np.pi).max(axis=2) + np.eye(8)
    assert np.min(apart) > 0.1


def test_of_an_arms_postures_the_nearest_to_the_seed_is_taken(rng):
    robot, pose = ROBOTS["ur10, ±π"]
    for q in rng.uniform(robot.limits.lower, robot.limits.upper, (50, 6)):
        found = solve_ik(robot, pose(q), HOME).q
        ways = np.linalg.norm(all_solutions(robot, pose(q)) - HOME, axis=1)
        assert np.linalg.norm(found - HOME) <= np.min(ways) + 1e-9


def test_all_solutions_stand_where_the_base_is_told_to_stand(rng):
    robot, pose = ROBOTS["thing"]
    for q in rng.uniform(robot.lower, robot.upper, (20, 9)):
        Q = all_solutions(robot, pose(q), base=q[:3])
        np.testing.assert_array_equal(Q[:, :3], np.tile(q[:3], (len(Q), 1)))
        np.testing.assert_allclose(robot.forward(Q), np.tile(pose(q), (len(Q), 1, 1)), atol=1e-9)


SINGULAR = {
    "wrist": [0.3, -1.0, 1.2, -0.5, 0.0, 0.7],
    "wrist turned over": [0.3, -1.0, 1.2, -0.5, np.pi, 0.7],
    "elbow stretched": [0.3, -1.0, 0.0, -0.5, 1.0, 0.7],
    "elbow and wrist": [0.3, -1.0, 0.0, -0.5, 0.0, 0.7],
    "upright": [0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0],
    "all zero": [0.0] * 6,
}


@pytest.mark.parametrize("posture", SINGULAR)
@pytest.mark.parametrize("name", ["ur10", "ur10, ±π", "thing, tight", "calibrated"])
def test_singular_postures_are_reached(name, posture):
    robot, pose = ROBOTS[name]
    if name == "ur10, ±π" and posture == "wrist turned over":
        robot = limited(UR10, 3.2)  # π itself is at the limit
    base = np.zeros(robot.dof - 6)
    T = pose(np.concatenate([base, SINGULAR[posture]]))
    solution = solve_ik(robot, T, np.concatenate([base, HOME]))
    assert solution.converged
    np.testing.assert_allclose(pose(solution.q), T, atol=2e-9)
    assert np.all(np.isfinite(all_solutions(robot, T)))


def test_a_wrist_above_the_first_axis_is_reached():
    """The shoulder's singularity: the wrist as near to axis 1 as it can come, so that both q1 are one."""
    robot, pose = ROBOTS["ur10"]
    q2, q3 = -1.9, 0.8
    q4 = np.arcsin((0.612 * np.cos(q2) + 0.5723 * np.cos(q2 + q3)) / 0.1157) - q2 - q3
    for nudge in (0.0, 1e-9, 1e-6, 1e-3):
        T = pose(np.array([0.4, q2, q3, q4 + nudge, 0.9, 0.2]))
        wrist = T[:3, 3] - 0.0922 * T[:3, 2]
        assert np.hypot(wrist[0], wrist[1]) == pytest.approx(0.163941, abs=1e-6)
        assert_solved(robot, pose, T, solve_ik(robot, T, HOME))


@pytest.mark.parametrize("name", ["thing, tight", "ur10", "calibrated", "panda on a cart"])
def test_a_pose_out_of_reach_gives_the_nearest_and_says_what_is_missing(name):
    robot, _ = ROBOTS[name]
    T = np.eye(4)
    T[:3, 3] = [30.0, 0.0, 1.0]
    solution = solve_ik(robot, T, np.zeros(robot.dof))
    assert not solution.converged
    assert np.all((robot.limits.lower <= solution.q) & (solution.q <= robot.limits.upper))
    assert "tool position" in solution.violated
    assert solution.residuals["position"] == pytest.approx(np.linalg.norm(robot.forward(solution.q)[:3, 3] - T[:3, 3]))
    assert f"leaves {solution.residuals['position']:.3g} m" in solution.status
    if name == "ur10":
        assert len(all_solutions(robot, T)) == 0
        assert solution.residuals["position"] < 30.0 - 0.612 - 0.5723


def test_the_closed_form_is_recognised_from_numbers_alone():
    for rows in (UR10, CALIBRATED):
        chain = KinematicChain.from_dh(rows_of(rows))
        assert ur_arm(chain.fixed, chain.prismatic) is not None
    for rows in (PUMA, SLIDING, UR10[:5]):
        chain = KinematicChain.from_dh(rows_of(rows))
        assert ur_arm(chain.fixed, chain.prismatic) is None
    assert ur_arm(lr.load_robot("panda_cart").fixed, lr.load_robot("panda_cart").prismatic) is None


def test_a_joint_that_turns_the_other_way_and_a_tool_that_stands_askew_keep_the_closed_form(rng):
    chain = KinematicChain.from_dh(rows_of(UR10))
    joints = []
    for i in range(6):
        axis = (0.0, 0.0, 1.0 if rng.random() < 0.5 else -1.0)
        joints.append(Joint(f"j{i}", "revolute", f"l{i}", f"l{i + 1}", chain.fixed[i], axis))
    joints.append(Joint("askew", "fixed", "l6", "tip", se3.compose(chain.fixed[6], se3.exp(rng.normal(size=6)))))
    robot = KinematicChain.from_joints(joints, "l0", "tip")
    for q in rng.uniform(-3, 3, (50, 6)):
        Q = all_solutions(robot, robot.forward(q))
        np.testing.assert_allclose(robot.forward(Q), np.tile(robot.forward(q), (len(Q), 1, 1)), atol=1e-9)
        assert np.min(np.max(np.abs((Q - q + np.pi) % (2 * np.pi) - np.pi), axis=1)) < 1e-6


MIRRORED = np.diag([1.0, 1.0, -1.0, 1.0])
STRETCHED = np.diag([1.0, 1.1, 1.0, 1.0])
PROJECTING = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0.1, 0, 0, 1]])


@pytest.mark.parametrize(
    ("T", "q0", "message"),
    [
        (MIRRORED, HOME, "is no rigid motion"),
        (STRETCHED, HOME, "is no rigid motion"),
        (PROJECTING, HOME, "is no rigid motion"),
        (np.full((4, 4), np.nan), HOME, "The pose has NaN or infinity"),
        (np.eye(4), np.full(6, np.inf), "The seed or the base has NaN or infinity"),
        (np.eye(4), np.zeros(7), r"a seed \(6,\) are expected, but their shapes are \(4, 4\) and \(7,\)"),
    ],
)
def test_what_is_no_pose_or_no_seed_is_refused_with_a_sentence(T, q0, message):
    with pytest.raises(PlanningError, match=message):
        solve_ik(ROBOTS["ur10"][0], T, q0)


def test_all_solutions_refuses_what_it_cannot_use():
    with pytest.raises(PlanningError, match="no arm like the UR; use solve_ik"):
        all_solutions(ROBOTS["puma"][0], np.eye(4))
    with pytest.raises(PlanningError, match=r"has 3 joints here, but `base` has the shape \(2,\)"):
        all_solutions(ROBOTS["thing"][0], np.eye(4), base=np.zeros(2))
    with pytest.raises(PlanningError, match="is no rigid motion"):
        all_solutions(ROBOTS["ur10"][0], MIRRORED)
    with pytest.raises(PlanningError, match="NaN or infinity"):
        all_solutions(ROBOTS["thing"][0], np.eye(4), base=np.full(3, np.nan))


def test_limits_upside_down_are_refused_when_they_are_set():
    with pytest.raises(lr.LongreachError, match="is not below its upper limit"):
        thing([10.0] * 8 + [-1.0])
