"""Ranges that a configuration shall keep to, and tasks that look and that keep the arm nimble."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float

from longreach.errors import PlanningError
from longreach.planning import _stack_kernels as kernels
from longreach.planning.obstacles import LinkCapsule, Obstacle, base_distance, segment_distance
from longreach.planning.task import Jacobian, Task, Value, target_array
from longreach.robot.manipulability import Measure, Part, manipulability
from longreach.robot.mobile_manipulator import MobileManipulator


@dataclass(frozen=True, eq=False)
class WithinLimits(Task):
    """q (n,) between the robot's limits; where it starts outside, it comes back."""

    name: str = field(default="joint limits", kw_only=True)
    ranged: ClassVar[bool] = True
    kind: ClassVar[int] = kernels.POSTURE

    def value_and_jacobian(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> tuple[Value, Jacobian]:
        return np.array(q, dtype=float), np.eye(robot.dof)

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, " n"]:
        return ~robot.prismatic

    def bounds(self, robot: MobileManipulator) -> tuple[Value, Value]:
        return robot.lower, robot.upper

    def numbers(self) -> Float[np.ndarray, "0 4"]:
        return np.zeros((0, 4))


@dataclass(frozen=True, eq=False)
class BaseClearance(Task):
    """Distance (k,) [m] of a disc of `radius` about the base's origin from k obstacles, at least `margin`; (4.29).

    All is seen from above: under a table counts as inside it.
    """

    obstacles: tuple[Obstacle, ...]
    radius: float
    margin: float = 0.0
    name: str = field(default="base clearance", kw_only=True)
    ranged: ClassVar[bool] = True

    def value_and_jacobian(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> tuple[Value, Jacobian]:
        v, J = np.empty(len(self.obstacles)), np.zeros((len(self.obstacles), robot.dof))
        for i, obstacle in enumerate(self.obstacles):
            distance, J[i, :2] = base_distance(np.asarray(q[:2], dtype=float), obstacle)
            v[i] = distance - self.radius
        return v, J

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, " k"]:
        return np.zeros(len(self.obstacles), dtype=bool)

    def bounds(self, robot: MobileManipulator) -> tuple[Value, Value]:
        k = len(self.obstacles)
        return np.full(k, self.margin), np.full(k, np.inf)


@dataclass(frozen=True, eq=False)
class ArmClearance(Task):
    """Distance (c · k,) [m] of each of c capsules of the arm from each of k obstacles, at least `margin`; (4.29)."""

    obstacles: tuple[Obstacle, ...]
    capsules: tuple[LinkCapsule, ...]
    margin: float = 0.0
    name: str = field(default="arm clearance", kw_only=True)
    ranged: ClassVar[bool] = True

    def value_and_jacobian(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> tuple[Value, Jacobian]:
        v, rows = [], []
        for link in self.capsules:
            T, J = robot.frame_and_jacobian(link.frame, q)
            R, p = T[:3, :3], T[:3, 3]
            for obstacle in self.obstacles:
                distance, near, normal = segment_distance(R @ link.capsule.a + p, R @ link.capsule.b + p, obstacle)
                v.append(distance - link.capsule.radius)
                rows.append(normal @ J[:3] + np.cross(near - p, normal) @ J[3:])
        return np.array(v), np.array(rows).reshape(-1, robot.dof)

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, " k"]:
        return np.zeros(len(self.obstacles) * len(self.capsules), dtype=bool)

    def bounds(self, robot: MobileManipulator) -> tuple[Value, Value]:
        k = len(self.obstacles) * len(self.capsules)
        return np.full(k, self.margin), np.full(k, np.inf)


def _direction(
    robot: MobileManipulator, frame: str | None, point: np.ndarray, q: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the point as the frame sees it (3,) [m], and its derivative (3, n)."""
    T, J = robot.forward_and_jacobian(q) if frame is None else robot.frame_and_jacobian(frame, q)
    r = point - T[:3, 3]
    moved = np.cross(r, J[3:], axis=0) - J[:3]  # r × ω - v
    return T[:3, :3].T @ r, T[:3, :3].T @ moved


@dataclass(frozen=True, eq=False)
class LookAt(Task):
    """The z axis of a frame (the tool's where none is named) points at `target` (3,) [m]: e (2,) [rad].

    e is the rotation about the frame's x and y that would turn z onto the target, its sign turned.
    """

    target: Float[np.ndarray, "3"]
    frame: str | None = None
    name: str = field(default="look at", kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "target", target_array(self.target, (3,), self.name))

    def value_and_jacobian(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> tuple[Value, Jacobian]:
        d, D = _direction(robot, self.frame, self.target, q)
        across, square = float(np.hypot(d[0], d[1])), float(d @ d)
        if square < 1e-18:
            raise PlanningError(f"The target of {self.name} is where the frame itself is; it has no direction.")
        angle = float(np.arctan2(across, d[2]))
        side = np.array([d[1], -d[0]])
        rows = np.array([D[1], -D[0]])
        if across < 1e-9 * abs(d[2]):
            return side / d[2], rows / d[2]
        toward = (d[0] * D[0] + d[1] * D[1]) / across
        turned = (d[2] * toward - across * D[2]) / square  # of the angle
        return angle / across * side, angle / across * rows + np.outer(
            side, turned / across - angle / across**2 * toward
        )

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, "2"]:
        return np.ones(2, dtype=bool)


@dataclass(frozen=True, eq=False)
class FieldOfView(Task):
    """The angle (1,) [rad] between a frame's z axis and `target` (3,) [m], at most `half_angle`."""

    target: Float[np.ndarray, "3"]
    half_angle: float
    frame: str | None = None
    name: str = field(default="field of view", kw_only=True)
    ranged: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "target", target_array(self.target, (3,), self.name))
        if not 0.0 < self.half_angle < np.pi:
            raise PlanningError(f"Half an angle of view is between 0 and π, not {self.half_angle}.")

    def value_and_jacobian(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> tuple[Value, Jacobian]:
        d, D = _direction(robot, self.frame, self.target, q)
        across, square = float(np.hypot(d[0], d[1])), float(d @ d)
        angle = np.array([np.arctan2(across, d[2])])
        if across < 1e-12:
            return angle, np.zeros((1, robot.dof))
        toward = (d[0] * D[0] + d[1] * D[1]) / across
        return angle, ((d[2] * toward - across * D[2]) / square)[None]

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, "1"]:
        return np.ones(1, dtype=bool)

    def bounds(self, robot: MobileManipulator) -> tuple[Value, Value]:
        return np.array([-np.inf]), np.array([self.half_angle])


@dataclass(frozen=True, eq=False)
class Manipulability(Task):
    """Ascend a measure of manipulability until it is `least`: e (1,) = measure - least where below it, else 0.

    With log M, the default, and a `least` of 0 that is as good as always.
    """

    least: float = 0.0
    measure: Measure = "log_m"
    part: Part = "full"
    name: str = field(default="manipulability", kw_only=True)

    def value_and_jacobian(self, robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> tuple[Value, Jacobian]:
        value, gradient = manipulability(robot, np.asarray(q, dtype=float), self.measure, self.part)
        if value >= self.least:
            return np.zeros(1), np.zeros((1, robot.dof))
        return np.array([float(value) - self.least]), gradient[None]

    def angular(self, robot: MobileManipulator) -> Bool[np.ndarray, "1"]:
        return np.zeros(1, dtype=bool)
