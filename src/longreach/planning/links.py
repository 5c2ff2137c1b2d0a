"""What couples the waypoints of a trajectory: costs and limits of differences between neighbours.

A link of order 1 sees q_{k+1} - q_k, one of order 2 q_{k+2} - 2 q_{k+1} + q_k, or both divided by time: row k is
Σ_i coefficients[k, i] q_{k+i}, linear in the whole trajectory.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from longreach.errors import PlanningError
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator

Coefficients = Float[np.ndarray, "k width"]


@dataclass(frozen=True, eq=False, kw_only=True)
class Link(ABC):
    """A difference between neighbours, by `name`."""

    name: str

    @abstractmethod
    def coefficients(self, reference: Reference) -> Coefficients:
        """Return by what each row multiplies its waypoints (k, order + 1)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LinkLimit(Link):
    """A difference that stays within limits, the same in both directions."""

    @abstractmethod
    def limits(self, robot: MobileManipulator, reference: Reference) -> Float[np.ndarray, "k n"]:
        """Return the limits (k, n) of each row."""


@dataclass(frozen=True, eq=False)
class Smoothness(Link):
    """weight · Σ |difference|², over steps (order 1) or over changes of step (order 2).

    relative: a plan takes the weight in parts of its start's mean squared step: a trajectory is then as smooth whether
    its waypoints are few or many.
    """

    weight: float = 1.0
    order: int = 1
    relative: bool = False
    name: str = field(default="smoothness", kw_only=True)

    def __post_init__(self) -> None:
        if not 0.0 <= self.weight < np.inf:
            raise PlanningError(f"The weight of {self.name} is {self.weight}; it must be finite and not below zero.")
        if self.order not in (1, 2):
            raise PlanningError(f"The order of {self.name} is {self.order}; it is 1 or 2.")

    def coefficients(self, reference: Reference) -> Coefficients:
        row = [-1.0, 1.0] if self.order == 1 else [1.0, -2.0, 1.0]
        return np.tile(row, (max(len(reference) - self.order, 0), 1))


@dataclass(frozen=True, eq=False)
class StepLimit(LinkLimit):
    """No joint goes farther than `step` [rad or m] from one waypoint to the next.

    room: a plan allows at least so many times the largest step of its start, whose waypoints may lie far apart.
    """

    step: float
    room: float = 0.0
    name: str = field(default="step", kw_only=True)

    def __post_init__(self) -> None:
        if not self.step > 0.0:
            raise PlanningError(f"The largest step is {self.step}; it must be above 0.")

    def coefficients(self, reference: Reference) -> Coefficients:
        return np.tile([-1.0, 1.0], (len(reference) - 1, 1))

    def limits(self, robot: MobileManipulator, reference: Reference) -> Float[np.ndarray, "k n"]:
        return np.full((len(reference) - 1, robot.dof), self.step)


@dataclass(frozen=True, eq=False)
class VelocityLimit(LinkLimit):
    """Between waypoints no joint is faster than the robot's limits, times `part`; by the reference's stamps."""

    part: float = 1.0
    name: str = field(default="joint velocity", kw_only=True)

    def coefficients(self, reference: Reference) -> Coefficients:
        dt = np.diff(reference.stamps)[:, None]
        return np.array([-1.0, 1.0]) / dt

    def limits(self, robot: MobileManipulator, reference: Reference) -> Float[np.ndarray, "k n"]:
        return np.tile(self.part * robot.limits.velocity, (len(reference) - 1, 1))


@dataclass(frozen=True, eq=False)
class AccelerationLimit(LinkLimit):
    """At waypoints no joint's velocity changes faster than the robot's limits, times `part`."""

    part: float = 1.0
    name: str = field(default="joint acceleration", kw_only=True)

    def coefficients(self, reference: Reference) -> Coefficients:
        dt = np.diff(reference.stamps)
        a, b = dt[:-1], dt[1:]
        return np.column_stack([1.0 / a, -1.0 / a - 1.0 / b, 1.0 / b]) / (0.5 * (a + b))[:, None]

    def limits(self, robot: MobileManipulator, reference: Reference) -> Float[np.ndarray, "k n"]:
        return np.tile(self.part * robot.limits.acceleration, (max(len(reference) - 2, 0), 1))
