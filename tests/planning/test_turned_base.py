"""A heading is an angle: after whole turns of the base, everything is as after none."""

import numpy as np
import pytest

import longreach as lr
from longreach.app.tracker import TrackerConfig, check_plan
from longreach.configuration import ConfigurationTrajectory
from longreach.planning.planner import METHODS
from longreach.planning.reference import dual_trajectory
from longreach.planning.task_priority import solve_priority
from longreach.planning.tasks_pose import BasePose, ToolPose

TURNS = (1, 3, -2)


@pytest.fixture(scope="module")
def robot():
    return lr.load_robot("thing")


def turned(robot, turns):
    q = robot.home.copy()
    q[2] = 0.3 + 2 * np.pi * turns
    return q


@pytest.mark.parametrize("turns", TURNS)
def test_ik_stays_where_it_is_and_finds_the_same_elsewhere(robot, turns):
    q0, q = turned(robot, 0), turned(robot, turns)
    T = robot.forward(q0)
    np.testing.assert_allclose(lr.solve_ik(robot, T, q).q, q, atol=1e-9)
    T[:3, 3] += [2.0, 1.0, 0.1]
    np.testing.assert_allclose(lr.solve_ik(robot, T, q).q - q, lr.solve_ik(robot, T, q0).q - q0, atol=1e-6)


@pytest.mark.parametrize("turns", TURNS)
def test_tasks_in_order_of_priority_give_the_same(robot, turns):
    q0, q = turned(robot, 0), turned(robot, turns)
    T = robot.forward(q0)
    T[:3, 3] += [0.5, 0.2, 0.1]
    tasks = [ToolPose(T), BasePose(np.array([0.3, 0.2, 3.0]))]
    moved, other = solve_priority(robot, tasks, q0).q - q0, solve_priority(robot, tasks, q).q - q
    np.testing.assert_allclose(other, moved, atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("turns", TURNS)
def test_a_plan_starts_where_the_robot_is_and_is_the_same(robot, turns, method):
    q0, q = turned(robot, 0), turned(robot, turns)
    T = robot.forward(q0)
    wanted = lr.plan(robot, dual_trajectory(T, q0[robot.base], waypoints=20), q0, method=method)
    for base in (q0, q):  # a reference may be wrapped, or not
        plan = lr.plan(robot, dual_trajectory(T, base[robot.base], waypoints=20), q, method=method)
        np.testing.assert_allclose(plan.q - q, wanted.q - q0, atol=1e-5)
        assert not any(report.unmet.any() for report in plan.reports)


@pytest.mark.parametrize("turns", TURNS)
def test_the_tracker_takes_a_plan_whose_heading_is_not_wrapped(robot, turns):
    q = turned(robot, turns)
    plan = ConfigurationTrajectory(np.array([0.0, 1.0]), np.array([q, q]), robot.joint_names)
    check_plan(robot, plan, turned(robot, 0), TrackerConfig())
    with pytest.raises(lr.LongreachError, match=r"The plan begins 0\.50 rad or m away"):
        check_plan(robot, plan, turned(robot, 0) + 0.5 * (np.arange(robot.dof) == 2), TrackerConfig())
