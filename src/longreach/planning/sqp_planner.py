"""Plans by sequential convex optimisation: where it starts from, and how its answer becomes a trajectory."""

import time
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory, TaskReport
from longreach.errors import PlanningError
from longreach.planning.links import Link, Smoothness, StepLimit
from longreach.planning.problem import Problem
from longreach.planning.program import Program
from longreach.planning.sqp import solve
from longreach.planning.sqp_merit import merits, objectives
from longreach.planning.sqp_run import SqpConfig
from longreach.planning.sqp_solution import OptimisedTrajectory, SqpSolution, solution_of
from longreach.planning.sqp_start import aside, coupled_start, most_outside, starts_of
from longreach.planning.task_priority import checked_start
from longreach.planning.terms import NearSeed, Waypoints
from longreach.planning.terms_clearance import Clearance, Keeping, least_clearance
from longreach.planning.terms_pose import BaseHeading, ToolPose
from longreach.planning.thesis_problem import thesis_problem
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator

_FAR = 1e-3  # [m, rad] by which a start may violate a constraint that all waypoints together then come to keep
_NEAREST = 15  # iterations on the way to a start that holds: then all waypoints together do better
_WIDENINGS = 4  # of the margins, at most
_WIDER = 1.5  # by which a margin grows, in what was missing between waypoints


def optimise(
    robot: MobileManipulator,
    reference: Reference,
    problem: Problem,
    start: Float[np.ndarray, "N n"],
    coupled: bool = True,
    config: SqpConfig | None = None,
) -> SqpSolution:
    """Return the solution of a problem near a start (N, n), one configuration a waypoint.

    coupled: all waypoints as one problem, links and all; otherwise each by itself, without links.

    Raises:
        PlanningError: bounds contradict each other, the start does not fit, or a term gives no finite number.
    """
    n = len(reference)
    if start.shape != (n, robot.dof) or not np.all(np.isfinite(start)):
        raise PlanningError(f"The start must be {n} rows of {robot.dof} finite numbers, one row a waypoint.")
    index = np.arange(n)[None] if coupled else np.arange(n)[:, None]
    run = solve(Program.of(problem, robot, reference, index), start[index], config or SqpConfig())
    return solution_of(run, np.arange(len(index)))


def plan_by_sqp(
    robot: MobileManipulator,
    reference: Reference,
    q0: Float[np.ndarray, " n"],
    iterations: int = 60,
    problem: Problem | None = None,
    coupled: bool = True,
    config: SqpConfig | None = None,
    initial: ConfigurationTrajectory | None = None,
) -> OptimisedTrajectory:
    """Plan all waypoints at once (coupled), or each by itself, by Algorithm 2 from a start by task priority.

    Arguments: problem: (4.34) with the thesis' numbers where None; initial: a former answer to start from instead.

    Its `solution` holds the certificate; where a constraint is not met, its report and the status say which.
    """
    config = (config or SqpConfig()).model_copy(update={"iterations": iterations})
    problem = thesis_problem() if problem is None else problem
    if not isinstance(problem, Problem):
        raise PlanningError(f"The problem is a {type(problem).__name__}; make it by thesis_problem or problem_of.")
    _check_start(robot, checked_start(robot, q0), problem)
    if not coupled:
        starts = (
            starts_of(robot, reference, q0, problem) if initial is None else _resampled(initial, robot, reference)[None]
        )
        solution = _best_alone(robot, reference, starts, problem, config)
    else:
        starts = starts_of(robot, reference, q0, problem)
        problem = _fitted(problem, starts[0])
        if initial is None:
            start = coupled_start(robot, reference, q0, problem, starts)
        else:
            start = _resampled(initial, robot, reference)
        end = time.monotonic() + config.budget
        start = _moved_clear(robot, reference, q0, problem, start, config)
        solution = _clear_between(robot, reference, problem, start, config, end)
    reports = tuple(_report(name, off, solution, problem, config.met) for name, off in solution.off.items())
    return OptimisedTrajectory(reference.stamps, solution.q, robot.joint_names, reports=reports, solution=solution)


def _check_start(robot: MobileManipulator, q0: np.ndarray, problem: Problem) -> None:
    """Raise a PlanningError where an obstacle holds what should keep clear of it: no way leads out."""
    for term in problem.constraints:
        if isinstance(term, Clearance):
            at = Waypoints(robot, Reference(np.zeros(1), base=np.zeros((1, 3))), np.zeros(1, dtype=int), q0[None])
            depth = -term.value_and_jacobian(at)[0][0].reshape(len(term.capsules), -1).min(axis=1)
            deepest = depth - [link.capsule.radius for link in term.capsules]
            if deepest.max() > 0:
                frame = term.capsules[int(deepest.argmax())].frame
                raise PlanningError(
                    f"An obstacle of {term.name!r} contains the start: {frame} is {deepest.max():.3g} m inside it; "
                    "move the robot or the obstacle."
                )


def _left(config: SqpConfig, end: float) -> SqpConfig:
    """Return the settings with what is left of the time."""
    return config.model_copy(update={"budget": max(end - time.monotonic(), 1e-3)})


def _resampled(initial: ConfigurationTrajectory, robot: MobileManipulator, reference: Reference) -> np.ndarray:
    """Return where the former answer is at the reference's stamps (N, n)."""
    if not isinstance(initial, ConfigurationTrajectory) or initial.q.shape[1] != robot.dof:
        raise PlanningError(
            f"The initial plan must be a trajectory of the joints of {robot.name}; give a former answer."
        )
    columns = [np.interp(reference.stamps, initial.stamps, column) for column in initial.q.T]
    return np.column_stack(columns)


def _best_alone(
    robot: MobileManipulator, reference: Reference, starts: np.ndarray, problem: Problem, config: SqpConfig
) -> SqpSolution:
    """Return the best answer at each waypoint by itself, over the starts (s, N, n)."""
    s, N, n = starts.shape
    index = np.tile(np.arange(N), s)
    program = Program.of(problem, robot, reference, index[:, None])
    run = solve(program, starts.reshape(s * N, 1, n), config, index if s > 1 else None)
    rank = np.where(run.solved, objectives(run), np.inf).reshape(s, N)
    rank = np.where(np.isfinite(rank).any(axis=0), rank, merits(run).reshape(s, N))
    return solution_of(run, rank.argmin(axis=0) * N + np.arange(N))


def _moved_clear(
    robot: MobileManipulator, reference: Reference, q0: np.ndarray, problem: Problem, start: np.ndarray,
    config: SqpConfig,
) -> np.ndarray:  # fmt: skip
    """Return a start that constraints are not far from holding at, each waypoint moved to the nearest where need be."""
    if most_outside(robot, reference, problem, start).max() <= _FAR:
        return start
    start = aside(robot, reference, q0, problem, start)
    if most_outside(robot, reference, problem, start).max() <= _FAR:
        return start
    near = Problem((NearSeed(start, np.ones(robot.dof)),), problem.constraints, (), problem.limits)
    half = config.model_copy(update={"budget": 0.5 * config.budget, "iterations": min(_NEAREST, config.iterations)})
    return optimise(robot, reference, near, start, False, half).q


def _clear_between(
    robot: MobileManipulator, reference: Reference, problem: Problem, start: np.ndarray, config: SqpConfig,
    end: float,
) -> SqpSolution:  # fmt: skip
    """Return the solution, its margins widened until the straight lines between waypoints are clear, too."""
    solution = optimise(robot, reference, problem, start, True, _left(config, end))
    wider = problem
    for _ in range(_WIDENINGS):
        short = {
            term.name: term.margin - least_clearance(robot, solution.q, term)[0]
            for term in problem.constraints
            if isinstance(term, Keeping)
        }
        if solution.violated or time.monotonic() > end or all(gap <= 0.0 for gap in short.values()):
            break
        terms = [
            replace(term, margin=term.margin + _WIDER * max(short.get(term.name, 0.0), 0.0))
            if isinstance(term, Keeping)
            else term
            for term in wider.constraints
        ]
        wider = replace(wider, constraints=tuple(terms))
        solution = optimise(robot, reference, wider, solution.q, True, _left(config, end))
    return solution


def _fitted(problem: Problem, start: np.ndarray) -> Problem:
    """Return the problem with a limit of steps that the start can come to keep, and smoothness in its measure."""
    steps = np.diff(start, axis=0)
    largest, square = float(np.abs(steps).max(initial=0.0)), float(np.sum(steps**2, axis=1).mean()) if len(steps) else 0

    def fit(link: Link) -> Link:
        if isinstance(link, StepLimit):
            return replace(link, step=max(link.step, link.room * largest))
        if isinstance(link, Smoothness) and link.relative and square > 0:
            return replace(link, weight=link.weight / square, relative=False)
        return link

    return replace(problem, links=tuple(fit(link) for link in problem.links))


def _report(
    name: str, off: Float[np.ndarray, "k m"], solution: SqpSolution, problem: Problem, met: float
) -> TaskReport:
    """Say what became of one constraint."""
    N = len(solution.q)
    size = np.zeros((N, 2))
    term = next((term for term in problem.constraints if term.name == name), None)
    if isinstance(term, ToolPose):
        size[:] = np.column_stack([np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)])
    else:
        size[: len(off), int(isinstance(term, BaseHeading))] = off.max(axis=1, initial=0.0)
    unmet = off.max(axis=1, initial=0.0) > met
    reason = solution.status if unmet.any() else f"Met everywhere: {name}."
    return TaskReport(name, size[:, 0], size[:, 1], np.concatenate([unmet, np.zeros(N - len(off), dtype=bool)]), reason)
