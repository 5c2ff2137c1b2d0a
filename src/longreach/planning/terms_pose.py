"""Constraints on where the tool and the base are: the tool's pose, the base's disc, the base's heading."""

from dataclasses import dataclass, field

import numpy as np

from longreach.errors import PlanningError
from longreach.planning import _sqp_kernels as kernels
from longreach.planning.task import Task
from longreach.planning.terms import STEP, Constraint, Directions, Jacobians, Values, Waypoints

_TURNS = np.arange(8) * np.pi / 8
_DIRECTIONS = np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])
_OUTSIDE = 1.001  # radii: what only touched the disc would share its multiplier there


@dataclass(frozen=True, eq=False)
class ToolPose(Constraint):
    """The tool stands where the reference says: log(T_target⁻¹ T) = 0 (6,) [m, rad]; (4.26)-(4.28)."""

    name: str = field(default="tool pose", kw_only=True)

    def bounds(self, at: Waypoints) -> tuple[Values, Values]:
        return np.zeros((len(at), 6)), np.zeros((len(at), 6))

    def value_and_jacobian(self, at: Waypoints) -> tuple[Values, Jacobians]:
        if at.reference.tool is None:
            raise PlanningError(f"The reference has no tool poses, but the problem has a constraint {self.name!r}.")
        e, A = np.empty((len(at), 6)), np.empty((len(at), 6, at.q.shape[1]))
        kernels.tool_errors(at.reference.tool[at.index], at.T, at.J, e, A)
        return e, A

    def curvature(self, at: Waypoints, multipliers: Values, Z: Directions) -> Directions:
        assert at.reference.tool is not None
        out = np.empty(Z.shape)
        robot, target = at.robot, at.reference.tool[at.index]
        kernels.tool_curvature(robot.fixed, robot.prismatic, at.q, target, at.T, at.J, multipliers, Z, STEP, out)
        return out


def _base_target(at: Waypoints, name: str) -> np.ndarray:
    if at.reference.base is None or at.robot.base.stop == 0:
        raise PlanningError(f"The constraint {name!r} needs a robot with a base, and base poses in the reference.")
    return at.reference.base[at.index]


@dataclass(frozen=True, eq=False)
class BaseDisc(Constraint):
    """The base's origin at most `radius` [m] from where the reference wants it, exactly; (4.34).

    The first value is |p - p_goal|²/(2 radius) [m], at most radius/2: where the bound is reached it grows as fast as
    the distance does. The others are the distances along eight directions, at most a little more than radius either
    way. They add nothing, for the disc lies within their polygon; but in its middle, where the first one's gradient
    vanishes, they tell a linearised problem where the disc ends, and with it how the disc bends.
    """

    radius: float
    name: str = field(default="base disc", kw_only=True)

    def __post_init__(self) -> None:
        if not 0.0 < self.radius < np.inf:
            raise PlanningError(f"The base's radius is {self.radius} m; it must be above 0.")

    def bounds(self, at: Waypoints) -> tuple[Values, Values]:
        sides = [_OUTSIDE * self.radius] * len(_DIRECTIONS)
        lower, upper = np.array([-np.inf, *sides]), np.array([0.5 * self.radius, *sides])
        lower[1:] *= -1.0
        return np.tile(lower, (len(at), 1)), np.tile(upper, (len(at), 1))

    def value_and_jacobian(self, at: Waypoints) -> tuple[Values, Jacobians]:
        d = at.q[:, :2] - _base_target(at, self.name)[:, :2]
        J = np.zeros((len(at), 1 + len(_DIRECTIONS), at.q.shape[1]))
        J[:, 0, :2] = d / self.radius
        J[:, 1:, :2] = _DIRECTIONS
        half_square = np.sum(d**2, axis=1, keepdims=True) / (2.0 * self.radius)
        return np.hstack([half_square, d @ _DIRECTIONS.T]), J

    def curvature(self, at: Waypoints, multipliers: Values, Z: Directions) -> Directions:
        """Return it as if the disc pulled where a side of the polygon does: there it soon will."""
        pull = multipliers[:, 0] + np.abs(multipliers[:, 1:]).sum(axis=1)
        out = np.zeros_like(Z)
        out[:, :2] = (pull / self.radius)[:, None, None] * Z[:, :2]
        return out


@dataclass(frozen=True, eq=False)
class BaseHeading(Constraint):
    """The base's heading at most `band` [rad] from where the reference wants it, either way; (4.34)."""

    band: float
    name: str = field(default="base heading", kw_only=True)

    def __post_init__(self) -> None:
        if not 0.0 < self.band <= np.pi:
            raise PlanningError(f"The base's heading band is {self.band} rad; it must be above 0 and at most π.")

    def bounds(self, at: Waypoints) -> tuple[Values, Values]:
        return np.full((len(at), 1), -self.band), np.full((len(at), 1), self.band)

    def value_and_jacobian(self, at: Waypoints) -> tuple[Values, Jacobians]:
        J = np.zeros((len(at), 1, at.q.shape[1]))
        J[:, 0, 2] = 1.0
        turn = at.q[:, 2:3] - _base_target(at, self.name)[:, 2:]
        return np.remainder(turn + np.pi, 2.0 * np.pi) - np.pi, J

    def curvature(self, at: Waypoints, multipliers: Values, Z: Directions) -> Directions:
        return np.zeros_like(Z)


@dataclass(frozen=True, eq=False)
class TaskConstraint(Constraint):
    """Any task of task priority as a constraint: an equation, or between its bounds, the same at all waypoints."""

    task: Task
    name: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        object.__setattr__(self, "name", self.name or self.task.name)

    def bounds(self, at: Waypoints) -> tuple[Values, Values]:
        lower, upper = self.task.bounds(at.robot)
        return np.tile(lower, (len(at), 1)), np.tile(upper, (len(at), 1))

    def value_and_jacobian(self, at: Waypoints) -> tuple[Values, Jacobians]:
        pairs = [self.task.value_and_jacobian(at.robot, q) for q in at.q]
        return np.array([v for v, _ in pairs]), np.array([J for _, J in pairs])

    def curvature(self, at: Waypoints, multipliers: Values, Z: Directions) -> Directions:
        return np.zeros_like(Z)  # one by one their derivatives cost more than curvature gains
