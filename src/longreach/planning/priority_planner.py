"""Plans by task priority: waypoint by waypoint, each task as far as those above it leave it free."""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial

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


def plan_by_task_priority(
    robot: MobileManipulator,
    reference: Reference,
    q0: Float[np.ndarray, " _"],
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
    if above or below:
        stack = Stack.of(robot, _levels(reference, 0, above, below), config.limits)
    else:
        stack = _usual(robot, reference.tool is not None, reference.base is not None, config.limits)
    if stack.compiled and free is None:
        Q, sizes, _ = _compiled(stack, reference, reach, q, iterations, config)
    else:
        config = config.model_copy(update={"iterations": iterations})
        waypoints = [_levels(reference, k, above, below) for k in range(len(reference))]
        Q, sizes, _ = follow(robot, waypoints, reach, q, config, free)

    def why_at(k: int, task: int) -> str:
        hurried = bool(np.any(np.abs(Q[k] - Q[max(k - 1, 0)]) > 0.999 * reach[k]))
        return why(Stack.of(robot, _levels(reference, k, above, below), config.limits), Q[k], task, hurried)

    reports = tuple(
        _report(task.name, sizes[:, i], config.met, partial(why_at, task=i)) for i, task in enumerate(stack.tasks)
    )
    return ConfigurationTrajectory(reference.stamps, Q, robot.joint_names, reports=reports)


@lru_cache(maxsize=64)
def _usual(robot: MobileManipulator, tool: bool, base: bool, limits: bool) -> Stack:
    """Return the rows of tool and base, which are the same at all waypoints but for their targets."""
    tasks: list[Task] = []
    if tool:
        tasks.append(ToolPose(np.eye(4), name="tool"))
    if base:
        tasks.append(BasePose(np.zeros(3), name="base"))
    return Stack.of(robot, tasks, limits)


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
    config: TaskPriorityConfig,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Return configurations, sizes of errors and iterations at all waypoints, by one call of a kernel."""
    robot, count = stack.robot, len(reference)
    targets = np.zeros((count, len(stack.tasks), max(4, -(-robot.dof // 4)), 4))
    for i, task in enumerate(stack.tasks):
        if task.name == "tool" and isinstance(task, ToolPose) and reference.tool is not None:
            targets[:, i, :4] = reference.tool
        elif task.name == "base" and isinstance(task, BasePose) and reference.base is not None:
            targets[:, i, 0, :3] = reference.base
        else:
            numbers = task.numbers()
            targets[:, i, : len(numbers)] = numbers
    kinds = np.array([task.kind for task in stack.tasks])
    problem = settings(config, stack, np.zeros(robot.dof))
    Q, counts = np.empty((count, robot.dof)), np.zeros(count, dtype=np.int64)
    sizes = np.empty((2, len(stack.tasks), count))
    Q[0] = q
    kernels.follow(
        robot.fixed, robot.prismatic, kinds, targets, stack.owner, stack.angular, reach, farthest(robot, config),
        iterations, config.tolerance, config.least_step, problem, q, Q, sizes, counts,
    )  # fmt: skip
    return Q, sizes, counts


def _report(name: str, sizes: np.ndarray, met: float, why_at: Callable[[int], str]) -> TaskReport:
    linear, angular = sizes
    size = np.hypot(linear, angular)
    worst = int(np.argmax(size))
    if size[worst] <= met:
        return TaskReport(name, linear, angular, np.zeros(len(size), dtype=bool), f"Met everywhere: {name}.")
    unmet = size > met
    reason = f"At waypoint {worst}, the worst of {int(unmet.sum())}: {why_at(worst)}"
    return TaskReport(name, linear, angular, unmet, reason)
