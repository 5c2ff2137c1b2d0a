"""Terms that an optimisation problem is made of: costs and constraints of single waypoints, each with its derivative.

All waypoints are evaluated at once. A cost gives one number a waypoint, a constraint m values that shall lie between
bounds; where both bounds are the same it is an equation. Curvature is not a term's own: `sqp` differences analytic
gradients along the few directions that the equations leave free.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from longreach.errors import PlanningError
from longreach.reference import Reference
from longreach.robot.manipulability import Measure, Part, manipulability
from longreach.robot.mobile_manipulator import MobileManipulator

Values = Float[np.ndarray, "w m"]
Jacobians = Float[np.ndarray, "w m n"]


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Configurations q (w, n) under trial, and for which waypoint of the reference each is: index (w,).

    T (w, 4, 4) and J (w, 6, n) are the tool's poses and Jacobians there.
    """

    robot: MobileManipulator
    reference: Reference
    index: Int[np.ndarray, " w"]
    q: Float[np.ndarray, "w n"]
    T: Float[np.ndarray, "w 4 4"] = field(init=False)
    J: Float[np.ndarray, "w 6 n"] = field(init=False)

    def __post_init__(self) -> None:
        T, J = self.robot.forward_and_jacobian_batch(self.q)
        object.__setattr__(self, "T", T)
        object.__setattr__(self, "J", J)

    def __len__(self) -> int:
        return len(self.q)


@dataclass(frozen=True, eq=False, kw_only=True)
class Term(ABC):
    """What every term has: a name of its own in the problem."""

    name: str


@dataclass(frozen=True, eq=False, kw_only=True)
class Cost(Term):
    """A number a waypoint that shall be small, times `weight`."""

    weight: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.weight < np.inf:
            raise PlanningError(f"The weight of {self.name} is {self.weight}; it must be finite and not below zero.")

    @abstractmethod
    def value_and_gradient(self, at: Waypoints) -> tuple[Float[np.ndarray, " w"], Float[np.ndarray, "w n"]]:
        """Return f (w,) and ∂f/∂q (w, n), without the weight."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Constraint(Term):
    """Values that shall lie between bounds."""

    @abstractmethod
    def bounds(self, at: Waypoints) -> tuple[Values, Values]:
        """Return lower and upper bounds (w, m), which do not depend on q."""

    @abstractmethod
    def value_and_jacobian(self, at: Waypoints) -> tuple[Values, Jacobians]:
        """Return v (w, m) and ∂v/∂q (w, m, n)."""

    def bending(self, multipliers: Values) -> Values:
        """Return by what to multiply each value's second derivative, so that it is worth having; (w, m)."""
        return multipliers


@dataclass(frozen=True, eq=False)
class Manipulability(Cost):
    """√(κ/M) (4.33), or -log M, -M or κ: small where the tool can move well in all directions.

    part: full takes the whole Jacobian, arm the arm's own. length [m]: what makes its linear rows comparable.
    """

    objective: str = "sqrt_kappa_over_m"
    part: Part = "full"
    length: float = 1.0
    name: str = field(default="manipulability", kw_only=True)

    _MEASURES: ClassVar[dict[str, tuple[Measure, float]]] = {
        "sqrt_kappa_over_m": ("sqrt_kappa_over_m", 1.0),
        "neg_log_m": ("log_m", -1.0),
        "neg_m": ("m", -1.0),
        "kappa": ("kappa", 1.0),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.objective not in self._MEASURES:
            raise PlanningError(f"There is no objective {self.objective!r}; there are {', '.join(self._MEASURES)}.")
        if self.part not in ("full", "arm"):
            raise PlanningError(f"There is no manipulability {self.part!r}; there are full and arm.")

    def value_and_gradient(self, at: Waypoints) -> tuple[Float[np.ndarray, " w"], Float[np.ndarray, "w n"]]:
        measure, sign = self._MEASURES[self.objective]
        value, gradient = manipulability(at.robot, at.q, measure, self.part, self.length)
        return sign * value, sign * gradient


@dataclass(frozen=True, eq=False)
class NearSeed(Cost):
    """(q - q_seed)ᵀ W (q - q_seed) (4.25); q_seed: one for all waypoints (1, n), or one for each of them."""

    seed: Float[np.ndarray, "k n"]
    joint_weights: Float[np.ndarray, " n"]
    name: str = field(default="near seed", kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.all(np.isfinite(self.seed)):
            raise PlanningError(f"The seed of {self.name} must be finite numbers.")
        if not np.all((self.joint_weights >= 0) & np.isfinite(self.joint_weights)):
            raise PlanningError(f"The joint weights of {self.name} must be finite and not below zero.")

    def value_and_gradient(self, at: Waypoints) -> tuple[Float[np.ndarray, " w"], Float[np.ndarray, "w n"]]:
        d = at.q - (self.seed if len(self.seed) == 1 else self.seed[at.index])
        return np.sum(self.joint_weights * d**2, axis=1), 2.0 * self.joint_weights * d
