"""A robot in the page, live: watched, driven by keys and buttons, its tool dragged, and stopped."""

import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from longreach.configuration import ConfigurationTrajectory
from longreach.errors import LongreachError
from longreach.geometry import se2
from longreach.view import bodies, overlay
from longreach.view.control_channel import ControlChannel
from longreach.view.experiments import EXPERIMENTS, Asked
from longreach.view.frame import Frame
from longreach.view.live_plots import LivePlots
from longreach.view.page import add_legend, text_html
from longreach.view.preview import Preview
from longreach.view.replay import sweep_points
from longreach.view.robot_client import RobotClient
from longreach.view.scene import Follower, Scene
from longreach.view.session import Session
from longreach.view.trails import GrowingMap, Trail

_FRAME = 0.05  # [s] between two pictures
_RECENT = 64  # states, half a second: a scan comes later than the state of its time
_GIZMO = 70.0  # [pixels]: a finger finds it
_SILENT = 0.25  # [s]
_BUTTONS = {"U": "⟲ U", "I": "↑ I", "O": "⟳ O", "J": "← J", "K": "↓ K", "L": "→ L"}  # as on a keyboard
_SHOWN = ("estimate", "wheels", "truth", "scan", "map", "base driven", "tool driven", "base planned", "tool planned")


class Teleop:
    """Scene, controls and plots of one client in a viser server; `loop` keeps them up to date.

    prepare: what planning needs, done beside while all the rest works already.
    """

    def __init__(
        self, server: Any, client: RobotClient, folder: Path = Path("out"), prepare: Callable[[], object] | None = None
    ) -> None:
        self.client, self._server, self._folder = client, server, folder
        robot, q = client.robot, client.state.q
        self.scene = Scene(server, robot, q[:2] if robot.base.stop else np.zeros(2), 2.2)
        self.plan: ConfigurationTrajectory | None = None
        self.preview = Preview(self.scene, server, robot)
        self.map = GrowingMap(self.scene)
        self._started = 0.0
        self._dragging, self._busy = False, ""
        self._session: Session | None = None
        self._trails = {name: Trail(self.scene, name) for name in ("base driven", "tool driven")}
        self._follower = Follower(server)
        self._scan: tuple[Any, Any, Any] = (None, None, None)  # as it came, its points, and where the base was
        self._ways: deque[tuple[float, np.ndarray]] = deque([(client.state.stamp, q[:3])], maxlen=_RECENT)
        self._unwatch = client.on_state(lambda state: self._ways.append((state.stamp, state.q[:3])))
        self._add_controls()
        if prepare is not None:
            self._work(prepare, "getting ready to plan …")

    def _add_controls(self) -> None:
        gui, client = self._server.gui, self.client
        gate = self._server.gate
        self.control = ControlChannel(client, gate.rejections, lambda: self._pace.value, self._tell)
        gate.control = self.control.serve
        overlay.add_stop(self._server)
        self._reset = gui.add_button("Move again", visible=False)
        self._reset.on_click(lambda _: self._try(client.reset))
        self._status = gui.add_html("…")
        self._add_driving()
        self._add_plans()
        self.record_button = gui.add_button(
            "Record", color="gray", hint="All states and scans, into out/session-….mcap"
        )
        self.record_button.on_click(lambda _: self._try(self.record))
        self._follow = gui.add_checkbox("Camera follows the base", False)
        with gui.add_folder("Legend"):
            add_legend(self._server, _SHOWN)
        self._plots = LivePlots(self._server, client.robot)
        self.gizmo = self._server.scene.add_transform_controls(
            "/target", scale=_GIZMO, fixed=True, depth_test=False, line_width=4.0
        )
        self._put_gizmo(client.robot.forward(client.state.q))
        self.gizmo.on_update(self._dragged)

    def _add_driving(self) -> None:
        gui = self._server.gui
        if not self.client.robot.base.stop:
            return
        with gui.add_folder("Drive (hold a key or a button)"):
            self._pace = gui.add_slider("Speed [m/s]", min=0.05, max=0.8, step=0.05, initial_value=0.3)
            overlay.add_pad(self._server, _BUTTONS)

    def _add_plans(self) -> None:
        gui = self._server.gui
        with gui.add_folder("Tool and plans"):
            self._drag = gui.add_dropdown("Drag", ("plan first", "follow at once"), hint="What dragging the gizmo does")
            self._method = gui.add_dropdown("Planner", ("task-priority", "sqp"))
            self.run_button = gui.add_button("Run the plan", disabled=True, color="green")
            self.drop_button = gui.add_button("Drop the plan", disabled=True, color="gray")
            if self.client.robot.base.stop and self.client.robot.dof > 3:
                self.experiment = gui.add_dropdown(
                    "Experiment", tuple(EXPERIMENTS), initial_value="dual-trajectory, 2 m"
                )
                self.experiment_button = gui.add_button("Plan the experiment")
                self.experiment_button.on_click(lambda _: self._work(self._plan_experiment))
        self.run_button.on_click(lambda _: self.run())
        self.drop_button.on_click(lambda _: self.drop())

    def _dragged(self, event: Any) -> None:
        self._dragging = event.phase != "end"
        T = np.eye(4)
        w, x, y, z = np.asarray(self.gizmo.wxyz)
        T[:3, :3] = bodies.rotation(w, x, y, z)
        T[:3, 3] = self.gizmo.position
        if self._drag.value == "follow at once":
            self._try(lambda: self.client.reach(T))
        elif event.phase == "end":
            self._work(lambda: self.show_plan(self.client.plan(T, self._method.value)))

    def _plan_experiment(self) -> None:
        self.show_plan(EXPERIMENTS[self.experiment.value](Asked(self.client, self._method.value, self.map.points)))

    def show_plan(self, plan: ConfigurationTrajectory) -> None:
        """Show the way along a plan, and let it be run or dropped."""
        self.preview.show(plan)
        self.plan, self._started = plan, 0.0
        self.run_button.label = f"Run the plan, {plan.duration:.1f} s"
        self.run_button.disabled = self.drop_button.disabled = False

    def run(self) -> None:
        """Let the robot follow the plan that is shown; its way stays until it has ended."""
        plan = self.plan
        if plan is not None:
            self._forget()
            self._started = time.monotonic()
            self._try(lambda: self.client.execute(plan, wait=False))

    def drop(self) -> None:
        """Forget the plan that is shown."""
        self.preview.hide()
        self._forget()

    def _forget(self) -> None:
        self.plan, self._started = None, 0.0
        self.run_button.label = "Run the plan"
        self.run_button.disabled = self.drop_button.disabled = True

    def record(self) -> None:
        """Begin to record, or end it and write the recording."""
        if self._session is None:
            self._session = Session(self.client)
            self.record_button.label, self.record_button.color = "Stop recording", "red"
            return
        session, self._session = self._session, None
        self.record_button.label, self.record_button.color = "Record", "gray"
        path = self._folder / time.strftime("session-%Y%m%d-%H%M%S.mcap")
        session.write(path)
        self._tell(f"Recorded to {path}", "longreach view shows it again.")

    def _try(self, action: Callable[[], Any]) -> None:
        try:
            action()
        except LongreachError as error:
            self._tell("That did not work", str(error))

    def _work(self, action: Callable[[], object], what: str = "planning …") -> None:
        """Do what takes a while beside the loop, one such thing at a time, and say what."""
        if self._busy:
            return
        self._busy = what

        def work() -> None:
            try:
                self._try(action)
            finally:
                self._busy = ""

        threading.Thread(target=work, daemon=True).start()

    def _tell(self, title: str, body: str) -> None:
        for client in self._server.get_clients().values():
            client.add_notification(title, body, auto_close_seconds=8.0)

    def loop(self, until: threading.Event) -> None:
        """Let the robot be driven and show what is said until the event is set."""
        driver, count = threading.Thread(target=self.control.drive, args=(until,), daemon=True), 0
        if self.client.robot.base.stop:
            driver.start()
        while not until.wait(_FRAME):
            count += 1
            self.show(count)
        if driver.ident is not None:
            driver.join()
        self._unwatch()
        if self._session is not None:
            self._try(self.record)

    def show(self, count: int = 0) -> None:
        """Show the newest state."""
        state, robot = self.client.state, self.client.robot
        tool = robot.forward(state.q)
        with self._server.atomic():
            self._take_scan(count)
            self.scene.show(
                Frame(state.q, state.covariance, state.wheels, state.truth, state.tool_truth, *self._scan[1:])
            )
            if robot.base.stop:
                self._trails["base driven"].grow(np.array([*state.q[:2], 0.0]))
            self._trails["tool driven"].grow(tool[:3, 3])
            self._follower.show(np.array([*state.q[:2], 0.0]), self._follow.value)
            if not self._dragging and not self._busy and self.plan is None:
                self._put_gizmo(tool)
            if self._started and time.monotonic() > self._started + 1.0 and state.goal != "follow":
                self.drop()
            if count % 5 == 0:
                self._show_status(state)
            self._plots.take(state, show=count % 10 == 0)

    def _take_scan(self, count: int) -> None:
        scan, robot = self.client.scan, self.client.robot
        if scan is not self._scan[0]:
            mount = robot.description.lidar.mount if robot.description.lidar else None
            points = sweep_points(scan, np.eye(4) if mount is None else mount.matrix())
            _, pose = min(tuple(self._ways), key=lambda way: abs(way[0] - scan.stamp))
            self._scan = (scan, points, pose)
            if count % 10 == 0 or not len(self.map.points):
                self.map.grow(se2.transform(pose, points))

    def _put_gizmo(self, T: np.ndarray) -> None:
        if np.linalg.norm(T[:3, 3] - np.asarray(self.gizmo.position)) > 1e-4:
            bodies.place(self.gizmo, T)

    def _show_status(self, state: Any) -> None:
        age, held = self.client.age, text_html(state.holder or "nobody")
        stopped = f"<b>stopped</b>: {text_html(state.stop)}" if state.stop else text_html(state.goal)
        word = f"⚠ silent for {age:.1f} s" if age > _SILENT else stopped
        done = f" {100 * state.progress:.0f} %" if state.goal == "follow" else ""
        planning = f" · <b>{text_html(self._busy)}</b>" if self._busy else ""
        words = f"{word}{done}{planning} · held by {held} · loop {1e3 * state.loop_time:.1f} ms"
        text = f'<div style="font-size:.875rem;padding:.2em .6em;overflow-wrap:anywhere">{words}</div>'
        if self._status.content != text:
            self._status.content = text
        if self._reset.visible != state.latched:
            self._reset.visible = state.latched
