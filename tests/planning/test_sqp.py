"""Algorithm 2: its answers satisfy the optimality conditions, agree with another solver, and say what cannot be met."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.optimize import minimize

import longreach as lr
from longreach.errors import PlanningError
from longreach.planning.links import AccelerationLimit, Smoothness, StepLimit, VelocityLimit
from longreach.planning.problem import LIMITS, Problem, evaluate
from longreach.planning.program import Program
from longreach.planning.sqp_planner import optimise
from longreach.planning.sqp_run import SqpConfig
from longreach.planning.terms import NearSeed, Waypoints
from longreach.planning.terms_pose import BaseDisc, BaseHeading, ToolPose

THING = lr.load_robot("thing").with_tool("flange")
HOME = np.array([0.0, 0.0, 0.0, 0.0, -2.0, 2.0, -1.5, -1.57, 0.0])
N = 24


def reference(n=N, step=0.01):
    """A straight line for the tool, a wave for the base."""
    T = np.tile(THING.forward(HOME), (n, 1, 1))
    along = step * np.arange(n)
    T[:, 0, 3] += along
    base = np.column_stack([along, 0.2 * np.sin(np.pi * along), np.zeros(n)])
    return lr.Reference(0.1 * np.arange(n), tool=T, base=base)


def start(ref):
    slow = lr.Reference(1e3 * np.arange(len(ref)), ref.tool, ref.base)
    return lr.plan(THING, slow, HOME).q


def kkt_residual(ref, problem, solution, coupled):
    """The largest of |∇L|, |λ · slack|, a multiplier's wrong sign, and what is violated, from the answer alone."""
    q, lam = solution.q, solution.multipliers
    at = Waypoints(THING, ref, np.arange(len(ref)), q)
    e = evaluate(problem, at)
    r, worst = e.g + lam[LIMITS], [0.0]

    def bound(v, lower, upper, y):
        worst.append(np.max(np.maximum(lower - v, v - upper), initial=0.0))
        slack = np.where(y > 0, upper - v, v - lower)
        worst.append(np.max(np.abs(y * slack)[y != 0], initial=0.0))

    for constraint in problem.constraints:
        v, A = constraint.value_and_jacobian(at)
        r = r + np.einsum("kmj,km->kj", A, lam[constraint.name])
        bound(v, *constraint.bounds(at), lam[constraint.name])
    bound(q, THING.lower, THING.upper, lam[LIMITS])
    for link in problem.links if coupled else ():
        D = np.zeros((len(link.coefficients(ref)), len(ref)))
        for k, row in enumerate(link.coefficients(ref)):
            D[k, k : k + len(row)] = row
        if isinstance(link, Smoothness):
            r = r + 2.0 * link.weight * D.T @ D @ q
        else:
            limit = link.limits(THING, ref)
            bound(D @ q, -limit, limit, lam[link.name])
            r = r + D.T @ lam[link.name]
    return max(np.abs(r).max(), *worst)


LINKS = {
    "smooth": (Smoothness(1.0),),
    "bent": (Smoothness(1.0, order=2), Smoothness(0.5, name="short")),
    "steps": (Smoothness(1.0), StepLimit(0.0122)),
    "limits": (Smoothness(1.0), VelocityLimit(0.3), AccelerationLimit(0.5)),
}


@pytest.mark.parametrize("links", LINKS.values(), ids=LINKS)
@pytest.mark.parametrize("objective", ["sqrt_kappa_over_m", "neg_log_m"])
def test_the_answer_of_a_whole_trajectory_satisfies_the_optimality_conditions(links, objective):
    ref = reference()
    problem = replace(lr.thesis_problem(objective=objective), links=links)
    solution = optimise(THING, ref, problem, start(ref))
    assert solution.converged, solution.status
    assert kkt_residual(ref, problem, solution, True) <= 1e-6
    assert solution.violated == ()


@pytest.mark.parametrize("objective", ["sqrt_kappa_over_m", "neg_log_m", "neg_m", "kappa"])
@pytest.mark.parametrize("part", ["full", "arm"])
def test_the_answers_of_waypoints_by_themselves_satisfy_the_optimality_conditions(objective, part):
    ref = reference(6, 0.1)
    problem = lr.thesis_problem(0.02, 0.1, part, objective)
    solution = optimise(THING, ref, problem, start(ref), coupled=False)
    assert solution.converged, solution.status
    assert kkt_residual(ref, problem, solution, False) <= 1e-6


def test_a_general_solver_finds_the_same():
    ref = reference(1)
    problem = lr.thesis_problem()
    ours = optimise(THING, ref, problem, start(ref), coupled=False)

    def terms(q):
        return evaluate(problem, Waypoints(THING, ref, np.zeros(1, dtype=int), q[None]))

    found = minimize(
        lambda q: terms(q).f[0], start(ref)[0], jac=lambda q: terms(q).g[0], method="SLSQP",
        bounds=list(zip(THING.lower, THING.upper, strict=True)),
        constraints=[
            {"type": "eq", "fun": lambda q: terms(q).c[0, :6], "jac": lambda q: terms(q).A[0, :6]},
            {"type": "ineq", "fun": lambda q: 0.005 - terms(q).c[0, 6], "jac": lambda q: -terms(q).A[0, 6]},
            {"type": "ineq", "fun": lambda q: 0.1 - terms(q).c[0, -1], "jac": lambda q: -terms(q).A[0, -1]},
            {"type": "ineq", "fun": lambda q: 0.1 + terms(q).c[0, -1], "jac": lambda q: terms(q).A[0, -1]},
        ],
        options={"ftol": 1e-14, "maxiter": 500},
    )  # fmt: skip
    assert ours.converged
    assert ours.objective[0] <= found.fun + 1e-7


def test_staying_near_a_seed_is_least_squares(rng):
    ref = reference(3)
    seed = HOME + 0.01 * rng.normal(size=(3, 9))
    problem = Problem((NearSeed(seed, np.ones(9)),))
    solution = optimise(THING, ref, problem, start(ref), coupled=False)
    np.testing.assert_allclose(solution.q, seed, atol=1e-6)


def test_without_a_cost_the_answer_is_any_that_is_feasible():
    ref = reference(3)
    problem = Problem(constraints=(ToolPose(), BaseDisc(0.05)))  # (4.24)
    solution = optimise(THING, ref, problem, start(ref) + 0.05, coupled=False)
    assert solution.converged, solution.status
    assert max(solution.residuals.values()) <= 1e-6


def test_a_start_outside_every_limit_will_do():
    ref = reference(2)
    tight = THING.with_limits(np.full(9, -2.5), np.full(9, 2.5))
    solution = optimise(tight, ref, lr.thesis_problem(0.05), start(ref) + 4.0, coupled=False)
    assert np.all(np.abs(solution.q) <= 2.5)
    near = optimise(tight, ref, lr.thesis_problem(0.05), np.clip(start(ref) + 0.5, -2.5, 2.5), coupled=False)
    assert near.violated == (), near.status


def test_what_cannot_be_met_is_named_with_what_stands_against_it():
    ref = reference(3)
    far = lr.Reference(ref.stamps, tool=ref.tool + np.eye(4, k=3)[None] * 3.0, base=ref.base)
    for coupled in (False, True):
        solution = optimise(THING, far, Problem(constraints=(ToolPose(), BaseDisc(0.01))), start(ref), coupled)
        assert not solution.converged
        assert "tool pose" in solution.violated
        assert "tool pose is not met at waypoint" in solution.status
        assert "base disc" in solution.status
        assert solution.residuals["tool pose"] > 0.5


def test_the_time_budget_returns_the_best_so_far():
    ref = reference()
    problem = lr.thesis_problem()
    begin = start(ref)
    solution = optimise(THING, ref, problem, begin, config=SqpConfig(budget=1e-6))
    assert solution.iterations == 1
    assert "time ran out" in solution.status
    assert solution.violated == () or solution.residuals["tool pose"] < 1e-3
    before = evaluate(problem, Waypoints(THING, ref, np.arange(N), begin)).f.sum()
    assert solution.objective.sum() <= before


def test_the_merit_never_rises_while_penalties_stay():
    ref = reference()
    history = optimise(THING, ref, lr.thesis_problem(), start(ref)).history
    merit = np.array([row["merit"] for row in history])
    same = np.diff([row["penalty"] for row in history]) == 0
    assert np.all(np.diff(merit)[same] <= 1e-9)


def test_penalties_rise_where_something_stays_violated():
    ref = reference(2)
    far = lr.Reference(ref.stamps, tool=ref.tool + np.eye(4, k=3)[None] * 3.0, base=ref.base)
    config = SqpConfig(raises=2, iterations=200)
    solution = optimise(THING, far, Problem(constraints=(ToolPose(), BaseDisc(0.01))), start(ref), False, config)
    penalties = {row["penalty"] for row in solution.history}
    assert {10.0, 100.0, 1000.0} <= penalties


@pytest.mark.parametrize(
    "settings", [{"accept": 1.5}, {"shrink": 0.0}, {"expand": 0.5}, {"iterations": 0}, {"unknown": 1}]
)
def test_settings_that_make_no_sense_are_refused(settings):
    with pytest.raises(ValidationError, match=next(iter(settings))):
        SqpConfig(**settings)


def test_contradictory_bounds_are_named(monkeypatch):
    ref = reference(2)
    monkeypatch.setattr(
        BaseHeading, "bounds", lambda term, at: (np.full((len(at), 1), 0.2), np.full((len(at), 1), 0.1))
    )
    with pytest.raises(PlanningError, match="bounds of 'base heading' contradict each other at waypoint 0"):
        optimise(THING, ref, lr.thesis_problem(), start(ref))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Smoothness(-1.0), "not below zero"),
        (lambda: Smoothness(1.0, order=3), "1 or 2"),
        (lambda: StepLimit(0.0), "above 0"),
        (lambda: optimise(THING, reference(2), lr.thesis_problem(), np.zeros((3, 9))), "2 rows of 9"),
        (lambda: optimise(THING, reference(2), lr.thesis_problem(), np.full((2, 9), np.nan)), "finite numbers"),
    ],
)
def test_what_cannot_be_solved_is_refused(make, message):
    with pytest.raises(PlanningError, match=message):
        make()


def test_links_count_only_where_waypoints_are_solved_together():
    ref = reference(3)
    apart = Program.of(lr.thesis_problem(), THING, ref, np.arange(3)[:, None])
    together = Program.of(lr.thesis_problem(), THING, ref, np.arange(3)[None])
    assert (apart.costs, apart.limits) == ((), ())
    assert (len(together.costs), len(together.limits)) == (1, 1)
