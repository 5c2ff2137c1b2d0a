"""Plans along a reference: the dual trajectory met, an infeasible base reported, limits kept from knot to knot."""

import os
from pathlib import Path

import numpy as np
import pytest

import longreach as lr
from longreach.errors import PlanningError
from longreach.geometry import se3
from longreach.io.robots import load_robot
from longreach.planning.obstacles import Disc
from longreach.planning.reference import dual_trajectory
from longreach.planning.tasks_pose import Posture
from longreach.planning.tasks_range import BaseClearance

THING = load_robot("thing").with_tool("flange")
HOME = np.array([0.0, 0.0, 0.0, 0.0, -2.0, 2.0, -1.5, -1.57, 0.0])
DUAL = dual_trajectory(THING.forward(HOME))
WIDE = dual_trajectory(THING.forward(HOME), amplitude=1.2)  # out of the arm's reach


def tool_errors(plan, reference):
    e = se3.difference(reference.tool, THING.forward(plan.q))
    return np.linalg.norm(e[:, :3], axis=1), np.linalg.norm(e[:, 3:], axis=1)


@pytest.fixture
def shared_dual():
    folder = os.environ.get("LONGREACH_BENCH")
    if not folder:
        pytest.skip("LONGREACH_BENCH does not name the folder of problem sets")
    problem = np.load(Path(folder) / "dual.npz")
    return lr.Reference(np.linspace(0.0, 20.0, 200), tool=problem["T"], base=problem["B"]), problem["home"]


def test_one_iteration_a_waypoint_follows_the_shared_dual_trajectory(shared_dual):
    reference, home = shared_dual
    plan = lr.plan(THING, reference, home, method="task-priority", iterations=1)
    assert plan.q.shape == (200, 9)
    assert tool_errors(plan, reference)[0].max() <= 3.7e-5


def test_the_dual_trajectory_is_met_to_rounding_where_iterations_allow():
    plan = lr.plan(THING, DUAL, HOME)
    position, orientation = tool_errors(plan, DUAL)
    assert position.max() <= 1e-12
    assert orientation.max() <= 1e-9
    assert np.abs(plan.q[:, :3] - DUAL.base).max() <= 1e-9
    assert [report.name for report in plan.reports] == ["joint limits", "tool", "base"]
    assert not any(report.unmet.any() for report in plan.reports)
    np.testing.assert_array_equal(plan.stamps, DUAL.stamps)
    assert plan.joint_names == THING.joint_names


def test_a_base_out_of_reach_gives_way_and_the_report_says_by_how_much():
    plan = lr.plan(THING, WIDE, HOME, iterations=20)
    position, orientation = tool_errors(plan, WIDE)
    assert position.max() <= 1e-3
    assert orientation.max() <= 1e-3
    assert np.abs(np.diff(plan.q, axis=0)).max() <= 0.2
    off = np.linalg.norm(plan.q[:, :2] - WIDE.base[:, :2], axis=1)
    assert off.mean() <= 0.13
    limits, tool, base = plan.reports
    assert not limits.unmet.any()
    assert not tool.unmet.any()
    assert 30 < base.unmet.sum() < 100
    np.testing.assert_allclose(np.sort(base.linear)[-50:], np.sort(off)[-50:], rtol=0.05)
    assert "conflicts with tool" in base.reason
    assert "438 mm" in base.reason
    assert base.unmet[int(base.reason.split()[2].rstrip(","))]


@pytest.mark.parametrize("reference", [DUAL, WIDE])
def test_limits_of_position_and_speed_hold_at_every_knot(reference):
    lower, upper = THING.lower.copy(), THING.upper.copy()
    lower[4], upper[5] = -2.05, 2.05
    held = THING.with_limits(lower, upper)
    plan = lr.plan(held, reference, HOME)
    assert np.all(plan.q >= lower - 1e-12)
    assert np.all(plan.q <= upper + 1e-12)
    allowed = np.diff(reference.stamps)[:, None] * held.limits.velocity
    assert np.all(np.abs(np.diff(plan.q, axis=0)) <= allowed * (1 + 1e-9))


def test_a_reference_that_is_too_fast_is_followed_as_fast_as_can_be_and_that_is_said():
    hasty = lr.Reference(DUAL.stamps / 40.0, tool=DUAL.tool, base=DUAL.base)
    plan = lr.plan(THING, hasty, HOME)
    allowed = np.diff(hasty.stamps)[:, None] * THING.limits.velocity
    assert np.all(np.abs(np.diff(plan.q, axis=0)) <= allowed * (1 + 1e-9))
    assert any("limit of speed" in report.reason for report in plan.reports)


def test_the_compiled_plan_is_the_one_of_any_tasks():
    few = lr.Reference(DUAL.stamps[:20], tool=WIDE.tool[:20], base=WIDE.base[:20])
    for iterations in (1, 20):
        compiled = lr.plan(THING, few, HOME, iterations=iterations)
        other = lr.plan(THING, few, HOME, iterations=iterations, free=lambda q: np.zeros(9))
        np.testing.assert_allclose(compiled.q, other.q, atol=1e-9)
        for a, b in zip(compiled.reports, other.reports, strict=True):
            np.testing.assert_allclose(a.linear, b.linear, atol=1e-9)


def test_a_vector_of_the_callers_moves_what_the_tool_leaves_free_as_a_function_does():
    still = lr.Reference(np.arange(3.0), tool=np.tile(THING.forward(HOME), (3, 1, 1)))
    z = np.full(9, 0.1)
    given, returned = (lr.plan(THING, still, HOME, free=free, iterations=5) for free in (z, lambda q: z))
    np.testing.assert_array_equal(given.q, returned.q)
    assert np.abs(given.q[-1] - HOME).max() > 0.1
    assert tool_errors(given, still)[0].max() < 0.01


def test_the_tool_alone_moves_the_base_too_and_a_posture_steers_the_rest():
    tool = lr.Reference(DUAL.stamps, tool=DUAL.tool)
    plan = lr.plan(THING, tool, HOME, below=[Posture(HOME)])
    assert tool_errors(plan, tool)[0].max() <= 1e-9
    assert plan.reports[2].name == "posture"
    base = lr.plan(THING, lr.Reference(DUAL.stamps, base=DUAL.base), HOME)
    np.testing.assert_allclose(base.q[:, 3:], np.tile(HOME[3:], (200, 1)), atol=1e-9)


def test_a_post_beside_the_way_is_passed_at_a_distance():
    few = slice(0, 200, 5)
    post = Disc(np.array([0.5, 0.75]), 0.1)
    clear = BaseClearance((post,), radius=0.5)
    reference = lr.Reference(DUAL.stamps[few], tool=DUAL.tool[few], base=DUAL.base[few])
    plan = lr.plan(THING, reference, HOME, above=[clear])
    gaps = [clear.value(THING, q)[0] for q in plan.q]
    assert min(gaps) > -1e-6
    assert min(clear.value(THING, np.r_[b, HOME[3:]])[0] for b in reference.base) < -0.01
    assert tool_errors(plan, reference)[0].max() < 1e-6
    assert "base clearance holds it" in plan.reports[3].reason


def test_velocities_are_those_of_parabolas_through_neighbours(rng):
    stamps = np.cumsum(rng.uniform(0.1, 0.3, 12))
    for rows in (2, 3, 12):
        plan = lr.ConfigurationTrajectory(stamps[:rows], rng.normal(size=(rows, 4)))
        expected = np.gradient(plan.q, plan.stamps, axis=0, edge_order=min(rows - 1, 2))
        np.testing.assert_allclose(plan.velocities, expected, atol=1e-12)


def test_plans_are_the_same_every_time():
    a, b = (lr.plan(THING, WIDE, HOME) for _ in range(2))
    np.testing.assert_array_equal(a.q, b.q)


def test_an_arm_alone_follows_its_tool():
    arm = load_robot("ur10")
    q0 = HOME[3:]
    T = arm.forward(q0)
    poses = np.tile(T, (20, 1, 1))
    poses[:, 0, 3] += np.linspace(0.0, 0.1, 20)
    plan = lr.plan(arm, lr.Reference(np.linspace(0, 2, 20), tool=poses), q0)
    np.testing.assert_allclose(arm.forward(plan.q), poses, atol=1e-9)


@pytest.mark.parametrize(
    ("robot", "reference", "q0", "options", "message"),
    [
        (THING, DUAL, HOME, {"method": "magic"}, "no method 'magic'; there is task-priority"),
        (THING, DUAL, HOME, {"iterations": 0}, "at least one iteration"),
        (THING, DUAL, HOME, {"free": np.ones(3)}, "vector z must be 9 finite numbers"),
        (THING, DUAL, HOME, {"free": np.full(9, np.nan)}, "vector z must be 9 finite numbers"),
        (THING, DUAL, HOME, {"free": lambda q: np.ones(3)}, "vector z must be 9 finite numbers"),
        (THING, DUAL, HOME, {"free": lambda q: q * np.nan}, "vector z must be 9 finite numbers"),
        (THING, DUAL, HOME[:6], {}, "start must be 9 finite numbers"),
        (THING, DUAL, np.full(9, np.inf), {}, "start must be 9 finite numbers"),
        (load_robot("ur10"), DUAL, HOME[3:], {}, "ur10 is bolted down"),
    ],
)
def test_what_cannot_be_planned_is_refused_with_a_sentence(robot, reference, q0, options, message):
    with pytest.raises(PlanningError, match=message):
        lr.plan(robot, reference, q0, **options)
