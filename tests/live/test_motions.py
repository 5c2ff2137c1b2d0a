"""Plans of a client: the tool to a pose, by either planner."""

import numpy as np
import pytest

import longreach as lr
from longreach.control.interpolation import sample
from longreach.errors import PlanningError
from longreach.geometry import se3, so3
from longreach.live.client import motions

GOALS = {  # by how much the tool moves [m], and turns [rad]
    "within the arm's reach": ([0.0, 0.0, 0.1], [0.0, 0.0, 0.0]),
    "beside, and turned": ([0.0, 0.3, 0.1], [0.3, 0.5, -0.4]),
    "1 m ahead": ([1.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
    "1 m aside": ([0.0, 1.0, 0.0], [0.0, 0.0, 0.0]),
    "2 m ahead, down": ([2.0, 0.0, -0.3], [0.0, 0.0, 0.0]),
}


@pytest.mark.parametrize("base", [[0.0, 0.0, 0.0], [3.0, -2.0, 2.5]], ids=["at the origin", "elsewhere"])
@pytest.mark.parametrize("goal", GOALS)
def test_the_tool_arrives_by_sqp_as_by_task_priority(thing, goal, base):
    way, turn = GOALS[goal]
    q = np.concatenate([base, thing.home[3:]])
    T = thing.forward(q)
    T = se3.from_rotation_translation(T[:3, :3] @ so3.exp(np.array(turn)), T[:3, 3] + way)
    for method in ("task-priority", "sqp"):
        plan = motions.to_pose(thing, q, T, method)
        np.testing.assert_allclose(plan.q[0], q, atol=1e-6)
        np.testing.assert_allclose(se3.difference(thing.forward(plan.q[-1]), T), 0.0, atol=1e-3)
        _, v, a = sample(plan, np.linspace(plan.stamps[0], plan.stamps[-1], 1000))
        assert np.all(np.abs(v) <= thing.limits.velocity)
        assert np.all(np.abs(a) <= thing.limits.acceleration)
        assert np.abs(v[[0, -1]]).max() < 1e-6


def test_by_sqp_the_base_stays_where_the_arm_can_do_it_and_comes_along_where_it_cannot(thing):
    q = thing.home
    moved = {}
    for way in (0.1, 2.0):
        T = thing.forward(q)
        T[0, 3] += way
        moved[way] = np.linalg.norm(motions.to_pose(thing, q, T, "sqp").q[-1, :2])
    assert moved[0.1] < 0.03
    assert 0.8 < moved[2.0] < 1.5


def test_an_arm_that_is_bolted_down_plans_by_sqp_too():
    robot = lr.load_robot("ur10")
    q = robot.home
    T = robot.forward(q)
    T[2, 3] -= 0.1
    plan = motions.to_pose(robot, q, T, "sqp")
    np.testing.assert_allclose(se3.difference(robot.forward(plan.q[-1]), T), 0.0, atol=1e-3)


def test_a_pose_out_of_reach_is_refused_by_sqp_with_a_sentence(thing):
    T = thing.forward(thing.home)
    T[2, 3] += 3.0
    with pytest.raises(PlanningError, match="choose a pose that the robot can reach"):
        motions.to_pose(thing, thing.home, T, "sqp")


@pytest.mark.parametrize("progress", [0.0, 0.4, 0.97, 1.0])
def test_what_is_left_of_a_plan_begins_at_rest_where_the_robot_stands_and_ends_as_the_plan(thing, progress):
    plan = motions.to_pose(thing, thing.home, np.array(se3.from_rotation_translation(*_beside(thing))), "task-priority")
    q = sample(plan, np.array([plan.stamps[0] + progress * plan.duration]))[0][0]
    q = q + 0.02 * np.sin(np.arange(thing.dof))
    q[2] += 2.0 * np.pi  # an estimate's heading may be a turn off
    left = motions.what_is_left(thing, plan, q, progress)
    np.testing.assert_allclose(left.q[0], q, atol=1e-9)
    turn = np.round((left.q[-1] - plan.q[-1])[2] / (2 * np.pi)) * 2 * np.pi
    np.testing.assert_allclose(left.q[-1] - plan.q[-1], [0, 0, turn, *np.zeros(thing.dof - 3)], atol=1e-9)
    _, v, a = sample(left, np.linspace(left.stamps[0], left.stamps[-1], 2000))
    assert np.abs(v[[0, -1]]).max() < 1e-3
    assert np.all(np.abs(v) <= thing.limits.velocity)
    assert np.all(np.abs(a) <= 1.25 * thing.limits.acceleration)


def _beside(thing):
    T = thing.forward(thing.home)
    return T[:3, :3], T[:3, 3] + [0.5, 0.3, 0.1]
