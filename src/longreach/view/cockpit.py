"""A robot in the page, live: watched, driven by keys and buttons, its tool dragged, and stopped."""

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from longreach.configuration import ConfigurationTrajectory
from longreach.errors import LongreachError
from longreach.geometry import se2
from longreach.planning.reference import dual_trajectory
from longreach.view import bodies
from longreach.view.face import Commanded
from longreach.view.live_plots import LivePlots
from longreach.view.moment import Moment
from longreach.view.page import add_legend
from longreach.view.replay import sweep_points
from longreach.view.scene import COLOURS, Scene
from longreach.view.session import Session

_FRAME = 0.05  # [s] between two pictures
_COASTS = 0.4  # a key that is held repeats faster than this [s]
_STEP = 0.05  # of the driven paths [m]
_SILENT = 0.25  # [s]
# Not W A S D Q E nor the arrows: with those viser moves the camera.
_KEYS = {"I": (1, 0, 0), "K": (-1, 0, 0), "J": (0, 1, 0), "L": (0, -1, 0), "U": (0, 0, 1), "O": (0, 0, -1)}
_BUTTONS = {"I": "↑ forward", "K": "↓ back", "J": "← left", "L": "→ right", "U": "⟲ turn left", "O": "⟳ turn right"}
_TURN = 1.5  # how much faster it turns than it drives [rad/m]


class Cockpit:
    """Scene, controls and plots of one client in a viser server; `loop` keeps them up to date."""

    def __init__(self, server: Any, client: Commanded, folder: Path = Path("out")) -> None:
        self.client, self._server, self._folder = client, server, folder
        robot, q = client.robot, client.state.q
        self.scene = Scene(server, robot, q[:2] if robot.base.stop else np.zeros(2), 2.2)
        self.plan: ConfigurationTrajectory | None = None
        self._preview: Any = None
        self._twist, self._until = np.zeros(3), 0.0
        self._dragging = self._busy = False
        self._session: Session | None = None
        self._end_session: Any = None
        self._trails: dict[str, list[np.ndarray]] = {"base driven": [], "tool driven": []}
        self._cells: set[tuple[int, int]] = set()
        self._scan: tuple[Any, Any] = (None, None)
        self._add_controls()

    def _add_controls(self) -> None:
        gui, client = self._server.gui, self.client
        self.stop_button = gui.add_button("STOP  (space)", color=(213, 94, 0), hint="Brake at once and stay so")
        self.stop_button.on_click(lambda _: client.stop())
        gui.add_command("Stop", hotkey="space").on_trigger(lambda _: client.stop())
        self._reset = gui.add_button("Move again", visible=False)
        self._reset.on_click(lambda _: self._try(client.reset))
        self._status = gui.add_markdown("…")
        self._add_driving()
        with gui.add_folder("Tool"):
            self._method = gui.add_dropdown("Planner", ("task-priority", "sqp"))
            self._drag = gui.add_dropdown("Drag", ("plan first", "follow at once"))
            self.run_button = gui.add_button("Run the plan", disabled=True, color="green")
            self.drop_button = gui.add_button("Drop the plan", disabled=True)
            self._experiment = gui.add_dropdown("Experiment", ("dual-trajectory, 2 m", "dual-trajectory, 1 m"))
            self.experiment_button = gui.add_button("Plan the experiment")
        self.run_button.on_click(lambda _: self.run())
        self.drop_button.on_click(lambda _: self.drop())
        self.experiment_button.on_click(lambda _: self._work(self._plan_experiment))
        self.record_button = gui.add_button("Record")
        self.record_button.on_click(lambda _: self._try(self.record))
        with gui.add_folder("Legend", expand_by_default=False):
            add_legend(
                self._server, ("estimate", "wheels", "truth", "scan", "map", "base driven", "tool driven", "preview")
            )
        self._plots = LivePlots(self._server, client.robot)
        self.gizmo = self._server.scene.add_transform_controls("/target", scale=0.35, depth_test=False, line_width=3.0)
        self._put_gizmo(client.robot.forward(client.state.q))
        self.gizmo.on_update(self._dragged)

    def _add_driving(self) -> None:
        gui = self._server.gui
        if not self.client.robot.base.stop:
            return
        with gui.add_folder("Drive (hold a key or a button)"):
            self._pace = gui.add_slider("Speed [m/s]", min=0.05, max=0.8, step=0.05, initial_value=0.3)
            for key, label in _BUTTONS.items():
                gui.add_button(f"{label} ({key})", color="gray").on_hold(
                    lambda _, key=key: self.drive(key), callback_hz=10.0
                )
        for key in _KEYS:
            gui.add_command(f"Drive {key}", hotkey=key).on_trigger(lambda _, key=key: self.drive(key))

    def drive(self, key: str) -> None:
        """Drive as a key says, until it has not been told for a while."""
        pace = self._pace.value
        self._twist = pace * np.array(_KEYS[key]) * [1.0, 1.0, _TURN]
        self._until = time.monotonic() + _COASTS

    def _dragged(self, event: Any) -> None:
        self._dragging = event.phase != "end"
        T = np.eye(4)
        w, x, y, z = np.asarray(self.gizmo.wxyz)
        T[:3, :3] = _rotation(w, x, y, z)
        T[:3, 3] = self.gizmo.position
        if self._drag.value == "follow at once":
            self._try(lambda: self.client.reach(T))
        elif event.phase == "end":
            self._work(lambda: self.preview(self.client.plan(T, self._method.value)))

    def _plan_experiment(self) -> None:
        """Plan the thesis' second experiment from where the robot is."""
        robot, q = self.client.robot, self.client.state.q
        length = 2.0 if "2 m" in self._experiment.value else 1.0
        reference = dual_trajectory(robot.forward(q), q[robot.base], length, 0.2, waypoints=200, duration=10.0 * length)
        self.preview(self.client.plan(reference, self._method.value))

    def preview(self, plan: ConfigurationTrajectory) -> None:
        """Show the tool's way along a plan, and let it be run or dropped."""
        self.drop()
        rows = np.unique(np.linspace(0, len(plan) - 1, 200).astype(int))
        way = self.client.robot.forward(plan.q[rows])[:, :3, 3]
        self._preview = self.scene.add_path("preview", way, COLOURS["preview"], 4.0)
        self.plan = plan
        self.run_button.label = f"Run the plan, {plan.duration:.1f} s"
        self.run_button.disabled = self.drop_button.disabled = False

    def run(self) -> None:
        """Let the robot follow the plan that is shown."""
        plan = self.plan
        if plan is not None:
            self.drop()
            self._try(lambda: self.client.execute(plan, wait=False))

    def drop(self) -> None:
        """Forget the plan that is shown."""
        if self._preview is not None:
            self._preview.remove()
        self.plan = self._preview = None
        self.run_button.label = "Run the plan"
        self.run_button.disabled = self.drop_button.disabled = True

    def record(self) -> None:
        """Begin to record, or end it and write the recording."""
        if self._session is None:
            self._session = Session()
            self._end_session = self.client.on_state(self._session.take)
            self.record_button.label, self.record_button.color = "Stop recording", "red"
            return
        self._end_session()
        session, self._session = self._session, None
        self.record_button.label, self.record_button.color = "Record", None
        path = self._folder / time.strftime("session-%Y%m%d-%H%M%S.mcap")
        session.write(path, self.client.robot)
        self._tell(f"Recorded to {path}", "longreach view shows it again.")

    def _try(self, action: Any) -> None:
        try:
            action()
        except LongreachError as error:
            self._tell("That did not work", str(error))

    def _work(self, action: Any) -> None:
        """Do what takes long in a thread of its own, one at a time, so that a stop never waits."""
        if self._busy:
            return
        self._busy = True

        def work() -> None:
            try:
                self._try(action)
            finally:
                self._busy = False

        threading.Thread(target=work, daemon=True).start()

    def _tell(self, title: str, body: str) -> None:
        for client in self._server.get_clients().values():
            client.add_notification(title, body, auto_close_seconds=8.0)

    def loop(self, until: threading.Event) -> None:
        """Send what is driven and show what is said until the event is set."""
        drove, count = False, 0
        while not until.wait(_FRAME):
            driving = time.monotonic() < self._until
            if driving:
                twist = self._twist
                self._try(lambda twist=twist: self.client.velocity(base=twist))
            elif drove:
                self._try(self.client.hold)
            drove, count = driving, count + 1
            self.show(count)

    def show(self, count: int = 0) -> None:
        """Show the newest state."""
        state, scan, robot = self.client.state, self.client.scan, self.client.robot
        if scan is not self._scan[0]:
            mount = robot.description.lidar.mount if robot.description.lidar else None
            self._scan = (scan, sweep_points(scan, np.eye(4) if mount is None else mount.matrix()))
            if count % 10 == 0:
                self._grow_map(state.q[:3], self._scan[1])
        if self._session is not None:
            self._session.take_scan(scan)
        tool = robot.forward(state.q)
        with self._server.atomic():
            self.scene.show(
                Moment(state.q, state.covariance, state.wheels, state.truth, state.tool_truth, self._scan[1])
            )
            self._grow("base driven", np.array([*state.q[:2], 0.0]))
            self._grow("tool driven", tool[:3, 3])
            if not self._dragging and not self._busy and self.plan is None:
                self._put_gizmo(tool)
            if count % 5 == 0:
                self._show_status(state)
            self._plots.take(state, show=count % 10 == 0)

    def _put_gizmo(self, T: np.ndarray) -> None:
        if np.linalg.norm(T[:3, 3] - np.asarray(self.gizmo.position)) > 1e-4:
            bodies.place(self.gizmo, T)

    def _grow(self, name: str, point: np.ndarray) -> None:
        trail = self._trails[name]
        if not trail or np.linalg.norm(point - trail[-1]) > _STEP:
            trail.append(point)
            if len(trail) > 1:
                self.scene.add_path(f"{name}/{len(trail) % 4000}", np.array(trail[-2:]), COLOURS[name])

    def _grow_map(self, pose: np.ndarray, scan: np.ndarray) -> None:
        points = se2.transform(pose, scan)
        new = set(map(tuple, np.round(points / 0.04).astype(int).tolist())) - self._cells
        if new:
            cloud = np.column_stack([0.04 * np.array(sorted(new)), np.full(len(new), 0.012)])
            self.scene.add_cloud(f"/map/{len(self._cells)}", cloud)
            self._cells |= new

    def _show_status(self, state: Any) -> None:
        age, held = self.client.age, state.holder or "nobody"
        word = (
            f"⚠ silent for {age:.1f} s" if age > _SILENT else f"**stopped**: {state.stop}" if state.stop else state.goal
        )
        done = f" {100 * state.progress:.0f} %" if state.goal == "follow" else ""
        text = f"{word}{done} · held by {held} · loop {1e3 * state.loop_time:.1f} ms"
        if self._status.content != text:
            self._status.content = text
        if self._reset.visible != state.latched:
            self._reset.visible = state.latched


def _rotation(w: float, x: float, y: float, z: float) -> np.ndarray:
    """Return the matrix (3, 3) of a unit quaternion."""
    a, v = w, np.array([x, y, z])
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * a * hat + 2 * (np.outer(v, v) - v @ v * np.eye(3))
