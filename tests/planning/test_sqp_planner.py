"""Plans by sequential convex optimisation: starts, smoothness, obstacles, replanning, and what is refused."""

import numpy as np
import pytest

import longreach as lr
from longreach.errors import LongreachError, PlanningError
from longreach.planning.links import Smoothness
from longreach.planning.obstacles import Box, Capsule, Disc, link_capsules
from longreach.planning.problem import Problem
from longreach.planning.sqp_planner import OptimisedTrajectory
from longreach.planning.sqp_run import SqpConfig
from longreach.planning.sqp_start import _turns
from longreach.planning.terms_clearance import SelfClearance, arm_clearance, base_clearance, least_clearance
from longreach.planning.terms_pose import BaseDisc, ToolPose

THING = lr.load_robot("thing").with_tool("flange")
HOME = np.array([0.0, 0.0, 0.0, 0.0, -2.0, 2.0, -1.5, -1.57, 0.0])


def reference(n=30, step=0.02):
    T = np.tile(THING.forward(HOME), (n, 1, 1))
    along = step * np.arange(n)
    T[:, 0, 3] += along
    return lr.Reference(0.1 * np.arange(n), tool=T, base=np.column_stack([along, 0.2 * np.sin(3 * along), 0 * along]))


def plan(ref, **options):
    return lr.plan(THING, ref, HOME, method="sqp", **options)


def test_a_plan_comes_with_its_certificate_and_reports():
    trajectory = plan(reference())
    assert isinstance(trajectory, lr.ConfigurationTrajectory)
    assert isinstance(trajectory, OptimisedTrajectory)
    assert trajectory.solution.converged
    np.testing.assert_array_equal(trajectory.q, trajectory.solution.q)
    assert {report.name for report in trajectory.reports} == {"tool pose", "base disc", "base heading", "step"}
    assert not any(report.unmet.any() for report in trajectory.reports)
    assert trajectory.reports[0].reason == "Met everywhere: tool pose."


def test_waypoints_by_themselves_are_no_worse_but_jump():
    ref = reference()
    together, apart = plan(ref), plan(ref, coupled=False)
    assert apart.solution.converged
    assert apart.solution.objective.mean() <= together.solution.objective.mean() + 1e-6
    assert np.abs(np.diff(together.q, axis=0)).max() <= 0.036  # 1.5 times the start's


def test_twice_as_many_waypoints_give_the_same_curve():
    few, many = plan(reference(30, 0.02)), plan(reference(59, 0.01))
    assert few.solution.objective.mean() == pytest.approx(many.solution.objective.mean(), abs=2e-3)
    np.testing.assert_allclose(many.q[::2], few.q, atol=0.03)


def test_replanning_from_the_last_answer_takes_few_iterations():
    ref = reference()
    first = plan(ref)
    again = plan(ref, initial=first)
    assert again.solution.converged
    assert again.solution.iterations < first.solution.iterations
    np.testing.assert_allclose(again.q, first.q, atol=1e-4)
    moved = lr.Reference(ref.stamps, ref.tool, ref.base + np.array([0.005, -0.005, 0.0]))
    assert plan(moved, initial=first).solution.converged


@pytest.mark.parametrize(
    "obstacle",
    [
        Disc(np.array([0.3, 0.95]), 0.2),
        Capsule(np.array([0.3, 0.95, 0.0]), np.array([0.3, 0.95, 1.0]), 0.2),
        Box(np.eye(4) + np.array([[0, 0, 0, 0.3], [0, 0, 0, 0.95], [0, 0, 0, 0.3], [0, 0, 0, 0]]), np.full(3, 0.35)),
    ],
    ids=lambda obstacle: type(obstacle).__name__,
)
def test_the_base_goes_around_obstacles_between_waypoints_too(obstacle):
    ref = reference()
    term = base_clearance(0.62, (obstacle,))
    free = plan(ref, problem=lr.thesis_problem(0.3, 0.5))
    clear = plan(ref, problem=lr.thesis_problem(0.3, 0.5).adding(term))
    assert clear.solution.violated == ()
    assert least_clearance(THING, clear.q, term, finer=50)[0] >= -1e-9
    straight = lr.plan(THING, lr.Reference(1e3 * ref.stamps, ref.tool, ref.base), HOME)
    assert least_clearance(THING, straight.q, term)[0] < -0.02
    assert clear.solution.objective.mean() >= free.solution.objective.mean() - 1e-6


def test_the_arm_goes_around_what_its_elbow_would_touch_and_keeps_off_its_base():
    ref = reference()
    straight = lr.plan(THING, lr.Reference(1e3 * ref.stamps, ref.tool, ref.base), HOME).q
    elbow = THING.chain.ending("forearm_link").forward_and_jacobian_batch(straight)[0][15, :3, 3]
    above = elbow + np.array([0.0, 0.0, 0.14])
    arm = arm_clearance(THING, (Capsule(above, above, 0.1),))
    far = tuple(c for c in link_capsules(THING) if c.frame not in ("shoulder_link", "upper_arm_link"))
    deck = Box(np.eye(4), np.array([0.96, 0.79, 0.6]))
    own = SelfClearance(far, (deck,))
    own = SelfClearance(far, (deck,), margin=least_clearance(THING, straight, own)[0] + 0.02)
    assert least_clearance(THING, straight, arm)[0] < -0.005
    clear = plan(ref, problem=lr.thesis_problem(0.3, 0.5).adding(arm, own))
    assert clear.solution.violated == (), clear.solution.status
    assert least_clearance(THING, clear.q, arm, finer=50)[0] >= -1e-9
    assert least_clearance(THING, clear.q, own, finer=50)[0] >= own.margin - 1e-9


def test_replanning_from_a_moved_start_reuses_the_last_answer():
    ref = reference()
    first = plan(ref)
    q0 = HOME + np.array([0.004, -0.003, 0.02, 0.03, -0.02, 0.02, 0.0, 0.01, 0.0])
    fresh = lr.plan(THING, ref, q0, method="sqp")
    again = lr.plan(THING, ref, q0, method="sqp", initial=first)
    assert again.solution.converged
    assert again.solution.iterations < fresh.solution.iterations
    np.testing.assert_allclose(again.solution.objective.mean(), fresh.solution.objective.mean(), atol=1e-4)


def test_an_obstacle_on_the_way_without_room_is_named_within_the_budget():
    ref = reference()
    term = base_clearance(0.62, (Disc(np.array([0.3, 0.2]), 0.3),))
    trajectory = plan(ref, problem=lr.thesis_problem(0.05).adding(term), config=SqpConfig(budget=1.0))
    assert "base clearance" in trajectory.solution.violated
    assert "base clearance is not met at waypoint" in trajectory.solution.status
    assert any(report.unmet.any() and "base clearance" in report.reason for report in trajectory.reports)


def test_an_obstacle_that_contains_the_start_is_refused():
    term = base_clearance(0.62, (Disc(np.array([0.1, 0.0]), 0.3),))
    with pytest.raises(PlanningError, match=r"'base clearance' contains the start: base_link is 0\.2 m inside it"):
        plan(reference(2), problem=lr.thesis_problem(0.3).adding(term))


def test_a_bolted_arm_is_planned_for_without_a_base():
    ur10 = lr.load_robot("ur10")
    q = np.array([0.0, -1.5, 1.5, -1.5, -1.5, 0.0])
    T = np.stack([ur10.forward(q + 0.02 * k) for k in range(8)])
    problem = Problem(constraints=(ToolPose(),), links=(Smoothness(1.0),))
    trajectory = lr.plan(ur10, lr.Reference(np.arange(8.0), tool=T), q, method="sqp", problem=problem)
    assert trajectory.solution.converged, trajectory.solution.status


def test_the_heading_changes_over_slowly_where_the_other_end_is_cheaper():
    cost = np.ones((2, 100))
    cost[0, :50] = cost[1, 50:] = 2.0
    turns = _turns(cost, 0.1, 0.01)
    assert turns[0] == pytest.approx(-0.1)
    assert turns[-1] == pytest.approx(0.1)
    assert np.abs(np.diff(turns)).max() <= 0.0101
    cost[0, 50:] = 2.0 - 1e-3
    assert np.ptp(_turns(cost[:, :60], 0.1, 0.01)) == 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "sqp", "iterations": 0}, "at least one iteration"),
        ({"method": "sqp", "problem": Problem(constraints=(BaseDisc(0.1),))}, "base poses in the reference"),
        ({"method": "magic"}, "task-priority, sqp"),
    ],
)
def test_what_cannot_be_planned_is_refused(options, message):
    ref = lr.Reference(np.arange(2.0), tool=reference(2).tool)
    with pytest.raises(PlanningError, match=message):
        lr.plan(THING, ref, HOME, **options)


@pytest.mark.parametrize("q0", [np.full(9, np.nan), np.zeros(8)])
def test_a_start_that_is_no_configuration_is_refused(q0):
    with pytest.raises(LongreachError):
        lr.plan(THING, reference(2), q0, method="sqp")
