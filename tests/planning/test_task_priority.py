"""Task priority: nothing below disturbs what is above, ranges are kept, and the answer says what is missing and why."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from longreach.errors import PlanningError
from longreach.geometry import se3
from longreach.io.robots import load_robot
from longreach.planning.hierarchy import hierarchy_step
from longreach.planning.obstacles import Capsule, Disc, LinkCapsule
from longreach.planning.pseudoinverse import Inverse, null_space_projector
from longreach.planning.task_priority import TaskPriorityConfig, solve_priority
from longreach.planning.tasks_pose import BaseHeading, BasePose, Posture, ToolPose, ToolPosition
from longreach.planning.tasks_range import (
    ArmClearance,
    BaseClearance,
    FieldOfView,
    LookAt,
    Manipulability,
    WithinLimits,
)
from longreach.robot.manipulability import manipulability

THING = load_robot("thing").with_tool("flange")
HOME = np.array([0.0, 0.0, 0.0, 0.0, -2.0, 2.0, -1.5, -1.57, 0.0])
OUTSTRETCHED = np.array([0.1, 0.2, 0.3, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0])
INVERSES = [
    Inverse(method="undamped"),
    Inverse(method="damped", damping=0.01),
    Inverse(method="selective"),
    Inverse(method="damped", damping=1e-3, filter={"sigma0": 1e-3, "v": 20.0}),
]


def levels(seed, sizes, rank_lost):
    """Jacobians whose rows depend on each other within a level and across levels."""
    rng = np.random.default_rng(seed)
    matrices = [rng.normal(size=(m, 9)) for m in sizes]
    if rank_lost:
        matrices[0][-1] = matrices[0][0]
        for above, below in pairwise(matrices):
            below[0] = above[0] + 10.0 ** -rng.integers(2, 18) * rng.normal(size=9)  # nearly what is above wants
    return matrices, [rng.normal(size=m) for m in sizes]


@pytest.mark.parametrize("inverse", INVERSES, ids=["undamped", "damped", "selective", "filtered"])
@pytest.mark.parametrize("scheme", ["siciliano-slotine", "chiaverini"])
@given(st.integers(0, 10**6), st.sampled_from([(6, 3), (3, 2, 4), (2, 2, 2, 2), (6, 6), (1, 9)]), st.booleans())
def test_a_lower_level_never_disturbs_a_higher_one(scheme, inverse, seed, sizes, rank_lost):
    jacobians, wanted = levels(seed, sizes, rank_lost)
    alone = [
        hierarchy_step(jacobians[:k], wanted[:k], scheme=scheme, inverse=inverse) for k in range(1, len(sizes) + 1)
    ]
    z = np.random.default_rng(seed).normal(size=9)
    together = hierarchy_step(jacobians, wanted, z=z, scheme=scheme, inverse=inverse)
    for k, J in enumerate(jacobians):
        scale = 1.0 + np.max(np.abs(alone[-1]))
        np.testing.assert_allclose(J @ together, J @ alone[k], atol=1e-10 * scale, rtol=0)


@given(st.integers(0, 10**6), st.sampled_from([(6, 3), (3, 2, 2), (2, 2, 2, 2), (6, 6)]))
def test_undamped_steps_solve_one_least_squares_problem_after_the_other(seed, sizes):
    jacobians, wanted = levels(seed, sizes, rank_lost=False)
    q, N = np.zeros(9), np.eye(9)
    for J, a in zip(jacobians, wanted, strict=True):
        q = q + N @ np.linalg.lstsq(J @ N, a - J @ q, rcond=1e-10)[0]
        N = N @ null_space_projector(J @ N, 1e-10)
    np.testing.assert_allclose(hierarchy_step(jacobians, wanted), q, atol=1e-8)


def test_two_levels_are_the_formula_of_the_thesis(rng):
    A, B, a, b, z = (rng.normal(size=s) for s in ((4, 9), (3, 9), 4, 3, 9))
    A1, N = np.linalg.pinv(A), np.eye(9) - np.linalg.pinv(A) @ A
    B1 = np.linalg.pinv(B @ N)
    full = A1 @ a + N @ B1 @ (b - B @ A1 @ a) + N @ (np.eye(9) - B1 @ B @ N) @ z  # (4.16a)
    np.testing.assert_allclose(hierarchy_step([A, B], [a, b], z=z), full, atol=1e-12)
    AB = np.vstack([A, B])
    loose = A1 @ a + N @ np.linalg.pinv(B) @ b + (np.eye(9) - np.linalg.pinv(AB) @ AB) @ z  # (4.17)
    np.testing.assert_allclose(hierarchy_step([A, B], [a, b], z=z, scheme="chiaverini"), loose, atol=1e-12)


def test_a_quick_step_is_the_careful_one(rng):
    """The compiled step by Cholesky against the one by orthonormal rows, damped and undamped."""
    tasks = [ToolPose(THING.forward(HOME + 0.05)), BasePose(np.array([0.1, 0.0, 0.1]))]
    for inverse in (Inverse(method="undamped"), Inverse(method="damped", damping=0.01)):
        one = TaskPriorityConfig(iterations=1, inverses=(inverse,), max_step_revolute=9.0, max_step_prismatic=9.0)
        quick = solve_priority(THING, tasks, HOME, one)
        careful = solve_priority(THING, tasks, HOME, one, free=1e-300 * np.ones(9))
        np.testing.assert_allclose(quick.q, careful.q, atol=1e-10)


def test_tool_and_base_are_both_met_where_both_can_be(rng):
    for _ in range(10):
        q = HOME + 0.2 * rng.normal(size=9)
        found = solve_priority(THING, [ToolPose(THING.forward(q)), BasePose(q[:3])], HOME)
        assert found.converged
        assert found.status == "All tasks are met."
        np.testing.assert_allclose(THING.forward(found.q), THING.forward(q), atol=1e-11)
        np.testing.assert_allclose(found.q[:3], q[:3], atol=1e-11)


def test_the_tool_comes_first_and_the_base_as_near_as_it_can():
    tool = ToolPosition(THING.forward(HOME)[:3, 3])
    far = np.array([0.0, 3.0, 0.0])
    found = solve_priority(THING, [tool, BasePose(far)], HOME)
    assert found.residuals["tool position"] < 1e-9
    assert found.violated == ("base pose",)
    assert "base pose is off by" in found.status
    assert "conflicts with tool position" in found.status

    def cost(q):
        return float(np.sum(BasePose(far).value(THING, q) ** 2))

    held = {"type": "eq", "fun": lambda q: tool.value(THING, q), "jac": lambda q: tool.jacobian(THING, q)}
    other = minimize(cost, found.q + 0.05, constraints=held, method="SLSQP", options={"maxiter": 300, "ftol": 1e-12})
    assert cost(found.q) <= other.fun + 1e-6


@pytest.mark.parametrize("scheme", ["siciliano-slotine", "chiaverini"])
def test_a_pose_out_of_reach_is_approached_and_said_to_be(scheme):
    T = THING.forward(HOME)
    T[2, 3] = 4.0
    config = TaskPriorityConfig(scheme=scheme, iterations=300)
    found = solve_priority(THING, [ToolPosition(T[:3, 3])], HOME, config)
    assert not found.converged
    assert "cannot be reached" in found.status
    top = 0.653 + 0.1273 + 0.612 + 0.5723
    assert 4.0 - top - 0.3 < found.residuals["tool position"] < 4.0 - top


def test_a_higher_task_does_not_notice_that_a_lower_one_is_hopeless():
    goal = ToolPose(THING.forward(HOME + 0.1))
    with_it = solve_priority(THING, [goal, Posture(np.full(9, 50.0)), BaseHeading(2.0)], HOME)
    assert with_it.residuals["tool pose"] < 1e-10
    assert "tool pose" not in with_it.violated


@pytest.mark.parametrize("start", [HOME, OUTSTRETCHED])
def test_limits_hold_and_the_status_names_them(start):
    lower, upper = THING.lower.copy(), THING.upper.copy()
    lower[:3], upper[:3] = -0.01, 0.01
    held = THING.with_limits(np.minimum(lower, start), np.maximum(upper, start))
    far = ToolPosition(np.array([5.0, 0.0, 1.0]))
    found = solve_priority(held, [far], start)
    assert np.all(found.q >= held.lower)
    assert np.all(found.q <= held.upper)
    assert not found.converged
    assert "joint limits" in found.status


def test_a_start_outside_the_limits_comes_back_inside():
    lower, upper = THING.lower.copy(), THING.upper.copy()
    lower[5], upper[4] = 2.2, -2.1
    held = THING.with_limits(lower, upper)
    found = solve_priority(held, [ToolPosition(THING.forward(HOME)[:3, 3])], HOME)
    assert found.converged
    assert np.all(found.q >= held.lower - 1e-12)
    assert np.all(found.q <= held.upper + 1e-12)


def test_the_base_drives_round_a_post_or_stops_before_it():
    post = Disc(np.array([1.0, 0.0]), 0.2)
    clear = BaseClearance((post,), radius=0.5, margin=0.05)
    found = solve_priority(THING, [clear, BasePose(np.array([1.0, 0.0, 0.0]))], HOME)
    assert found.residuals["base clearance"] < 1e-6
    assert np.hypot(*(found.q[:2] - post.centre)) == pytest.approx(0.75, abs=1e-6)
    assert "base clearance holds it" in found.status


def test_an_obstacle_that_is_not_in_the_way_changes_nothing():
    goal = [ToolPose(THING.forward(HOME + 0.1)), BasePose(np.full(3, 0.1))]
    far = BaseClearance((Disc(np.array([9.0, 9.0]), 0.2),), radius=0.5)
    np.testing.assert_allclose(
        solve_priority(THING, [far, *goal], HOME).q, solve_priority(THING, goal, HOME).q, atol=1e-9
    )


def test_the_arm_keeps_away_from_a_capsule():
    q = HOME + 0.15
    near = THING.frame("forearm_link", q)[:3, 3] + np.array([0.0, 0.0, 0.12])
    link = LinkCapsule("forearm_link", Capsule(np.zeros(3), np.array([0.1, 0.0, 0.0]), 0.06))
    clear = ArmClearance((Capsule(near, near, 0.05),), (link,), margin=0.02)
    assert clear.error(THING, q)[0] < 0
    found = solve_priority(THING, [clear, ToolPose(THING.forward(q))], q)
    assert found.converged
    assert clear.value(THING, found.q)[0] > 0.02 - 1e-6


def test_several_ranges_bind_at_once_and_no_more_than_must():
    posts = tuple(Disc(np.array(c), 0.1) for c in ([1.0, 0.4], [1.0, -0.4], [-3.0, 0.0]))
    clear = BaseClearance(posts, radius=0.6)
    found = solve_priority(THING, [clear, BasePose(np.array([2.0, 0.0, 0.0]))], HOME)
    gaps = clear.value(THING, found.q)
    np.testing.assert_allclose(gaps[:2], 0.0, atol=1e-6)
    assert gaps[2] > 1.0


def test_a_field_of_view_and_a_look_are_kept_beside_the_tools_place():
    q = HOME.copy()
    T = THING.forward(q)
    target = T[:3, 3] + 1.0 * T[:3, 2] + np.array([0.3, 0.2, 0.0])
    place = ToolPosition(T[:3, 3])
    seen = solve_priority(THING, [FieldOfView(target, 0.1), place], q)
    assert FieldOfView(target, 0.1).value(THING, seen.q)[0] <= 0.1 + 1e-6
    looked = solve_priority(THING, [place, LookAt(target)], q)
    assert looked.converged


def test_manipulability_grows_in_what_the_tool_leaves_free():
    tool = ToolPose(THING.forward(HOME))
    config = TaskPriorityConfig(iterations=60)
    found = solve_priority(THING, [tool, Manipulability(part="arm")], HOME, config)
    assert found.residuals["tool pose"] < 1e-6
    before, after = (manipulability(THING, q, "log_m", "arm")[0] for q in (HOME, found.q))
    assert after > before + 0.05


def test_a_vector_of_ones_own_moves_only_what_is_free():
    tool = ToolPose(THING.forward(HOME))
    turned = solve_priority(
        THING, [tool], HOME, TaskPriorityConfig(iterations=30), free=lambda q: 0.1 * (np.array([1.0, *q[1:]]) - q)
    )
    assert turned.residuals["tool pose"] < 1e-3
    assert turned.q[0] > 0.2


def test_tasks_of_one_level_share_what_cannot_be_had_by_their_weights():
    left, right = BaseHeading(0.0, name="left"), BaseHeading(1.0, name="right", weights=(2.0,))
    found = solve_priority(THING, [[left, right]], HOME)
    assert found.q[2] == pytest.approx(0.8, abs=1e-6)
    first = solve_priority(THING, [left, right], HOME)
    assert first.q[2] == pytest.approx(0.0, abs=1e-6)
    assert "right is off" in first.status


def test_a_free_row_is_free():
    T = se3.retract(THING.forward(HOME), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]))
    found = solve_priority(THING, [ToolPose(T, weights=(1.0, 1.0, 1.0, 1.0, 1.0, 0.0))], HOME)
    assert found.converged
    np.testing.assert_allclose(found.q, HOME, atol=1e-9)


def test_a_step_that_is_too_long_keeps_the_direction_of_the_first_task():
    tasks = [ToolPosition(THING.forward(HOME)[:3, 3] + np.array([0.5, 0.0, 0.0])), Posture(HOME + 1.0)]
    undamped = (Inverse(method="undamped"),)
    config = TaskPriorityConfig(inverses=undamped, iterations=1, max_step_revolute=1e-4, max_step_prismatic=1e-4)
    step = solve_priority(THING, tasks, HOME, config).q - HOME
    alone = solve_priority(THING, tasks[:1], HOME, config).q - HOME
    assert np.max(np.abs(step)) <= 1e-4 + 1e-15
    J = tasks[0].jacobian(THING, HOME)
    np.testing.assert_allclose(J @ step, J @ alone, atol=1e-15)
    assert (J @ step)[0] > 0
    np.testing.assert_allclose((J @ step)[1:], 0.0, atol=1e-15)


def test_an_iteration_that_runs_out_says_so():
    config = TaskPriorityConfig(iterations=2)
    found = solve_priority(THING, [BasePose(np.array([3.0, 0.0, 0.0]))], HOME, config)
    assert found.iterations == 2
    assert "iterations ran out" in found.status


@pytest.mark.parametrize(
    ("tasks", "q0", "free", "message"),
    [
        ([BaseHeading(0.0)], np.zeros(8), None, "start must be 9 finite numbers"),
        ([BaseHeading(0.0)], np.full(9, np.nan), None, "start must be 9 finite numbers"),
        ([BaseHeading(0.0)], HOME, np.zeros(3), "vector z must be 9 finite numbers"),
        ([], HOME, None, "There are no tasks"),
        ([WithinLimits(), Posture(np.zeros(6))], HOME, None, "posture has 6 numbers"),
    ],
)
def test_what_does_not_fit_is_refused_with_a_sentence(tasks, q0, free, message):
    with pytest.raises(PlanningError, match=message):
        solve_priority(THING, tasks, q0, free=free)


def test_levels_that_do_not_fit_are_refused_with_a_sentence():
    with pytest.raises(PlanningError, match="at least one level"):
        hierarchy_step([], [])
    with pytest.raises(PlanningError, match="as many numbers"):
        hierarchy_step([np.ones((2, 3))], [np.ones(3)])
    with pytest.raises(PlanningError, match="finite"):
        hierarchy_step([np.full((2, 3), np.nan)], [np.ones(2)])
