"""A task: a value of the configuration, its derivative, and where the value should be.

There is one shape for all. `value_and_jacobian` gives v(q) (m,) and ∂v/∂q (m, n); `bounds` says between what v should
lie. A task whose bounds are both 0 is an equation v = 0, v being an error such as log(T_target⁻¹ T) (4.28); one with
others is a range (set-based task), which binds only when a step would leave it. Nothing here has a sign or a gain in
it: the -λ lives in the solver.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from longreach.errors import PlanningError
from longreach.robot.mobile_manipulator import MobileManipulator

Value = Float[np.ndarray, " m"]
Jacobian = Float[np.ndarray, "m n"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Task(ABC):
    """What every task has: a name, and what the solver makes of its rows.

    gain: λ of (4.3), the part of the error that one iteration takes away [1]. weights (m,): by which each row is
    multiplied, so that within a level it counts more or less, 0 for a row that is free; all 1 where empty.
    """

    name: str
    gain: float = 1.0
    weights: tuple[float, ...] = ()

    ranged: ClassVar[bool] = False  # whether it is a range
    kind: ClassVar[int | None] = None  # of those in _stack_kernels, where it is one of them

    def __post_init__(self) -> None:
        if not 0.0 < self.gain <= 2.0:
            raise PlanningError(f"The gain of the task {self.name} is {self.gain}; it must be above 0 and at most 2.")
        if not all(0.0 <= w < np.inf for w in self.weights):
            raise PlanningError(f"The weights of the task {self.name} must be finite and not negative.")

    @abstractmethod
    def value_and_jacobian(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> tuple[Value, Jacobian]:
        """Return v(q) (m,) and ∂v/∂q (m, n)."""

    @abstractmethod
    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, " m"]:
        """Return which rows (m,) are in radians, the others being in metres."""

    def bounds(self, robot: MobileManipulator) -> tuple[Value, Value]:
        """Return between what (m,) the value should lie; 0 and 0 for an equation."""
        zero = np.zeros(len(self.angular(robot)))
        return zero, zero

    def value(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> Value:
        """Return v(q) (m,)."""
        return self.value_and_jacobian(robot, q)[0]

    def jacobian(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> Jacobian:
        """Return ∂v/∂q (m, n)."""
        return self.value_and_jacobian(robot, q)[1]

    def error(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> Value:
        """Return how far (m,) the value is from where it should be: 0 inside the bounds, free rows too."""
        v = self.value(robot, q)
        return np.where(self.weighed(robot) > 0, v - np.clip(v, *self.bounds(robot)), 0.0)

    def weighed(self, robot: MobileManipulator) -> Value:
        """Return the weight (m,) of each row."""
        m = len(self.angular(robot))
        if self.weights and len(self.weights) != m:
            raise PlanningError(f"The task {self.name} has {m} rows, but {len(self.weights)} weights.")
        return np.array(self.weights or (1.0,) * m)

    def numbers(self) -> Float[np.ndarray, "_ 4"]:
        """Return the target as the compiled tasks read it; only for those with a `kind`."""
        raise NotImplementedError


Levels = Sequence[Task | Sequence[Task]]


def levels_of(tasks: Levels) -> list[list[Task]]:
    """Return tasks in order of priority, those of one level together.

    Raises:
        PlanningError: there are none, or two have the same name.
    """
    levels = [[level] if isinstance(level, Task) else list(level) for level in tasks]
    levels = [level for level in levels if level]
    names = [task.name for level in levels for task in level]
    if not names:
        raise PlanningError("There are no tasks; give at least one.")
    doubled = {name for name in names if names.count(name) > 1}
    if doubled:
        raise PlanningError(f"Two tasks are called {min(doubled)!r}; give them names of their own.")
    return levels


def in_fours(numbers: Float[np.ndarray, " _"]) -> Float[np.ndarray, "_ 4"]:
    """Return numbers in rows of four, filled up with 0."""
    out = np.zeros((-(-len(numbers) // 4), 4))
    out.flat[: len(numbers)] = numbers
    return out


def target_array(value: np.ndarray, shape: tuple[int, ...], name: str) -> np.ndarray:
    """Return a read-only copy of a task's target, or say what is wrong with it."""
    array = np.array(value, dtype=float)
    if array.shape != shape:
        raise PlanningError(f"The target of {name} has the shape {array.shape}, expected {shape}.")
    if not np.all(np.isfinite(array)):
        raise PlanningError(f"The target of {name} must be finite numbers.")
    array.flags.writeable = False
    return array
