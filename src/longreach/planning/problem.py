"""An optimisation problem (4.19) as a list of terms, and its values over many waypoints at once."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from longreach.errors import PlanningError
from longreach.planning.links import Link, LinkLimit, Smoothness
from longreach.planning.terms import Constraint, Cost, Directions, Jacobians, Values, Waypoints

LIMITS = "joint limits"


@dataclass(frozen=True, eq=False)
class Problem:
    """Minimise the costs while all constraints hold, within the robot's joint limits where `limits` says so.

    links couple neighbouring waypoints, and count only where whole trajectories are planned at once. Without costs it
    is the search for any configuration that meets the constraints (4.24).
    """

    costs: tuple[Cost, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    links: tuple[Link, ...] = ()
    limits: bool = True

    def __post_init__(self) -> None:
        names = [term.name for term in (*self.costs, *self.constraints, *self.links)] + [LIMITS] * self.limits
        doubled = sorted({name for name in names if names.count(name) > 1})
        if doubled:
            raise PlanningError(f"Two terms of the problem are called {doubled[0]!r}; give them names of their own.")
        if not names:
            raise PlanningError("The problem has no terms; give it at least one.")

    def adding(self, *terms: Cost | Constraint | Link) -> "Problem":
        """Return this problem with more terms."""
        return replace(
            self,
            costs=(*self.costs, *(t for t in terms if isinstance(t, Cost))),
            constraints=(*self.constraints, *(t for t in terms if isinstance(t, Constraint))),
            links=(*self.links, *(t for t in terms if isinstance(t, Link))),
        )

    @property
    def link_limits(self) -> tuple[LinkLimit, ...]:
        """The links that are limits."""
        return tuple(link for link in self.links if isinstance(link, LinkLimit))

    @property
    def smoothness(self) -> tuple[Smoothness, ...]:
        """The links that are costs."""
        return tuple(link for link in self.links if isinstance(link, Smoothness))


@dataclass(frozen=True, eq=False)
class Layout:
    """How the values of a problem's constraints lie beside each other, and between what bounds, at its waypoints.

    names: of each constraint, in order; owner (m,): whose each value is; equation (m,): whether it is one;
    lower, upper (w, m).
    """

    names: tuple[str, ...]
    owner: np.ndarray
    equation: Bool[np.ndarray, " m"]
    lower: Values
    upper: Values

    @classmethod
    def of(cls, problem: Problem, at: Waypoints) -> "Layout":
        """Return the layout; raise a PlanningError where bounds contradict each other."""
        pairs = [constraint.bounds(at) for constraint in problem.constraints]
        empty = np.empty((len(at), 0))
        lower = np.hstack([empty, *(pair[0] for pair in pairs)])
        upper = np.hstack([empty, *(pair[1] for pair in pairs)])
        owner = np.repeat(np.arange(len(pairs)), [pair[0].shape[1] for pair in pairs]).astype(int)
        names = tuple(constraint.name for constraint in problem.constraints)
        wrong = np.argwhere(~(lower <= upper))
        if len(wrong):
            w, i = wrong[0]
            raise PlanningError(
                f"The bounds of {names[owner[i]]!r} contradict each other at waypoint {at.index[w]}: "
                f"its lower bound {lower[w, i]:g} is not below its upper bound {upper[w, i]:g}."
            )
        return cls(names, owner, np.all(lower == upper, axis=0), lower, upper)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """f (w,) with gradient g (w, n), and all constraints' values c (w, m) with Jacobians A (w, m, n)."""

    f: Float[np.ndarray, " w"]
    g: Float[np.ndarray, "w n"]
    c: Values
    A: Jacobians

    def at(self, rows: Any) -> "Evaluation":
        """Return the evaluation of some waypoints."""
        return Evaluation(self.f[rows], self.g[rows], self.c[rows], self.A[rows])


def evaluate(problem: Problem, at: Waypoints) -> Evaluation:
    """Return values and first derivatives of all terms but the links.

    Raises:
        PlanningError: a term gave a number that is not finite; the sentence names it.
    """
    w, n = at.q.shape
    f, g = np.zeros(w), np.zeros((w, n))
    for cost in problem.costs:
        value, gradient = cost.value_and_gradient(at)
        _check(cost.name, value, gradient)
        f += cost.weight * value
        g += cost.weight * gradient
    values, jacobians = [np.empty((w, 0))], [np.empty((w, 0, n))]
    for constraint in problem.constraints:
        c, A = constraint.value_and_jacobian(at)
        _check(constraint.name, c, A)
        values.append(c)
        jacobians.append(A)
    return Evaluation(f, g, np.hstack(values), np.concatenate(jacobians, axis=1))


def _check(name: str, *arrays: np.ndarray) -> None:
    if not all(np.all(np.isfinite(array)) for array in arrays):
        raise PlanningError(f"The term {name!r} gave a value that is not finite; look at what it is given.")


def curvature(problem: Problem, layout: Layout, at: Waypoints, multipliers: Values, Z: Directions) -> Directions:
    """Return ∇²L Z of the Lagrangian of all terms but the links, (w, n, p)."""
    out = np.zeros(Z.shape)
    for cost in problem.costs:
        out += cost.weight * cost.curvature(at, Z)
    for i, constraint in enumerate(problem.constraints):
        lam = multipliers[:, layout.owner == i]
        if lam.any():
            out += constraint.curvature(at, lam, Z)
    return out
