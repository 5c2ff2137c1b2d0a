"""A robot's links as nodes of viser's scene, from the shapes in its URDF."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from longreach.geometry import so3
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.robot.urdf import Shape

_PLAIN = (0.6, 0.62, 0.66, 1.0)
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


def add_robot(
    scene: Any, name: str, robot: MobileManipulator, colour: tuple[int, int, int] | None = None, opacity: float = 1.0
) -> dict[str, Any]:
    """Add the robot's links, all in one colour or each in its own, and return their nodes by name."""
    nodes: dict[str, Any] = {}
    whole = scene.add_frame(name, show_axes=False)
    nodes[""] = whole
    if robot.urdf is None:
        nodes[_root(robot)] = scene.add_frame(f"{name}/base", show_axes=False)
        return nodes | _plain_base(scene, f"{name}/base", robot, colour or (60, 62, 66), opacity)
    for link in robot.urdf.links.values():
        if link.name in robot.frames and (link.visuals or link.collisions):
            nodes[link.name] = scene.add_frame(f"{name}/{link.name}", show_axes=False)
            for i, shape in enumerate(link.visuals or link.collisions):
                _add_shape(scene, f"{name}/{link.name}/{i}", shape, colour, opacity)
    return nodes


def _plain_base(scene: Any, name: str, robot: MobileManipulator, colour: tuple[int, int, int], opacity: float) -> dict:
    """Add a box with a nose where nobody says what the base looks like."""
    base = robot.description.base
    long = 2 * getattr(base, "half_length", 0.22) + 0.1
    wide = 2 * getattr(base, "half_width", 0.18) + 0.05
    scene.add_box(
        f"{name}/box", color=colour, dimensions=(long, wide, 0.25), position=(0, 0, 0.15), opacity=_opaque(opacity)
    )
    scene.add_box(
        f"{name}/nose", color=(240, 190, 30), dimensions=(0.04, 0.5 * wide, 0.06), position=(0.5 * long, 0, 0.15)
    )
    return {}


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


def _opaque(opacity: float) -> float | None:
    return None if opacity >= 1.0 else opacity


def _add_shape(scene: Any, name: str, shape: Shape, colour: tuple[int, int, int] | None, opacity: float) -> None:
    if shape.kind == "mesh":
        return  # a primitive shape beside it is what collides
    if colour is None:
        colour = tuple(round(_BLACK + (255 - _BLACK) * c) for c in (shape.colour or _PLAIN)[:3])  # type: ignore[assignment]
    solid = opacity >= 1.0
    look = {"color": colour, "opacity": _opaque(opacity), "cast_shadow": solid, "receive_shadow": solid}
    if shape.kind == "box":
        node = scene.add_box(name, dimensions=shape.size, **look)
    elif shape.kind == "sphere":
        node = scene.add_icosphere(name, radius=shape.size[0], **look)
    else:
        node = scene.add_mesh_simple(name, *cylinder(*shape.size), flat_shading=True, **look)
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
