"""Section 6.3, figure 6.5: the dual trajectory with manipulability optimised, the base within 1 cm and 0.1 rad."""

import numpy as np
import pytest

import longreach as lr
from longreach.planning.profile import SpeedProfile
from longreach.planning.reference import base_poses, sinusoid, straight_line, tool_poses
from longreach.robot.manipulability import manipulability

THING = lr.load_robot("thing").with_tool("flange")
HOME = np.array([0.0, 0.0, 0.0, 0.0, -2.0, 2.0, -1.5, -1.57, 0.0])
N = 200


@pytest.fixture(scope="module")
def reference():
    """The tool on a straight line of 2 m, the base on a sinusoid of 0.2 m beside it."""
    T = THING.forward(HOME)
    along = np.array([2.0, 0.0, 0.0])
    u = np.linspace(0.0, 1.0, N)
    tool = tool_poses(straight_line(T[:3, 3], T[:3, 3] + along), T[:3, :3], u)
    base = base_poses(sinusoid(np.zeros(3), along, 0.2), u)
    return lr.Reference(0.1 * np.arange(N), tool=tool, base=base)


@pytest.fixture(scope="module")
def unoptimised(reference):
    return lr.plan(THING, reference, HOME, method="task-priority").q


@pytest.fixture(scope="module")
def optimised(reference):
    return {
        objective: lr.plan(THING, reference, HOME, method="sqp", problem=lr.thesis_problem(objective=objective))
        for objective in ("sqrt_kappa_over_m", "neg_log_m")
    }


def measured(q, measure, part="full"):
    return manipulability(THING, q, measure, part)[0]


@pytest.mark.parametrize("objective", ["sqrt_kappa_over_m", "neg_log_m"])
def test_the_base_keeps_its_tolerances_and_the_tool_its_path_exactly(reference, optimised, objective):
    q = optimised[objective].q
    assert optimised[objective].solution.converged
    assert np.linalg.norm(q[:, :2] - reference.base[:, :2], axis=1).max() <= 0.01 + 1e-6
    assert np.abs(q[:, 2] - reference.base[:, 2]).max() <= 0.1 + 1e-6
    assert np.abs(THING.forward(q) - reference.tool).max() <= 1e-6
    assert np.abs(np.diff(q, axis=0)).max() <= 0.025


def test_the_objective_falls_nearly_everywhere_and_manipulability_rises(optimised, unoptimised):
    q = optimised["sqrt_kappa_over_m"].q
    f, f0 = measured(q, "sqrt_kappa_over_m"), measured(unoptimised, "sqrt_kappa_over_m")
    assert np.mean(f <= f0) >= 0.95
    assert f.mean() <= 1.7952
    assert measured(q, "m").mean() >= 1.015 * measured(unoptimised, "m").mean()


def test_with_the_logarithm_manipulability_rises_nearly_everywhere(optimised, unoptimised):
    M, M0 = measured(optimised["neg_log_m"].q, "m"), measured(unoptimised, "m")
    assert np.mean(M > M0) >= 0.95
    assert M.mean() >= 1.0175 * M0.mean()


def test_each_waypoint_by_itself_is_better_still(reference, optimised):
    apart = lr.plan(THING, reference, HOME, method="sqp", coupled=False)
    assert apart.solution.converged
    assert apart.solution.objective.mean() <= 1.7941
    assert apart.solution.objective.mean() < optimised["sqrt_kappa_over_m"].solution.objective.mean()


def test_with_more_room_the_arm_alone_gains_three_quarters(reference, unoptimised):
    problem = lr.thesis_problem(0.1, 0.5, "arm")
    q = lr.plan(THING, reference, HOME, method="sqp", problem=problem, coupled=False).q
    ratio = measured(q, "m", "arm") / measured(unoptimised, "m", "arm")
    assert ratio.mean() >= 1.73


def test_figure_6_5_uses_a_speed_profile_as_the_thesis_did(reference):
    stamps, u = SpeedProfile(length=2.0, velocity=0.5, acceleration=1.0).sample(40)
    rows = np.round(u * (N - 1)).astype(int)
    timed = lr.Reference(stamps, reference.tool[rows], reference.base[rows])
    assert lr.plan(THING, timed, HOME, method="sqp").solution.violated == ()
