"""Constraints that keep the robot clear of what stands around it, and of itself: (4.29) corrected."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from longreach.errors import PlanningError
from longreach.planning import _clearance_kernels as kernels
from longreach.planning.obstacles import Box, Capsule, Disc, LinkCapsule, Obstacle, link_capsules
from longreach.planning.task import target_array
from longreach.planning.terms import Constraint, Directions, Jacobians, Values, Waypoints
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator

_ENDLESS = 100.0  # [m], half the length of what has no end
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Clearance(Constraint):
    """Distances [m] of some of the robot's capsules from obstacles, each at least `margin`.

    A value for each pair; points (k, 3) [m], of a laser scan say, give one a capsule: its distance from the nearest.
    """

    capsules: tuple[LinkCapsule, ...]
    obstacles: tuple[Obstacle, ...] = ()
    points: Float[np.ndarray, "k 3"] | None = None
    margin: float = 0.0
    name: str = field(default="clearance", kw_only=True)

    def __post_init__(self) -> None:
        if not (self.capsules and (self.obstacles or self.points is not None)):
            raise PlanningError(f"The constraint {self.name!r} needs capsules of the robot, and obstacles or points.")
        if not 0.0 <= self.margin < np.inf:
            raise PlanningError(f"The margin of {self.name!r} is {self.margin} m; it must be finite and not negative.")
        if self.points is not None:
            object.__setattr__(self, "points", target_array(self.points, (len(self.points), 3), self.name))
        rounded = [o for o in self.obstacles if not isinstance(o, Box)]
        object.__setattr__(self, "_capsules", np.array([_ends(o) for o in rounded]).reshape(-1, 7))
        boxes = [[*o.T[:3, :3].ravel(), *o.T[:3, 3], *(0.5 * o.size)] for o in self.obstacles if isinstance(o, Box)]
        object.__setattr__(self, "_boxes", np.array(boxes).reshape(-1, 15))

    def bounds(self, at: Waypoints) -> tuple[Values, Values]:
        m = len(self.capsules) * (len(self.obstacles) + (self.points is not None))
        return np.full((len(at), m), self.margin), np.full((len(at), m), np.inf)

    def value_and_jacobian(self, at: Waypoints) -> tuple[Values, Jacobians]:
        values, jacobians = [], []
        for link in self.capsules:
            T, J = at.robot.chain.ending(link.frame).forward_and_jacobian_batch(at.q)
            v, A = _distances(T, J, link.capsule, self._capsules, self._boxes)  # type: ignore[attr-defined]
            values.append(v)
            jacobians.append(A)
            if self.points is not None:
                ends = np.hstack([self.points, self.points, np.zeros((len(self.points), 1))])
                v, A = _distances(T, J, link.capsule, ends, np.empty((0, 15)))
                nearest = v.argmin(axis=1)[:, None]
                values.append(np.take_along_axis(v, nearest, 1))
                jacobians.append(np.take_along_axis(A, nearest[:, :, None], 1))
        return np.hstack(values), np.concatenate(jacobians, axis=1)

    def curvature(self, at: Waypoints, multipliers: Values, Z: Directions) -> Directions:
        return np.zeros_like(Z)  # distances bend away, which costs no step but wants many evaluations


def _distances(
    T: np.ndarray, J: np.ndarray, capsule: Capsule, capsules: np.ndarray, boxes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    w, n, k = len(T), J.shape[2], len(capsules) + len(boxes)
    v, A = np.empty((w, k)), np.empty((w, k, n))
    kernels.clearances(T, J, capsule.a, capsule.b, capsule.radius, capsules, boxes, v, A)
    return v, A


def _ends(obstacle: Obstacle) -> list[float]:
    if isinstance(obstacle, Disc):
        middle = np.append(obstacle.centre, 0.0)
        return [*(middle - _ENDLESS * _UP), *(middle + _ENDLESS * _UP), obstacle.radius]
    assert isinstance(obstacle, Capsule)
    return [*obstacle.a, *obstacle.b, obstacle.radius]


def base_capsule(radius: float, frame: str = "base_link") -> LinkCapsule:
    """Return the base as an endless upright disc of this radius [m]: seen from above, under a table counts as in it."""
    return LinkCapsule(frame, Capsule(-_ENDLESS * _UP, _ENDLESS * _UP, radius))


def base_clearance(radius: float, obstacles: tuple[Obstacle, ...], margin: float = 0.0) -> Clearance:
    """Return the constraint that keeps the base, a disc about its origin, clear of obstacles; (4.29)."""
    return Clearance((base_capsule(radius),), obstacles, margin=margin, name="base clearance")


def arm_clearance(robot: MobileManipulator, obstacles: tuple[Obstacle, ...], margin: float = 0.0) -> Clearance:
    """Return the constraint that keeps the arm's links, as capsules around their shapes, clear of obstacles."""
    capsules = link_capsules(robot)
    if not capsules:
        raise PlanningError(f"{robot.name} has no shapes of its arm's links; give capsules to Clearance instead.")
    return Clearance(capsules, obstacles, margin=margin, name="arm clearance")


@dataclass(frozen=True, eq=False)
class SelfClearance(Constraint):
    """Distances [m], at least `margin`, of capsules of the robot from boxes that one of its frames carries."""

    capsules: tuple[LinkCapsule, ...]
    boxes: tuple[Box, ...]
    frame: str = "base_link"
    margin: float = 0.0
    name: str = field(default="self clearance", kw_only=True)

    def __post_init__(self) -> None:
        if not (self.capsules and self.boxes):
            raise PlanningError(f"The constraint {self.name!r} needs capsules of the arm and boxes of the base.")
        rows = [[*box.T[:3, :3].ravel(), *box.T[:3, 3], *(0.5 * box.size)] for box in self.boxes]
        object.__setattr__(self, "_boxes", np.array(rows))

    def bounds(self, at: Waypoints) -> tuple[Values, Values]:
        m = len(self.capsules) * len(self.boxes)
        return np.full((len(at), m), self.margin), np.full((len(at), m), np.inf)

    def value_and_jacobian(self, at: Waypoints) -> tuple[Values, Jacobians]:
        """Measure in the carrying frame: what moves there is the capsule against the frame."""
        T_frame, J_frame = at.robot.chain.ending(self.frame).forward_and_jacobian_batch(at.q)
        R = np.swapaxes(T_frame[:, :3, :3], 1, 2)
        values, jacobians = [], []
        for link in self.capsules:
            T, J = at.robot.chain.ending(link.frame).forward_and_jacobian_batch(at.q)
            r = T[:, :3, 3] - T_frame[:, :3, 3]
            seen = np.zeros_like(T)
            seen[:, :3, :3], seen[:, 3, 3] = R @ T[:, :3, :3], 1.0
            seen[:, :3, 3] = (R @ r[:, :, None])[:, :, 0]
            moved = J - J_frame
            moved[:, :3] -= np.cross(J_frame[:, 3:], r[:, :, None], axis=1)
            moved = np.concatenate([R @ moved[:, :3], R @ moved[:, 3:]], axis=1)
            none = np.empty((0, 7))
            v, A = _distances(seen, moved, link.capsule, none, self._boxes)  # type: ignore[attr-defined]
            values.append(v)
            jacobians.append(A)
        return np.hstack(values), np.concatenate(jacobians, axis=1)

    def curvature(self, at: Waypoints, multipliers: Values, Z: Directions) -> Directions:
        return np.zeros_like(Z)  # as above


Keeping = Clearance | SelfClearance


def least_clearance(
    robot: MobileManipulator, q: Float[np.ndarray, "N n"], term: Keeping, finer: int = 20
) -> tuple[float, int]:
    """Return the least distance [m] along straight lines between configurations, and after which of them it is.

    finer: how many points are looked at between two of them.
    """
    s = np.linspace(0.0, 1.0, finer, endpoint=False)
    dense = np.concatenate([(q[:-1, None] + s[:, None] * np.diff(q, axis=0)[:, None]).reshape(-1, q.shape[1]), q[-1:]])
    at = Waypoints(robot, Reference(np.zeros(1), base=np.zeros((1, 3))), np.zeros(len(dense), dtype=int), dense)
    v = term.value_and_jacobian(at)[0].min(axis=1)
    return float(v.min()), int(v.argmin()) // finer
