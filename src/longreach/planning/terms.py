"""Terms that an optimisation problem is made of: costs and constraints of single waypoints, each with its derivative.

All waypoints are evaluated at once. A cost gives one number a waypoint, a constraint m values that shall lie between
bounds; where both bounds are the same it is an equation. Curvature is asked for along the few directions that the
equations leave free; a term that does not know it differences its analytic gradients.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from longreach.errors import PlanningError
from longreach.planning import _measure_kernels as kernels
from longreach.reference import Reference
from longreach.robot.manipulability import Part
from longreach.robot.mobile_manipulator import MobileManipulator

Values = Float[np.ndarray, "w m"]
Jacobians = Float[np.ndarray, "w m n"]
Directions = Float[np.ndarray, "w n p"]
_SIX = 6  # joints; with fewer no tool moves in all directions
STEP = 1e-6  # [rad, m] between the gradients whose difference is curvature


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

    def moved(self, step: float, Z: Directions) -> "Waypoints":
        """Return w p waypoints, each of these a step along each of its directions."""
        w, n, p = Z.shape
        q = self.q[:, None] + step * Z.transpose(0, 2, 1)
        return Waypoints(self.robot, self.reference, np.repeat(self.index, p), q.reshape(w * p, n))


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

    def curvature(self, at: Waypoints, Z: Directions) -> Directions:
        """Return ∇²f Z, without the weight."""
        here = self.value_and_gradient(at)[1]
        return _differences(here, self.value_and_gradient(at.moved(STEP, Z))[1], Z)


@dataclass(frozen=True, eq=False, kw_only=True)
class Constraint(Term):
    """Values that shall lie between bounds."""

    @abstractmethod
    def bounds(self, at: Waypoints) -> tuple[Values, Values]:
        """Return lower and upper bounds (w, m), which do not depend on q."""

    @abstractmethod
    def value_and_jacobian(self, at: Waypoints) -> tuple[Values, Jacobians]:
        """Return v (w, m) and ∂v/∂q (w, m, n)."""

    def curvature(self, at: Waypoints, multipliers: Values, Z: Directions) -> Directions:
        """Return Σ λ ∇²v Z for multipliers λ (w, m)."""
        here = np.einsum("wmj,wm->wj", self.value_and_jacobian(at)[1], multipliers)
        A = self.value_and_jacobian(at.moved(STEP, Z))[1]
        return _differences(here, np.einsum("wmj,wm->wj", A, np.repeat(multipliers, Z.shape[2], axis=0)), Z)


def _differences(here: np.ndarray, there: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Return what gradients (w p, n) at the places that Z led to differ by from those (w, n) here, as (w, n, p)."""
    w, n, p = Z.shape
    return (there.reshape(w, p, n).transpose(0, 2, 1) - here[:, :, None]) / STEP


@dataclass(frozen=True, eq=False)
class Manipulability(Cost):
    """√(κ/M) (4.33), or -log M, -M or κ: small where the tool can move well in all directions.

    part: full takes the whole Jacobian, arm the arm's own. length [m]: what makes its linear rows comparable.
    """

    objective: str = "sqrt_kappa_over_m"
    part: Part = "full"
    length: float = 1.0
    name: str = field(default="manipulability", kw_only=True)

    # By what log M and log κ count, whether that is an exponent, and the sign.
    _MEASURES: ClassVar[dict[str, tuple[float, float, bool, float]]] = {
        "sqrt_kappa_over_m": (-0.5, 0.5, True, 1.0),
        "neg_log_m": (1.0, 0.0, False, -1.0),
        "neg_m": (1.0, 0.0, True, -1.0),
        "kappa": (0.0, 1.0, True, 1.0),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.objective not in self._MEASURES:
            raise PlanningError(f"There is no objective {self.objective!r}; there are {', '.join(self._MEASURES)}.")
        if self.part not in ("full", "arm"):
            raise PlanningError(f"There is no manipulability {self.part!r}; there are full and arm.")
        if not 0.0 < self.length < np.inf:
            raise PlanningError(f"The length of {self.name!r} is {self.length} m; it must be above 0 and finite.")

    def value_and_gradient(self, at: Waypoints) -> tuple[Float[np.ndarray, " w"], Float[np.ndarray, "w n"]]:
        a, b, exponential, sign = self._MEASURES[self.objective]
        value, gradient = np.empty(len(at)), np.empty(at.q.shape)
        kernels.values(at.J, self._first(at), float(self.length), a, b, value, gradient)
        if not exponential:
            return sign * value, sign * gradient
        value = sign * np.exp(value)
        return value, value[:, None] * gradient

    def curvature(self, at: Waypoints, Z: Directions) -> Directions:
        a, b, exponential, sign = self._MEASURES[self.objective]
        out = np.empty(Z.shape)
        chain = (at.robot.fixed, at.robot.prismatic, at.q, at.J)
        kernels.curvature(*chain, Z, self._first(at), float(self.length), a, b, exponential, STEP, out)
        return sign * out

    def _first(self, at: Waypoints) -> int:
        first = at.robot.arm.start if self.part == "arm" else 0
        if at.robot.dof - first < _SIX:
            raise PlanningError(
                f"{self.name!r} needs six joints, but {at.robot.name} has {at.robot.dof - first} in its {self.part} "
                "Jacobian."
            )
        return first


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

    def curvature(self, at: Waypoints, Z: Directions) -> Directions:
        return 2.0 * self.joint_weights[:, None] * Z
