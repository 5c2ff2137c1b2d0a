"""Where a plan by sequential convex optimisation starts: by task priority, its heading where the cost is less."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from longreach.planning.links import StepLimit
from longreach.planning.priority_planner import plan_by_task_priority
from longreach.planning.problem import Layout, Problem, evaluate
from longreach.planning.program import outside
from longreach.planning.terms import Waypoints
from longreach.planning.terms_pose import BaseDisc, BaseHeading
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator

_LONG = 1e4  # [s] between the waypoints of a start, so that no limit of speed counts
_RAMP = 0.6  # part of the largest step that a change of heading in the start takes
_SIDES = 6  # to which the base is tried moved as a whole
_ASIDE, _TURNED = 0.7, 0.5  # how far, and how far turned either way, in parts of its room


def by_task_priority(
    robot: MobileManipulator, reference: Reference, q0: np.ndarray, turn: float | np.ndarray = 0.0
) -> np.ndarray:
    """Return configurations (N, n) on the reference, its base turned."""
    base = None if reference.base is None else reference.base + np.array([0.0, 0.0, 1.0]) * np.reshape(turn, (-1, 1))
    slow = Reference(_LONG * np.arange(len(reference)), reference.tool, base)
    return plan_by_task_priority(robot, slow, q0).q


def band_of_heading(problem: Problem, reference: Reference) -> float:
    """Return how far the heading is free either way: there the cost has one optimum at each end."""
    bands = [constraint.band for constraint in problem.constraints if isinstance(constraint, BaseHeading)]
    return min(bands) if bands and reference.base is not None else 0.0


def starts_of(
    robot: MobileManipulator, reference: Reference, q0: np.ndarray, problem: Problem
) -> Float[np.ndarray, "s N n"]:
    band = band_of_heading(problem, reference)
    turns = (band, -band) if band > 0 else (0.0,)
    return np.array([by_task_priority(robot, reference, q0, turn) for turn in turns])


def coupled_start(
    robot: MobileManipulator, reference: Reference, q0: np.ndarray, problem: Problem, starts: np.ndarray
) -> Float[np.ndarray, "N n"]:
    """Return a start whose heading is at that end of its band where the cost is less, changing over slowly."""
    if len(starts) == 1:
        return starts[0]
    s, N, n = starts.shape
    at = Waypoints(robot, reference, np.tile(np.arange(N), s), starts.reshape(s * N, n))
    cost = evaluate(replace(problem, constraints=(), links=(), limits=True), at).f.reshape(s, N)
    band = band_of_heading(problem, reference)
    limits = [link.step for link in problem.links if isinstance(link, StepLimit)]
    rate = min(_RAMP * min([*limits, band]), np.abs(np.diff(starts[0], axis=0)).max(initial=band))
    return by_task_priority(robot, reference, q0, _turns(cost, band, rate))


def most_outside(
    robot: MobileManipulator, reference: Reference, problem: Problem, start: Float[np.ndarray, "N n"]
) -> Float[np.ndarray, " N"]:
    """Return by how much the constraint that is violated most is so, at each waypoint (N,)."""
    at = Waypoints(robot, reference, np.arange(len(start)), np.clip(start, robot.lower, robot.upper))
    e, layout = evaluate(replace(problem, costs=(), links=(), limits=True), at), Layout.of(problem, at)
    return outside(e.c, layout.lower, layout.upper).max(axis=1, initial=0.0)


def aside(
    robot: MobileManipulator, reference: Reference, q0: np.ndarray, problem: Problem, start: np.ndarray
) -> Float[np.ndarray, "N n"]:
    """Return the start that violates constraints least: the one given, or one with its base moved aside as a whole.

    So the base may pass an obstacle on its other side, and the elbow where linear models would not lead it.
    """
    discs = [constraint.radius for constraint in problem.constraints if isinstance(constraint, BaseDisc)]
    if not discs or reference.base is None:
        return start
    best, least = start, most_outside(robot, reference, problem, start).sum()
    for angle in np.arange(_SIDES) * 2.0 * np.pi / _SIDES:
        for turn in (-_TURNED, _TURNED):
            by = np.array([np.cos(angle), np.sin(angle), 0.0]) * _ASIDE * min(discs)
            by[2] = turn * band_of_heading(problem, reference)
            moved = by_task_priority(robot, replace(reference, base=reference.base + by), q0)
            off = most_outside(robot, reference, problem, moved).sum()
            if off < least:
                best, least = moved, off
    return best


def _turns(cost: Float[np.ndarray, "2 N"], band: float, rate: float) -> Float[np.ndarray, " N"]:
    """Return the heading's place in its band (N,): the cheaper path between its two ends, by dynamic programming.

    A change takes 2 band / rate waypoints, over which the cost is taken for the mean of both ends'.
    """
    N = cost.shape[1]
    width = max(int(np.ceil(2.0 * band / rate)), 1)
    excess = 0.5 * width * np.abs(cost[0] - cost[1]).mean()
    total = cost[:, 0].copy()
    came = np.zeros((2, N), dtype=int)
    for k in range(1, N):
        change = total[::-1] + excess < total
        came[:, k] = np.where(change, [1, 0], [0, 1])
        total = np.minimum(total, total[::-1] + excess) + cost[:, k]
    path = np.empty(N, dtype=int)
    path[-1] = int(np.argmin(total))
    for k in range(N - 1, 0, -1):
        path[k - 1] = came[path[k], k]
    square = np.where(path == 0, band, -band)
    window = np.ones(width) / width
    padded = np.concatenate([np.full(width, square[0]), square, np.full(width, square[-1])])
    return np.convolve(padded, window, mode="same")[width:-width]
