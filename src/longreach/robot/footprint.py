"""The robot's outline on the floor: a rectangle around all that moves with the base, and capsules along the arm."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.robot.urdf import Shape

_UNKNOWN = (0.3, 0.25)  # half length and width of a base that nobody describes [m]; of usual indoor bases


@dataclass(frozen=True, eq=False)
class Footprint:
    """Seen from above, in base_link; what the arm covers counts from the floor up, for a laser sees no heights.

    rectangle (4,): least x, greatest x, least y, greatest y [m].
    """

    robot: MobileManipulator
    rectangle: Float[np.ndarray, "4"]
    links: tuple[tuple[str, Float[np.ndarray, "3"], Float[np.ndarray, "3"], float], ...]

    def capsules(self, arm: Float[np.ndarray, "*batch m"]) -> Float[np.ndarray, "*batch k 5"]:
        """Return the arm's capsules where its joints are at (m,), a row each: ends x, y, x, y and radius [m]."""
        batch = arm.shape[:-1]
        q = np.concatenate([np.zeros((*batch, self.robot.base.stop)), arm], axis=-1)
        rows = np.empty((*batch, len(self.links), 5))
        T, last = np.eye(4), ""
        for i, (name, a, b, radius) in enumerate(self.links):
            if name != last:
                T, last = self.robot.frame(name, q), name
            rows[..., i, :2] = (T[..., :3, :3] @ a + T[..., :3, 3])[..., :2]
            rows[..., i, 2:4] = (T[..., :3, :3] @ b + T[..., :3, 3])[..., :2]
            rows[..., i, 4] = radius
        return rows


def footprint_of(robot: MobileManipulator) -> Footprint:
    """Return a robot's footprint: its URDF's primitive collision shapes and its wheels. Meshes do not count."""
    still, shapes = np.zeros(robot.dof), {} if robot.urdf is None else robot.urdf.links
    corners: list[np.ndarray] = []
    links = []
    for name, frame in robot.chain.frames.items():
        for shape in shapes[name].collisions if name in shapes else ():
            if shape.kind == "mesh":
                continue
            a, b, radius = capsule_of(shape)
            if frame.joints > robot.base.stop:
                links.append((name, a, b, radius))
                continue
            T = robot.frame(name, still)
            corners += list((_corners(shape) @ T[:3, :3].T + T[:3, 3])[:, :2])
    base = robot.description.base
    if base is not None:
        x, y = base.half_size
        if corners and len(base.wheel_names) == 2:
            x = base.wheel_radius  # the shapes say the rest
    else:
        x, y = (0.0, 0.0) if corners else _UNKNOWN
    corners += [np.array([-x, -y]), np.array([x, y])]
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    return Footprint(robot, np.array([low[0], high[0], low[1], high[1]]), tuple(links))


def capsule_of(shape: Shape) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], float]:
    """Return the ends (3,), in the link's frame, and the radius of a capsule around a box, cylinder or sphere [m]."""
    R, p = shape.T_link_shape[:3, :3], shape.T_link_shape[:3, 3]
    along, radius = np.zeros(3), shape.size[0]
    if shape.kind == "cylinder":
        along[2] = 0.5 * shape.size[1]
    elif shape.kind == "box":
        longest = int(np.argmax(shape.size))
        along[longest] = 0.5 * shape.size[longest]
        radius = 0.5 * float(np.linalg.norm(np.delete(shape.size, longest)))
    return p - R @ along, p + R @ along, radius


def _corners(shape: Shape) -> Float[np.ndarray, "8 3"]:
    """Return the corners of a box around a shape, in the link's frame [m]."""
    half = {
        "box": 0.5 * np.array(shape.size),
        "cylinder": np.array([shape.size[0], shape.size[0], 0.5 * shape.size[-1]]),
        "sphere": np.full(3, shape.size[0]),
    }[shape.kind]
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    return (signs * half) @ shape.T_link_shape[:3, :3].T + shape.T_link_shape[:3, 3]
