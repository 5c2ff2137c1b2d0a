"""Tasks of all levels for one robot, their rows one after the other as the kernels take them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from longreach.planning._follow_kernels import gauge
from longreach.planning.task import Levels, Task, levels_of
from longreach.planning.tasks_range import WithinLimits
from longreach.robot.mobile_manipulator import MobileManipulator


@dataclass(frozen=True, eq=False)
class Stack:
    """Rows of tasks without those that are free, times their weights.

    owner (M,): which task each row belongs to; kept (M,): which of all rows it is; starts (levels + 1,): where each
    level begins; gains, weights, lower, upper (M,) and whether a row is in radians and whether it is of a range.
    """

    robot: MobileManipulator
    tasks: tuple[Task, ...]
    starts: Int[np.ndarray, " _"]
    owner: Int[np.ndarray, " M"]
    kept: Int[np.ndarray, " M"]
    gains: Float[np.ndarray, " M"]
    weights: Float[np.ndarray, " M"]
    lower: Float[np.ndarray, " M"]
    upper: Float[np.ndarray, " M"]
    angular: Bool[np.ndarray, " M"]
    ranged: Bool[np.ndarray, " M"]

    @classmethod
    def of(cls, robot: MobileManipulator, tasks: Levels, limits: bool = True) -> "Stack":
        """Return the rows of tasks in order of priority, the joints' limits first where `limits`.

        Raises:
            PlanningError: there are no tasks, two have one name, or one does not fit the robot.
        """
        levels = levels_of(tasks)
        if limits and not any(isinstance(task, WithinLimits) for level in levels for task in level):
            levels = [[WithinLimits()], *levels]
        flat = tuple(task for level in levels for task in level)
        weights = [task.weighed(robot) for task in flat]
        w = np.concatenate(weights)
        kept = np.flatnonzero(w > 0)
        sizes = [len(part) for part in weights]
        owner = np.repeat(np.arange(len(flat)), sizes)[kept]
        level_of = np.repeat(np.arange(len(levels)), [len(level) for level in levels])[owner]
        bounds = [task.bounds(robot) for task in flat]
        w = w[kept]
        return cls(
            robot,
            flat,
            np.searchsorted(level_of, np.arange(len(levels) + 1)),
            owner,
            kept,
            np.array([task.gain for task in flat])[owner],
            w,
            w * np.concatenate([lower for lower, _ in bounds])[kept],
            w * np.concatenate([upper for _, upper in bounds])[kept],
            np.concatenate([task.angular(robot) for task in flat])[kept],
            np.array([task.ranged for task in flat])[owner],
        )

    @cached_property
    def compiled(self) -> bool:
        """Whether the kernels know all of its tasks."""
        plain = all(task.kind is not None and getattr(task, "frame", None) is None for task in self.tasks)
        return plain and bool(np.all(self.weights == 1.0)) and len(self.kept) == int(self.kept[-1]) + 1

    def rows(self, q: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, "M n"]]:
        """Return the values (M,) and their Jacobian (M, n) at q."""
        parts = [task.value_and_jacobian(self.robot, q) for task in self.tasks]
        e = np.concatenate([e for e, _ in parts])[self.kept]
        A = np.concatenate([A for _, A in parts])[self.kept]
        return self.weights * e, self.weights[:, None] * A

    def sizes(self, e: Float[np.ndarray, " M"]) -> Float[np.ndarray, "2 tasks"]:
        """Return the length [m] and the angle [rad] of each task's errors, without weights."""
        out = np.empty((2, len(self.tasks)))
        w = self.weights
        gauge(e / w, self.ranged, self.lower / w, self.upper / w, self.owner, self.angular, out)
        return out
