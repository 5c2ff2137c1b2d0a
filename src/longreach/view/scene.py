"""The three-dimensional part of a page: robot, ghosts, ellipse, scan, map and paths, as nodes of viser's scene.

Colours are those of the figures (Okabe & Ito 2008): blue the estimate, orange the wheels alone, black the truth.
"""

import itertools
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.errors import ConfigError
from longreach.evaluation import style
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.view import bodies
from longreach.view.frame import Frame

_ABOVE = 0.012  # of lines over the floor [m], so that they do not flicker in it
_CHI2_95 = 5.991  # of two degrees of freedom
_STILL = 1e-5  # of a joint [rad], that is not seen
_NOTICED = 0.01  # of the base's way, by a camera that follows it [m]
_PIECES = 40  # that a path or a map appears in as it grows
COLOURS = {
    "estimate": style.BLUE,
    "wheels": style.ORANGE,
    "truth": style.BLACK,
    "scan": style.VERMILION,
    "map": "#8a9199",
    "base driven": style.BLUE,
    "tool driven": style.GREEN,
    "tool truth": style.BLACK,
    "base planned": style.SKY,
    "tool planned": style.PURPLE,
}


def rgb(colour: str) -> tuple[int, int, int]:
    """Return a colour "#rrggbb" as three numbers 0 to 255."""
    return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))  # type: ignore[return-value]


class Scene:
    """The nodes of one robot's scene in a viser server; `show` moves them."""

    def __init__(self, server: Any, robot: MobileManipulator, center: Float[np.ndarray, "2"], radius: float) -> None:
        self._scene, self._robot, self.magnified = server.scene, robot, 10.0
        scene = server.scene
        scene.set_up_direction("+z")
        scene.add_grid(
            "/floor", width=60.0, height=60.0, cell_size=0.5, section_size=1.0, cell_color=(226, 228, 231),
            section_color=(205, 208, 213), cell_thickness=0.6, section_thickness=0.8, shadow_opacity=0.25,
            position=(float(np.round(center[0])), float(np.round(center[1])), 0.0),
        )  # fmt: skip
        back = 0.85 * max(radius, 1.6)
        server.initial_camera.position = (center[0] - 1.0 * back, center[1] - 1.55 * back, 1.35 * back)
        server.initial_camera.look_at = (center[0], center[1], 0.05)
        server.initial_camera.up = (0.0, 0.0, 1.0)
        self._links, self._carried = bodies.add_robot(scene, "/robot", robot)
        self._turned: dict[str, float] = {}  # fingers and wheels, as they are shown
        self._top = bodies.top(robot) + _ABOVE  # an ellipse on the floor would lie hidden under the base
        self._ghosts = {
            "wheels": bodies.add_base_outline(scene, "/wheels", robot, rgb(COLOURS["wheels"]), 0.02),
            "truth": bodies.add_base_outline(scene, "/truth", robot, rgb(COLOURS["truth"])),
        }
        disc = bodies.disc()
        blue = rgb(COLOURS["estimate"])
        self._ellipse = scene.add_mesh_simple(
            "/ellipse", *disc, color=blue, opacity=0.6, side="double", cast_shadow=False, visible=False
        )
        ring = np.column_stack([disc[0][1:], np.roll(disc[0][1:], -1, axis=0)]).reshape(-1, 2, 3)
        self._ring = scene.add_line_segments(
            "/ellipse_edge", ring, blue, thickness=3.0, thickness_units="screen", visible=False
        )
        self._tool_truth = scene.add_icosphere("/tool_truth", radius=0.018, color=(0, 0, 0), visible=False)
        self._scan = scene.add_point_cloud(
            "/scan", np.zeros((1, 3), np.float32), rgb(COLOURS["scan"]), point_size=0.03, point_shape="circle",
            point_shading="flat", visible=False,
        )  # fmt: skip
        self._shown_scan: Any = None
        self._arm: np.ndarray | None = None  # as it is shown

    def show(self, frame: Frame) -> None:
        """Put everything where it is at a frame."""
        pose = frame.q[:3] if self._robot.base.stop else np.zeros(3)
        self._show_links(pose, frame.q)
        self._show_carried(frame.joints)
        for name, at in (("wheels", frame.wheels), ("truth", frame.truth)):
            self._show_base(self._ghosts[name], at)
        self._show_ellipse(pose, frame.covariance)
        self._tool_truth.visible = frame.tool_truth is not None
        if frame.tool_truth is not None:
            self._tool_truth.position = frame.tool_truth[:3, 3]
        self._show_scan(pose if frame.scan_pose is None else frame.scan_pose, frame.scan)

    def _show_links(self, pose: np.ndarray, q: np.ndarray) -> None:
        """Move the robot as a whole, and its links in it where the arm has moved."""
        bodies.place_plane(self._links[""], pose)
        arm = q[self._robot.arm]
        if self._arm is not None and np.max(np.abs(arm - self._arm), initial=0.0) < _STILL:
            return
        self._arm, inside = arm.copy(), q.copy()
        inside[: self._robot.base.stop] = 0.0
        for handle, T in bodies.placed(self._links, self._robot, inside):
            bodies.place(handle, T)

    def _show_carried(self, joints: Mapping[str, float]) -> None:
        """Move fingers and wheels where they have moved; what is not known stands at zero."""
        for joint, node in self._carried.items():
            position = joints.get(joint.name, 0.0)
            if abs(position - self._turned.get(joint.name, np.inf)) >= _STILL:
                self._turned[joint.name] = position
                bodies.place(node, joint.at(position))

    def _show_base(self, ghost: Any, pose: np.ndarray | None) -> None:
        ghost.visible = pose is not None
        if pose is not None:
            bodies.place_plane(ghost, pose)

    def _show_ellipse(self, pose: np.ndarray, covariance: np.ndarray | None) -> None:
        """Draw where the base's centre is with 95 %, its half axes `magnified` times as long."""
        for part in (self._ellipse, self._ring):
            part.visible = covariance is not None
        if covariance is None:
            return
        values, axes = np.linalg.eigh(covariance[:2, :2])
        half = self.magnified * np.sqrt(_CHI2_95 * np.maximum(values, 0.0))
        turn = float(np.arctan2(axes[1, 0], axes[0, 0])) + pose[2]
        size = tuple(np.maximum(half, 1e-3).tolist())
        for part in (self._ellipse, self._ring):
            part.scale = (*size, 1.0)
            bodies.place_plane(part, np.array([pose[0], pose[1], turn]), self._top)

    def _show_scan(self, pose: np.ndarray, scan: np.ndarray | None) -> None:
        self._scan.visible = scan is not None
        if scan is None:
            return
        if scan is not self._shown_scan:
            self._scan.points = np.column_stack([scan, np.full(len(scan), 2 * _ABOVE)]).astype(np.float32)
            self._shown_scan = scan
        bodies.place_plane(self._scan, pose)

    def add_path(self, name: str, points: Float[np.ndarray, "k 3"], colour: str, wide: float = 3.0) -> Any:
        """Draw a line through points [m] and return its node."""
        points = np.asarray(points, dtype=np.float32)
        points = points + np.array([0.0, 0.0, _ABOVE], np.float32)
        pairs = np.stack([points[:-1], points[1:]], axis=1)
        return self._scene.add_line_segments(
            f"/paths/{name}", pairs, rgb(colour), thickness=wide, thickness_units="screen"
        )

    def add_growing_path(
        self, name: str, times: np.ndarray, points: Float[np.ndarray, "k 3"], colour: str
    ) -> Iterator[tuple[float, Any]]:
        """Draw a line in pieces; yield each one's time [s] and node, for `Growing`."""
        edges = np.unique(np.linspace(0, len(points) - 1, _PIECES + 1).astype(int))
        for start, stop in itertools.pairwise(edges):
            yield float(times[stop]), self.add_path(f"{name}/{start}", points[start : stop + 1], colour)

    def add_growing_map(self, times: np.ndarray, points: Float[np.ndarray, "m 2"]) -> Iterator[tuple[float, Any]]:
        """Draw the map in pieces; yield each one's time [s] and node."""
        for i, rows in enumerate(np.array_split(np.arange(len(points)), _PIECES)):
            if len(rows):
                cloud = np.column_stack([points[rows], np.full(len(rows), _ABOVE)]).astype(np.float32)
                yield float(times[rows[-1]]), self.add_cloud(f"/map/{i}", cloud)

    def add_cloud(self, name: str, points: Float[np.ndarray, "m 3"]) -> Any:
        """Draw points of the map."""
        return self._scene.add_point_cloud(
            name, points.astype(np.float32), rgb(COLOURS["map"]), point_size=0.03, point_shape="circle",
            point_shading="flat", precision="float32",
        )  # fmt: skip


class Growing:
    """Nodes that appear one after the other as time goes on, and vanish as it goes back."""

    def __init__(self, pieces: Iterator[tuple[float, Any]]) -> None:
        self._pieces = list(pieces)
        self._shown = [True] * len(self._pieces)

    def show(self, time: float) -> None:
        """Show the nodes whose time [s] has come."""
        for i, (since, node) in enumerate(self._pieces):
            if (since <= time) != self._shown[i]:
                node.visible = self._shown[i] = since <= time


class Follower:
    """Lets every camera go where the base goes."""

    def __init__(self, server: Any) -> None:
        self._server, self._last = server, np.zeros(3)

    def show(self, base: Float[np.ndarray, "3"], follow: bool) -> None:
        """Move the cameras by as much as the base [m] has moved since, or only remember where it is."""
        moved = base - self._last
        if follow and np.linalg.norm(moved) < _NOTICED:
            return
        self._last = base
        for client in self._server.get_clients().values() if follow else ():
            client.camera.position = client.camera.position + moved  # what it looks at goes along


def engine() -> Any:
    """Return the module viser.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        import viser
    except ImportError as error:
        raise ConfigError("The page needs viser; install it with: pip install 'longreach[viewer]'.") from error
    return viser
