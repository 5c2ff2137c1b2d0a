"""Pictures of a robot by matplotlib alone, where there is no graphics library: its shapes, painted from far to near."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.robot.urdf import Shape
from longreach.sim.pictures import Trail
from longreach.sim.worlds import World

# The view of the camera "overview": where it stands from the robot's base, its right and its up, and its field of view.
PLACE, RIGHT, UP, VIEW = np.array([-3.5, -3.0, 3.0]), np.array([0.65, -0.76, 0.0]), np.array([0.42, 0.36, 0.83]), 45.0
_LIGHT = np.array([-0.3, -0.5, 0.81])
_PLAIN = (0.6, 0.62, 0.66, 1.0)
_SIDES = 10  # of a cylinder
_NEAR = 0.1  # [m]


def sketch(
    robot: MobileManipulator,
    world: World,
    q: Float[np.ndarray, " n"],
    trails: Sequence[Trail] = (),
    width: int = 640,
    height: int = 480,
) -> UInt8[np.ndarray, "h w 3"]:
    """Return a picture (height, width, 3), RGB, of a robot at q among the walls' feet, with trails in front."""
    fig = Figure(figsize=(width / 100, height / 100), dpi=100, facecolor="#f2f2ee")
    canvas = FigureCanvasAgg(fig)
    axes = fig.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set(xlim=(-width / height, width / height), ylim=(-1.0, 1.0))
    base = np.append(q[robot.base][:2], 0.0) if robot.base.stop else np.zeros(3)
    eye, R = base + PLACE, _camera()

    def seen(points: np.ndarray) -> np.ndarray:
        """Return right, up [1] and depth [m] of points (n, 3)."""
        local = (points - eye) @ R.T
        depth = np.maximum(-local[:, 2], _NEAR)
        return np.column_stack([local[:, :2] / depth[:, None] / np.tan(np.radians(VIEW / 2)), depth])

    segments = np.column_stack([world.segments[:, :2], world.bottom, world.segments[:, 2:], world.bottom])
    before = [pair for pair in segments.reshape(-1, 2, 3) if np.all(-((pair - eye) @ R.T)[:, 2] > _NEAR)]
    tiles = _tiles(base)
    ends = [[seen(pair)[:, :2] for pair in pairs] for pairs in (tiles, before)]
    axes.add_collection(LineCollection(ends[0], colors="#d8d8d2", linewidths=0.8, zorder=1))
    axes.add_collection(LineCollection(ends[1], colors="#77756c", linewidths=2.0, zorder=2))
    faces = sorted(((seen(face), colour) for face, colour in _faces(robot, q)), key=lambda f: -f[0][:, 2].mean())
    polygons, colours = [face[:, :2] for face, _ in faces], [colour for _, colour in faces]
    axes.add_collection(PolyCollection(polygons, facecolors=colours, edgecolors=colours, linewidths=0.3, zorder=3))
    for colour, points in trails:
        if len(points) > 1:
            axes.plot(*seen(np.asarray(points))[:, :2].T, color=colour, linewidth=2.0, zorder=4)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[:, :, :3].copy()


def _camera() -> Float[np.ndarray, "3 3"]:
    """Return the camera's right, up and back as rows."""
    right = RIGHT / np.linalg.norm(RIGHT)
    up = UP - (UP @ right) * right
    up /= np.linalg.norm(up)
    return np.stack([right, up, np.cross(right, up)])


def _tiles(base: Float[np.ndarray, "3"]) -> list[np.ndarray]:
    """Return lines a metre apart on the floor around the robot."""
    x, y = np.round(base[:2])
    steps = np.arange(-2.0, 7.0)
    along = [np.array([[x - 2, y + s, 0.0], [x + 6, y + s, 0.0]]) for s in steps]
    return along + [np.array([[x + s, y - 2, 0.0], [x + s, y + 6, 0.0]]) for s in steps]


def _faces(robot: MobileManipulator, q: np.ndarray) -> Iterator[tuple[np.ndarray, tuple[float, ...]]]:
    """Yield the outer faces (k, 3) of all links in the world, each with its shaded colour."""
    if robot.urdf is None:
        return
    known = set(robot.frames)
    for name, link in robot.urdf.links.items():
        if name not in known:
            continue
        T_world_link = robot.frame(name, q)
        for shape in link.visuals or link.collisions:
            T, colour = T_world_link @ shape.T_link_shape, shape.colour or _PLAIN
            for corners in _corners(shape):
                face = corners @ T[:3, :3].T + T[:3, 3]
                normal = np.cross(face[1] - face[0], face[2] - face[1])
                light = 0.65 + 0.35 * float(normal @ _LIGHT) / (float(np.linalg.norm(normal)) or 1.0)
                yield face, (*(light * np.array(colour[:3])).tolist(), colour[3])


def _corners(shape: Shape) -> list[np.ndarray]:
    """Return the faces (k, 3) of a shape in its own frame, seen from outside counter-clockwise."""
    if shape.kind == "cylinder":
        radius, half = shape.size[0], 0.5 * shape.size[1]
        turns = 2 * np.pi * np.arange(_SIDES) / _SIDES
        ring = np.column_stack([radius * np.cos(turns), radius * np.sin(turns), np.full(_SIDES, half)])
        low, after = ring * [1.0, 1.0, -1.0], np.roll(np.arange(_SIDES), -1)
        sides = [np.array([low[i], low[j], ring[j], ring[i]]) for i, j in enumerate(after.tolist())]
        return [ring, low[::-1], *sides]
    if shape.kind == "mesh":
        return []  # a primitive shape beside it is what collides
    a, b, c = 0.5 * np.array(shape.size) if shape.kind == "box" else np.full(3, shape.size[0])
    square = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], dtype=float)
    top = np.column_stack([square, np.ones(4)])
    cube = [top[:, [0, 1, 2]], top[:, [2, 0, 1]], top[:, [1, 2, 0]]]
    return [size * (face if sign > 0 else -face[::-1]) for face in cube for sign in (1, -1) for size in [[a, b, c]]]
