"""The main path: a reference for tool and base becomes a trajectory of all joints."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory, TaskReport
from longreach.errors import PlanningError
from longreach.planning import _follow_kernels as kernels
from longreach.planning.explanation import why
from longreach.planning.stack import Stack
from longreach.planning.task import Levels, Task
from longreach.planning.task_priority import Free, TaskPriorityConfig, checked_start, farthest, follow, settings
from longreach.planning.tasks_pose import BasePose, ToolPose
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator


def plan(
    robot: MobileManipulator,
    reference: Reference,
    q0: Float[np.ndarray, " n"],
    method: str = "task-priority",
    iterations: int = 20,
    **options: Any,
) -> ConfigurationTrajectory:
    """Plan configurations along a reference, one for each of its waypoints, from q0 (n,) [rad or m] on.

    Arguments: method: task-priority; iterations: at most so many a waypoint; options: of the method, see
        `plan_by_task_priority`.

    The trajectory's `reports` say of each task how far off it is along the way, and why where it is not met.

    Raises:
        PlanningError: there is no such method, or the reference or the start does not fit the robot.
    """
    if method not in _METHODS:
        raise PlanningError(f"There is no method {method!r}; there is {', '.join(_METHODS)}.")
    if iterations < 1:
        raise PlanningError(f"A plan needs at least one iteration a waypoint, not {iterations}.")
    return _METHODS[method](robot, reference, q0, iterations, **options)


def plan_by_task_priority(
    robot: MobileManipulator,
    reference: Reference,
    q0: Float[np.ndarray, " n"],
    iterations: int = 20,
    above: Levels = (),
    below: Levels = (),
    free: Free = None,
    config: TaskPriorityConfig | None = None,
) -> ConfigurationTrajectory:
    """Plan waypoint by waypoint: the joints' limits, then tasks `above`, the tool, the base, and tasks `below`.

    From one waypoint to the next no joint goes farther than its limit of speed allows.
    """
    config = config or TaskPriorityConfig()
    q = checked_start(robot, q0)
    if reference.base is not None and robot.base.stop == 0:
        raise PlanningError(f"The reference moves a base, but {robot.name} is bolted down; give it tool poses only.")
    reach = np.full((len(reference), robot.dof), np.inf)  # to the first one there is no time to keep
    np.multiply.outer(np.diff(reference.stamps), robot.limits.velocity, out=reach[1:])
    stack = Stack.of(robot, _levels(reference, 0, above, below), config.limits)
    if stack.compiled and not callable(free):
        Q, E, counts = _compiled(stack, reference, reach, q, iterations, config, free)
    else:
        config = config.model_copy(update={"iterations": iterations})
        waypoints = [_levels(reference, k, above, below) for k in range(len(reference))]
        stack, Q, E, counts = follow(robot, waypoints, reach, q, config, free)
    at = lambda k: Stack.of(robot, _levels(reference, k, above, below), config.limits)  # noqa: E731
    reports = _reports(stack, at, Q, E, reach, config.met)
    return ConfigurationTrajectory(reference.stamps, Q, robot.joint_names, reports=reports)


def _levels(reference: Reference, k: int, above: Levels, below: Levels) -> list[Task | Sequence[Task]]:
    """Return the tasks at one waypoint."""
    tasks: list[Task | Sequence[Task]] = [*above]
    if reference.tool is not None:
        tasks.append(ToolPose(reference.tool[k], name="tool"))
    if reference.base is not None:
        tasks.append(BasePose(reference.base[k], name="base"))
    return [*tasks, *below]


def _compiled(
    stack: Stack, reference: Reference, reach: np.ndarray, q: np.ndarray, iterations: int,
    config: TaskPriorityConfig, free: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return configurations, the rows' values and iterations at all waypoints, by one call of a kernel."""
    robot, count = stack.robot, len(reference)
    targets = np.zeros((count, len(stack.tasks), max(16, robot.dof)))
    for i, task in enumerate(stack.tasks):
        if task.name == "tool" and isinstance(task, ToolPose) and reference.tool is not None:
            targets[:, i, :16] = reference.tool.reshape(count, 16)
        elif task.name == "base" and isinstance(task, BasePose) and reference.base is not None:
            targets[:, i, :3] = reference.base
        else:
            numbers = task.numbers()
            targets[:, i, : len(numbers)] = numbers
    kinds = np.array([task.kind for task in stack.tasks])
    z = np.zeros(robot.dof) if free is None else free
    Q, E, counts = np.empty((count, robot.dof)), np.empty((count, len(stack.kept))), np.zeros(count, dtype=np.int64)
    Q[0] = q
    kernels.follow(
        robot.fixed, robot.prismatic, kinds, targets, reach, farthest(robot, config), iterations, config.tolerance,
        config.least_step, settings(config, stack, z), q, Q, E, counts,
    )  # fmt: skip
    return Q, E, counts


def _reports(
    stack: Stack, at: Callable[[int], Stack], Q: np.ndarray, E: np.ndarray, reach: np.ndarray, met: float
) -> tuple[TaskReport, ...]:
    reports = []
    for i, task in enumerate(stack.tasks):
        linear, angular = stack.sizes(E, i)
        unmet, reason = np.hypot(linear, angular) > met, f"The {task.name} is met everywhere."
        if unmet.any():
            worst = int(np.argmax(np.hypot(linear, angular)))
            step = np.abs(Q[worst] - Q[max(worst - 1, 0)])
            hurried = bool(np.any(step > 0.999 * reach[worst]))
            reason = f"At waypoint {worst}, the worst of {int(unmet.sum())}: {why(at(worst), Q[worst], i, hurried)}"
        reports.append(TaskReport(task.name, linear, angular, unmet, reason))
    return tuple(reports)


_METHODS: dict[str, Callable[..., ConfigurationTrajectory]] = {"task-priority": plan_by_task_priority}
