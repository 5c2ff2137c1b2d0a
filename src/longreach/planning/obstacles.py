"""What stands in the way: discs on the floor, boxes and capsules, and how far a segment is from them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.errors import PlanningError
from longreach.planning import _distance_kernels as kernels
from longreach.planning.task import target_array
from longreach.reference import check_rigid
from longreach.robot.footprint import capsule_of
from longreach.robot.mobile_manipulator import MobileManipulator

_ENDLESS = 100.0  # [m], half the length of what has no end
_UP = np.array([0.0, 0.0, 1.0])
Point = Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class Disc:
    """A round post without end, as a laser sees it: centre (2,) [m] in the world, radius [m]."""

    centre: Float[np.ndarray, "2"]
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", target_array(self.centre, (2,), "a disc"))
        _check_radius(self.radius)


@dataclass(frozen=True, eq=False)
class Box:
    """A box of `size` (3,) [m], its middle at T_world_box (4, 4)."""

    T: Float[np.ndarray, "4 4"]
    size: Float[np.ndarray, "3"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "T", target_array(self.T, (4, 4), "a box"))
        object.__setattr__(self, "size", target_array(self.size, (3,), "a box"))
        check_rigid(self.T[None], "The box's pose")
        if not np.all(self.size > 0):
            raise PlanningError("The size of a box must be three positive numbers.")


@dataclass(frozen=True, eq=False)
class Capsule:
    """All within `radius` [m] of the segment from a (3,) to b (3,) [m]; a ball where they are the same."""

    a: Point
    b: Point
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "a", target_array(self.a, (3,), "a capsule"))
        object.__setattr__(self, "b", target_array(self.b, (3,), "a capsule"))
        _check_radius(self.radius)


Obstacle = Disc | Box | Capsule


@dataclass(frozen=True, eq=False)
class LinkCapsule:
    """A capsule that a frame of the robot carries, in that frame's coordinates."""

    frame: str
    capsule: Capsule


def _check_radius(radius: float) -> None:
    if not 0.0 <= radius < np.inf:
        raise PlanningError(f"A radius of {radius} m cannot be; it must be finite and not negative.")


def segment_distance(a: Point, b: Point, obstacle: Obstacle) -> tuple[float, Point, Point]:
    """Return the signed distance [m] of the segment ab, its nearest point, and the unit vector away from the obstacle.

    A point x of the segment there, moved by dx, changes the distance by that vector times dx.
    """
    out = np.empty((3, 3))
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    if isinstance(obstacle, Box):
        R, p, half = np.ascontiguousarray(obstacle.T[:3, :3]), obstacle.T[:3, 3], 0.5 * obstacle.size
        distance = kernels.segment_box(R.T @ (a - p), R.T @ (b - p), half, out)
        return float(distance), R @ out[0] + p, R @ out[2]
    if isinstance(obstacle, Capsule):
        distance = kernels.segment_segment(a, b, obstacle.a.copy(), obstacle.b.copy(), out)
    else:
        middle = np.append(obstacle.centre, 0.5 * (a[2] + b[2]))
        distance = kernels.segment_segment(a, b, middle - _ENDLESS * _UP, middle + _ENDLESS * _UP, out)
    return float(distance) - obstacle.radius, out[0].copy(), out[2].copy()


def base_distance(x_y: Float[np.ndarray, "2"], obstacle: Obstacle) -> tuple[float, Float[np.ndarray, "2"]]:
    """Return the signed distance [m] of a point on the floor from an obstacle, seen from above, and its gradient."""
    if isinstance(obstacle, Box) and abs(obstacle.T[2, 2]) > 1.0 - 1e-9:  # so that the way out is level
        obstacle = Box(obstacle.T, np.array([obstacle.size[0], obstacle.size[1], 4.0 * _ENDLESS]))
    point = np.append(x_y, 0.0)
    distance, _, normal = segment_distance(point - _ENDLESS * _UP, point + _ENDLESS * _UP, obstacle)
    return distance, normal[:2]


def link_capsules(robot: MobileManipulator) -> tuple[LinkCapsule, ...]:
    """Return capsules around the collision shapes of the links that the arm moves, from the robot's URDF.

    A mesh, whose shape nobody here reads, has none.
    """
    if robot.urdf is None:
        return ()
    first = robot.base.stop
    moved = [name for name, frame in robot.chain.frames.items() if frame.joints > first and name in robot.urdf.links]
    return tuple(
        LinkCapsule(name, Capsule(*capsule_of(shape)))
        for name in moved
        for shape in robot.urdf.links[name].collisions
        if shape.kind != "mesh"
    )
