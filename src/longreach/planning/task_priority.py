"""Task priority: a configuration for tasks of which a later one never disturbs an earlier one.

Siciliano–Slotine is (4.16) for any number of levels; it does all of a lower task that the higher ones leave free, and
Chiaverini (4.17) is steadier where tasks collide but lags behind. Ranges (joint limits, distances) take part in the
hierarchy where they stand and bind only when a step would leave them. Limits of one step shorten the part of the lowest
level first, so that the direction of the highest task stays as it is.

Source: Siciliano & Slotine 1991, "A general framework for managing multiple tasks in highly redundant robotic
systems"; Chiaverini 1997; Moe, Antonelli, Teel, Pettersen & Schrimpf 2016, "Set-based tasks within the
singularity-robust multiple task-priority inverse kinematics framework".
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from pydantic import BaseModel, Field

from longreach.errors import PlanningError
from longreach.planning import _follow_kernels as kernels
from longreach.planning.explanation import why
from longreach.planning.hierarchy import SCHEMES, Scheme, level_settings
from longreach.planning.pseudoinverse import Inverse
from longreach.planning.solution import Solution
from longreach.planning.stack import Stack
from longreach.planning.task import Levels
from longreach.robot.mobile_manipulator import MobileManipulator, turned_like

Free = Float[np.ndarray, " _"] | Callable[[Float[np.ndarray, " _"]], Float[np.ndarray, " _"]] | None


class TaskPriorityConfig(BaseModel, frozen=True, extra="forbid"):
    """Settings of task priority."""

    scheme: Scheme = Field(default="siciliano-slotine", description="(4.16) for any number of levels, or (4.17).")
    inverses: tuple[Inverse, ...] = Field(
        default=(Inverse(method="damped"),),
        min_length=1,
        description="J# of each level, the last one of all further levels.",
    )
    learned_damping: float = Field(
        default=1.0,
        ge=0,
        allow_inf_nan=False,
        description="Where damped, at most this times ‖e‖ is added to λ as steps miss what they promise [1]; ours, "
        "about a chain's curvature.",
    )
    limits: bool = Field(default=True, description="Whether the joints' limits come before all tasks.")
    iterations: int = Field(default=200, ge=1, description="At most so many for one configuration [1].")
    max_step_revolute: float = Field(
        default=0.2, gt=0, description="Farthest a joint goes in one iteration [rad]; ours."
    )
    max_step_prismatic: float = Field(default=0.2, gt=0, description="The same of a prismatic joint [m]; ours.")
    tolerance: float = Field(default=3e-13, ge=0, description="An error that ends the iteration [m, rad]; ours.")
    least_step: float = Field(default=1e-9, ge=0, description="A step that ends it [m, rad]; ours.")
    met: float = Field(
        default=1e-4, gt=0, description="A task of a smaller error counts as met [m, rad]; what TRAC-IK's authors use."
    )


@lru_cache(maxsize=64)
def _inverses(config: TaskPriorityConfig, stack: Stack) -> tuple[np.ndarray, ...]:
    """Return each level's settings (levels, 5), dampings, and bounds where selective."""
    levels, n = len(stack.starts) - 1, len(config.inverses)
    chosen = [config.inverses[min(i, n - 1)] for i in range(levels)]
    if stack.ranged[0]:  # the level of the limits is not one that the caller counts
        chosen = [chosen[0], *chosen[:-1]]
    setting, reach, longest = level_settings(chosen, stack.robot.prismatic, int(np.max(np.diff(stack.starts))))
    by_error = np.array([c.error_damping for c in chosen])
    return setting, setting[:, 1].copy(), by_error, reach, longest


def settings(config: TaskPriorityConfig, stack: Stack, z: np.ndarray) -> tuple[Any, ...]:
    """Return what the kernels call `problem`."""
    setting, damping, by_error, reach, longest = _inverses(config, stack)
    return (
        stack.starts, stack.ranged, stack.gains, stack.lower, stack.upper, SCHEMES[config.scheme], setting.copy(),
        damping, by_error, config.learned_damping, reach, longest, np.array(z, dtype=float),
    )  # fmt: skip


def _iterate(
    stack: Stack, problem: tuple[Any, ...], memory: Any, q: np.ndarray, last: np.ndarray, speed: np.ndarray,
    iterations: int, config: TaskPriorityConfig, free: Free, expects: bool,
) -> tuple[np.ndarray, int]:  # fmt: skip
    """Move q in place; return the rows' values there and how many iterations it took. `follow` does it compiled."""
    n, M = len(q), len(stack.kept)
    low, high, dq, expected, none = np.empty((2, n)), np.empty((2, n)), np.zeros(n), np.zeros(M), np.zeros(M)
    lengths, (predicted, missed) = memory[0][1], memory[2]
    longest = farthest(stack.robot, config)
    for iteration in range(iterations + 1):
        e, A = stack.rows(q)
        worst = kernels.measure(e, stack.starts, stack.ranged, stack.lower, stack.upper, lengths)
        if iteration > 0:
            kernels.learn(problem[9], memory[0])
        if iteration == 1:
            missed[:] = e - predicted
        stuck = iteration > 0 and np.max(np.abs(dq)) < config.least_step
        if iteration == iterations or (worst <= config.tolerance and free is None) or stuck:
            if iteration == 0:
                missed[:] = 0.0
            return e, iteration
        if iteration == 0 and expects:
            kernels.expect(e, stack.starts, missed, expected)
        if callable(free):
            problem[-1][:] = _checked_vector(len(q), free(q))
        kernels.room(iteration, iterations, q, last, speed, longest, low, high)
        kernels.advance(e, A, low, high, problem, memory, expected if iteration == 0 else none, dq)
        q += dq
    raise AssertionError("the last iteration returns")


def farthest(robot: MobileManipulator, config: TaskPriorityConfig) -> np.ndarray:
    return np.where(robot.prismatic, config.max_step_prismatic, config.max_step_revolute)


def checked_start(robot: MobileManipulator, q0: Float[np.ndarray, " _"]) -> Float[np.ndarray, " n"]:
    """Return a copy of q0, or say that it does not fit the robot."""
    q = np.array(q0, dtype=float)
    if q.shape != (robot.dof,) or not np.all(np.isfinite(q)):
        raise PlanningError(f"The start must be {robot.dof} finite numbers, one for each joint of {robot.name}.")
    return q


def _checked_vector(n: int, z: Float[np.ndarray, " _"]) -> Float[np.ndarray, " n"]:
    """Return z as it is, or say that it is no step of a robot with n joints."""
    vector = np.asarray(z, dtype=float)
    if vector.shape != (n,) or not np.all(np.isfinite(vector)):
        raise PlanningError(f"The vector z must be {n} finite numbers.")
    return vector


def solve_priority(
    robot: MobileManipulator,
    tasks: Levels,
    q0: Float[np.ndarray, " _"],
    config: TaskPriorityConfig | None = None,
    free: Free = None,
) -> Solution:
    """Find a configuration for tasks in order of priority, near q0 (n,) [rad or m].

    Arguments: tasks: a sequence of levels, the most important first; tasks in a sequence of their own share a level.
        free: z of (4.15), a step (n,) or a function of q that gives one, made in what all tasks leave free.

    A start outside the joints' limits comes back inside. `residuals` are ‖e‖ with a length of 1 m, `status` says of
    each task that is not met what stands against it.

    Raises:
        PlanningError: a task or the start does not fit the robot.
    """
    config = config or TaskPriorityConfig()
    q = checked_start(robot, q0)
    robot = turned_like(robot, q)
    stack = Stack.of(robot, tasks, config.limits)
    z = np.zeros(robot.dof) if free is None or callable(free) else _checked_vector(robot.dof, free)
    memory = kernels.remember(len(stack.kept), robot.dof, len(stack.starts) - 1)
    unlimited = np.full(robot.dof, np.inf)
    problem = settings(config, stack, z)
    e, iterations = _iterate(
        stack, problem, memory, q, q.copy(), unlimited, config.iterations, config, free, expects=False
    )
    sizes = np.hypot(*stack.sizes(e)).tolist()
    residuals = {task.name: size for task, size in zip(stack.tasks, sizes, strict=True)}
    violated = tuple(name for name, size in residuals.items() if size > config.met)
    reasons = [why(stack, q, i) for i, task in enumerate(stack.tasks) if task.name in violated]
    status = " ".join(reasons) or "All tasks are met."
    return Solution(q, status, not violated, iterations, residuals, violated)


def follow(
    robot: MobileManipulator,
    waypoints: Sequence[Levels],
    speeds: Float[np.ndarray, "k n"],
    q0: Float[np.ndarray, " _"],
    config: TaskPriorityConfig,
    free: Free = None,
) -> tuple[Float[np.ndarray, "k n"], Float[np.ndarray, "2 tasks k"], Int[np.ndarray, " k"]]:
    """Return configurations, sizes of errors [m; rad] and iterations at each waypoint, from tasks of any kind.

    Arguments: speeds: how far a joint may go from one waypoint to the next.
    """
    q, memory, problem = checked_start(robot, q0), None, None
    z = np.zeros(robot.dof) if free is None or callable(free) else _checked_vector(robot.dof, free)
    Q, sizes, counts = [], [], []
    for k, tasks in enumerate(waypoints):
        stack = Stack.of(robot, tasks, config.limits)
        if memory is None:
            memory = kernels.remember(len(stack.kept), robot.dof, len(stack.starts) - 1)
        problem = settings(config, stack, z)
        last = Q[-1] if Q else q.copy()
        e, count = _iterate(stack, problem, memory, q, last, speeds[k], config.iterations, config, free, expects=True)
        Q.append(q.copy())
        sizes.append(stack.sizes(e))
        counts.append(count)
    return np.array(Q), np.stack(sizes, axis=-1), np.array(counts)
