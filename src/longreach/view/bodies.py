"""A robot's links as nodes of viser's scene, from the shapes in its URDF."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from longreach.geometry import so3
from longreach.robot.joint import Joint
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.robot.urdf import Shape

_PLAIN = (0.6, 0.62, 0.66, 1.0)
_PLAIN_TOP = 0.275  # of a base that nobody describes [m]
_SIDES = 48
_BLACK = 30  # of 255, so that a black robot has edges


def quaternion(R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "4"]:
    """Return w x y z of a rotation."""
    w = so3.log(R)
    angle = float(np.linalg.norm(w))
    return np.array([np.cos(0.5 * angle), *(0.5 * np.sinc(angle / (2 * np.pi)) * w)])


def rotation(w: float, x: float, y: float, z: float) -> Float[np.ndarray, "3 3"]:
    """Return the matrix of a unit quaternion."""
    v = np.array([x, y, z])
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * hat + 2 * (np.outer(v, v) - v @ v * np.eye(3))


def place(node: Any, T: Float[np.ndarray, "4 4"]) -> None:
    """Put a node at a pose in its parent."""
    node.position, node.wxyz = T[:3, 3], quaternion(T[:3, :3])


def place_plane(node: Any, pose: Float[np.ndarray, "3"], height: float = 0.0) -> None:
    """Put a node at a pose x, y, θ of the floor [m, m, rad]."""
    node.position = np.array([pose[0], pose[1], height])
    node.wxyz = np.array([np.cos(0.5 * pose[2]), 0.0, 0.0, np.sin(0.5 * pose[2])])


def _root(robot: MobileManipulator) -> str:
    return robot.urdf.root if robot.urdf is not None else "base_link"


def add_robot(scene: Any, name: str, robot: MobileManipulator) -> tuple[dict[str, Any], dict[Joint, Any]]:
    """Add the robot's links and return their nodes: by name, and those of fingers and wheels by the joint before each.

    Fingers and wheels are no frames of the chain to the tool; each node lies in that of the link that carries it.
    """
    nodes: dict[str, Any] = {"": scene.add_frame(name, show_axes=False)}
    carried: dict[Joint, Any] = {}
    if robot.urdf is None:
        nodes[_root(robot)] = scene.add_frame(f"{name}/base", show_axes=False)
        _plain_base(scene, f"{name}/base", robot)
        return nodes, carried
    paths = {link: f"{name}/{link}" for link in robot.urdf.links if link in robot.frames}
    nodes |= {link: scene.add_frame(path, show_axes=False) for link, path in paths.items()}
    for joint in robot.urdf.joints:  # each after the one that carries it
        if joint.child not in paths:
            paths[joint.child] = f"{paths[joint.parent]}/{joint.child}"
            carried[joint] = scene.add_frame(paths[joint.child], show_axes=False)
    for link in robot.urdf.links.values():
        for i, shape in enumerate(link.visuals or link.collisions):
            _add_shape(scene, f"{paths[link.name]}/{i}", shape)
    return nodes, carried


def _plain_base(scene: Any, name: str, robot: MobileManipulator) -> None:
    """Add a box with a nose where nobody says what the base looks like."""
    base = robot.description.base
    long = 2 * getattr(base, "half_length", 0.22) + 0.1
    wide = 2 * getattr(base, "half_width", 0.18) + 0.05
    scene.add_box(f"{name}/box", color=(60, 62, 66), dimensions=(long, wide, 0.25), position=(0, 0, 0.15))
    scene.add_box(
        f"{name}/nose", color=(240, 190, 30), dimensions=(0.04, 0.5 * wide, 0.06), position=(0.5 * long, 0, 0.15)
    )


def placed(nodes: dict[str, Any], robot: MobileManipulator, q: Float[np.ndarray, " n"]) -> Iterator[tuple[Any, Any]]:
    """Yield each link's node and where it is at q, T_world_link (4, 4)."""
    for name, node in nodes.items():
        if name:
            yield node, robot.frame(name, q) if name in robot.frames else np.eye(4)


def add_base_outline(
    scene: Any, name: str, robot: MobileManipulator, colour: tuple[int, int, int], margin: float = 0.01
) -> Any:
    """Add the edges of the base, a margin [m] outside of it; its node moves all of them."""
    outline = scene.add_frame(name, show_axes=False, visible=False)
    boxes = [shape for shape in _base_shapes(robot) if shape.kind == "box"]
    x, y, z = 0.5 * np.array(boxes[0].size) if boxes else np.array([0.27, 0.2, 0.12])
    middle = boxes[0].T_link_shape[:3, 3] if boxes else np.array([0.0, 0.0, 0.15])
    x, y, z = x + margin, y + margin, z + 0.5 * margin
    ring = np.array([[x, y], [-x, y], [-x, -y], [x, -y]])
    lines = []
    for height in (-z, z):
        corners = np.column_stack([ring, np.full(4, height)])
        lines += list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
    lines += [(np.array([*c, -z]), np.array([*c, z])) for c in ring]
    points = (np.array(lines) + middle).astype(np.float32)
    scene.add_line_segments(f"{name}/edges", points, colour, thickness=2.0, thickness_units="screen")
    return outline


def _base_shapes(robot: MobileManipulator) -> list[Shape]:
    if robot.urdf is None:
        return []
    link = robot.urdf.links[robot.urdf.root]
    return [shape for shape in link.visuals or link.collisions if shape.kind != "mesh"]


def top(robot: MobileManipulator) -> float:
    """Return how high the base is [m]."""
    heights = [s.T_link_shape[2, 3] + 0.5 * s.size[-1] for s in _base_shapes(robot) if s.kind in ("box", "cylinder")]
    return max(heights, default=_PLAIN_TOP)


def _add_shape(scene: Any, name: str, shape: Shape) -> None:
    if shape.kind == "mesh":
        return  # a primitive shape beside it is what collides
    colour = tuple(round(_BLACK + (255 - _BLACK) * c) for c in (shape.colour or _PLAIN)[:3])
    if shape.kind == "box":
        node = scene.add_box(name, color=colour, dimensions=shape.size)
    elif shape.kind == "sphere":
        node = scene.add_icosphere(name, color=colour, radius=shape.size[0])
    else:
        node = scene.add_mesh_simple(name, *cylinder(*shape.size), color=colour, flat_shading=True)
    place(node, shape.T_link_shape)


def cylinder(radius: float, length: float) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    """Return corners and triangles of a cylinder along z about its middle."""
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(_SIDES, 0.5 * length)])
    corners = np.concatenate([ring * [1, 1, -1], ring, [[0, 0, -0.5 * length], [0, 0, 0.5 * length]]])
    i = np.arange(_SIDES)
    j, low, high = np.roll(i, -1), np.full(_SIDES, 2 * _SIDES), np.full(_SIDES, 2 * _SIDES + 1)
    sides = [(i, j, j + _SIDES), (i, j + _SIDES, i + _SIDES), (j, i, low), (i + _SIDES, j + _SIDES, high)]
    return corners, np.concatenate([np.column_stack(side) for side in sides])


def disc() -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"]]:
    """Return corners, the middle first, and triangles of a disc of radius 1 on the floor."""
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    corners = np.concatenate([[[0, 0, 0]], np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])])
    i = np.arange(_SIDES)
    return corners, np.column_stack([0 * i, i + 1, np.roll(i, -1) + 1])
