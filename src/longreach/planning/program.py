"""A problem bound to a robot and a reference: B problems of N waypoints each, with their merit functions."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from longreach.errors import PlanningError
from longreach.planning.links import LinkLimit, Smoothness
from longreach.planning.problem import Evaluation, Layout, Problem, curvature, evaluate
from longreach.planning.subproblem import Difference
from longreach.planning.terms import Waypoints
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator

Trajectories = Float[np.ndarray, "B N n"]


@dataclass(frozen=True, eq=False)
class Program:
    """What the solver sees of a problem. index (B, N): which waypoint of the reference each configuration is for.

    feasibility: the problem without its costs. lower, upper (n,): the joints' limits; costs and limits: the links,
    where N > 1.
    """

    robot: MobileManipulator
    reference: Reference
    problem: Problem
    index: Int[np.ndarray, "B N"]
    layout: Layout
    feasibility: Problem
    lower: Float[np.ndarray, " n"]
    upper: Float[np.ndarray, " n"]
    costs: tuple[Difference, ...]
    limits: tuple[Difference, ...]

    @classmethod
    def of(
        cls, problem: Problem, robot: MobileManipulator, reference: Reference, index: Int[np.ndarray, "B N"]
    ) -> "Program":
        """Return the program; links count only where one problem holds all waypoints."""
        at = Waypoints(robot, reference, index.ravel(), np.zeros((index.size, robot.dof)))
        lower, upper = np.full(robot.dof, -np.inf), np.full(robot.dof, np.inf)
        if problem.limits:
            lower, upper = robot.lower, robot.upper
        links = problem.links if index.shape == (1, len(reference)) and len(reference) > 1 else ()
        costs, limits = [], []
        for link in links:
            coefficients = link.coefficients(reference)
            if isinstance(link, Smoothness):
                none = np.empty((0, robot.dof))
                costs.append(Difference(coefficients, none, none, 2.0 * link.weight))
            elif isinstance(link, LinkLimit):
                bound = link.limits(robot, reference)
                if not np.all(bound > 0):
                    raise PlanningError(f"The limits of {link.name!r} must be above 0.")
                limits.append(Difference(coefficients, -bound, bound))
        layout = Layout.of(problem, at)
        feasibility = replace(problem, costs=(), links=(), limits=True)
        return cls(robot, reference, problem, index, layout, feasibility, lower, upper, tuple(costs), tuple(limits))

    def evaluate(self, x: Trajectories, which: Int[np.ndarray, " B"]) -> Evaluation:
        """Return the terms' values at trajectories x of the problems `which`; rows (B · N)."""
        q = x.reshape(-1, x.shape[-1])
        return evaluate(self.problem, Waypoints(self.robot, self.reference, self.index[which].ravel(), q))

    def values(self, x: Trajectories, which: Int[np.ndarray, " B"]) -> Float[np.ndarray, "B N m"]:
        """Return the constraints' values alone."""
        at = Waypoints(self.robot, self.reference, self.index[which].ravel(), x.reshape(-1, x.shape[-1]))
        return evaluate(self.feasibility, at).c.reshape(*x.shape[:2], -1)

    def curvature(
        self, x: Trajectories, which: Int[np.ndarray, " B"], multipliers: Float[np.ndarray, "B N m"], Z: np.ndarray
    ) -> Float[np.ndarray, "B N n p"]:
        """Return the Lagrangian's curvature along the directions Z (B, N, n, p)."""
        B, N, n, p = Z.shape
        at = Waypoints(self.robot, self.reference, self.index[which].ravel(), x.reshape(-1, n))
        lam = multipliers.reshape(B * N, -1)
        return curvature(self.problem, self.layout, at, lam, Z.reshape(-1, n, p)).reshape(Z.shape)

    def bounds(
        self, which: Int[np.ndarray, " B"], N: int
    ) -> tuple[Float[np.ndarray, "B N m"], Float[np.ndarray, "B N m"]]:
        """Return the lower and upper bounds of the constraints' values."""
        shape = (len(self.index), N, self.layout.lower.shape[1])
        return self.layout.lower.reshape(shape)[which], self.layout.upper.reshape(shape)[which]

    def objective(self, x: Trajectories, f: Float[np.ndarray, "B N"]) -> Float[np.ndarray, " B"]:
        """Return each problem's cost (B,)."""
        smooth = sum(cost.energy(x[0]) for cost in self.costs)
        return f.sum(axis=1) + smooth

    def violations(
        self, x: Trajectories, c: Float[np.ndarray, "B N m"], which: Int[np.ndarray, " B"]
    ) -> tuple[Float[np.ndarray, "B N m"], list[Float[np.ndarray, "k n"]]]:
        """Return how far the constraints' values c and the links are outside their bounds."""
        lower, upper = self.bounds(which, c.shape[1])
        links = [outside(limit.of(x[0]), limit.lower, limit.upper) for limit in self.limits]
        return outside(c, lower, upper), links


def outside(v: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Return by how much values are outside their bounds."""
    return np.maximum(np.maximum(lower - v, v - upper), 0.0)
