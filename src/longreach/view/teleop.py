"""A robot in the page, live: watched, driven by keys and buttons, its tool dragged, and stopped."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from longreach.app.readings_check import without_numbers
from longreach.configuration import ConfigurationTrajectory
from longreach.errors import LongreachError
from longreach.geometry import se2
from longreach.io.bag_recorder import Recorder
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
from longreach.view.trails import GrowingMap, Trail

_FRAME = 0.05  # [s] between two pictures
_RECENT = 64  # states, half a second: a scan comes later than the state of its time
_GIZMO = 70.0  # [pixels]: a finger finds it
_SILENT = 0.25  # [s]
_LASTING = 0.5  # a stop that is worth a banner [s]
_ALONE = 1.0  # after the last browser has gone the robot is released [s]
_CLEAR = "Clear the stop"
_STATUS = "font-size:.875rem;line-height:1.5;padding:.2em .6em;overflow-wrap:anywhere"
_LOG = logging.getLogger("longreach.view")
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
        self._dragging, self._busy, self._watched = False, "", 0.0  # when a browser was there last [s]
        self._failed = False  # to draw
        self._recorder: Recorder | None = None
        self._trails = {name: Trail(self.scene, name) for name in ("base driven", "tool driven")}
        self._follower = Follower(server)
        self._scan: tuple[Any, Any, Any] = (None, None, None)  # as it came, its points, and where the base was
        self._ways: deque[tuple[float, np.ndarray]] = deque([(client.state.stamp, q[:3])], maxlen=_RECENT)
        self._watches = client.role == "watcher"
        self._known_remarks: set[str] = set()  # of the remarks on readings, without their numbers
        self._unwatch = client.on_state(lambda state: self._ways.append((state.stamp, state.q[:3])))
        self._add_controls()
        if prepare is not None:
            self._work(prepare, "getting ready to plan …")

    def _add_controls(self) -> None:
        gui, client = self._server.gui, self.client
        gate = self._server.gate
        self.control = ControlChannel(client, gate.rejections, lambda: self._pace.value, self._command)
        gate.control = self.control.serve
        overlay.add_stop(self._server)
        self._notices = overlay.Notices(self._server)
        self._status = gui.add_html("…")
        self._reset = gui.add_button(_CLEAR, disabled=True, hint="Nothing moves by itself afterwards.")
        self._reset.on_click(lambda _: self._try(client.reset))
        self._release = gui.add_button(
            "Release the robot", disabled=True, color="gray", hint="It stands, and others can take it."
        )
        self._release.on_click(lambda _: self._try(client.release))
        self._reset.visible = self._release.visible = not self._watches
        self._add_driving()
        self._add_plans()
        self.record_button = gui.add_button(
            "Record", color="gray", hint="All that the robot says, into out/session-….mcap"
        )
        self.record_button.on_click(lambda _: self._try(self.record))
        self._magnified = gui.add_dropdown("Ellipse", ("1 ×", "10 ×", "50 ×"), initial_value="10 ×")
        self._follow = gui.add_checkbox("Camera follows the base", False)
        with gui.add_folder("Legend"):
            add_legend(self._server, _SHOWN)
        self._plots = LivePlots(self._server, client.robot)
        self.gizmo = self._server.scene.add_transform_controls(
            "/target", scale=_GIZMO, fixed=True, depth_test=False, line_width=4.0
        )
        self._put_gizmo(client.robot.forward(client.state.q))
        self.gizmo.visible = not self._watches
        self.gizmo.on_update(self._dragged)

    def _add_driving(self) -> None:
        gui = self._server.gui
        if not self.client.robot.base.stop:
            return
        with gui.add_folder("Drive (hold a key or a button)", visible=not self._watches):
            self._pace = gui.add_slider("Speed [m/s]", min=0.05, max=0.8, step=0.05, initial_value=0.3)
            overlay.add_pad(self._server, _BUTTONS)

    def _add_plans(self) -> None:
        gui = self._server.gui
        with gui.add_folder("Tool and plans", visible=not self._watches):
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
            self._command(lambda: self.client.reach(T))
        elif event.phase == "end":
            self._work(lambda: self.show_plan(self.client.plan(T, self._method.value)))

    def _plan_experiment(self) -> None:
        self.show_plan(EXPERIMENTS[self.experiment.value](Asked(self.client, self._method.value, self.map.points)))

    def show_plan(self, plan: ConfigurationTrajectory) -> None:
        """Show the way along a plan, and let it be run or dropped."""
        self.preview.show(plan)
        self.plan = plan
        self.run_button.label = f"Run the plan, {plan.duration:.1f} s"
        self.run_button.disabled = self.drop_button.disabled = False

    def run(self) -> None:
        """Let the robot follow the plan that is shown; its way stays until it has ended, and if it is refused."""
        plan = self.plan
        if plan is not None and self._command(lambda: self.client.execute(plan, wait=False)):
            self._forget()
            self._started = time.monotonic()

    def drop(self) -> None:
        """Forget the plan that is shown."""
        self.preview.hide()
        self._forget()

    def _forget(self) -> None:
        self.plan = None
        self.run_button.label = "Run the plan"
        self.run_button.disabled = self.drop_button.disabled = True

    def _plan_ended(self, why: str) -> None:
        """Take away the way of the plan that has run; why: it ended early, empty where it did not."""
        self._started = 0.0
        if self.plan is None:  # no other one is shown
            self.preview.hide()
        if why:
            self._tell("The plan has ended early", why)

    def record(self) -> None:
        """Begin to record, or end it."""
        if self._recorder is None:
            self._recorder = self.client.record(self._folder / time.strftime("session-%Y%m%d-%H%M%S.mcap"))
            self.record_button.label, self.record_button.color = "Stop recording", "red"
            self._tell("Recording", f"It goes to {self._recorder.path}.")
            return
        recorder, self._recorder = self._recorder, None
        self.record_button.label, self.record_button.color = "Record", "gray"
        recorder.close()
        if recorder.error:
            self._tell("The recording is not whole", recorder.error)
        else:
            self._tell(f"Recorded to {recorder.path}", "longreach view shows it again.")

    def _try(self, action: Callable[[], Any]) -> bool:
        """Do something and return whether it worked; if not, say why."""
        try:
            action()
        except Exception as error:  # whatever it is, the page says so and goes on
            if not isinstance(error, LongreachError):
                _LOG.exception("The page could not do what was asked of it.")
            self._tell("That did not work", str(error))
            return False
        return True

    def _command(self, action: Callable[[], Any]) -> bool:
        """Do what moves the robot, unless it is stopped."""
        if self.client.state.latched:
            self._tell("The robot is stopped", f"Press '{_CLEAR}' before you command it.")
            return False
        return self._try(action)

    def _work(self, action: Callable[[], object], what: str = "planning …") -> None:
        """Do what takes a while beside the loop, one such thing at a time, and say what."""
        if self._busy:
            return self._tell("Not now", f"The page is busy: {self._busy}")
        self._busy = what

        def work() -> None:
            try:
                self._try(action)
            finally:
                self._busy = ""

        threading.Thread(target=work, daemon=True).start()

    def _tell(self, title: str, body: str) -> None:
        self._notices.tell(title, body)

    def loop(self, until: threading.Event) -> None:
        """Let the robot be driven and show what is said until the event is set."""
        driver, count = threading.Thread(target=self.control.drive, args=(until,), daemon=True), 0
        if self.client.robot.base.stop:
            driver.start()
        while not until.wait(_FRAME):
            count += 1
            self._release_when_alone()
            try:
                self.show(count)
            except Exception as error:  # whatever it is: STOP and the keys work only as long as the page is served
                if not self._failed:
                    _LOG.exception("The page could not show the robot's state.")
                self._failed = True
                self._tell("The scene is out of date", f"It cannot be drawn: {error}. STOP and the keys still work.")
        if driver.ident is not None:
            driver.join()
        self._unwatch()

    def show(self, count: int = 0) -> None:
        """Show the newest state."""
        state, robot = self.client.state, self.client.robot
        tool = robot.forward(state.q)
        with self._server.atomic():
            if count % 5 == 0:  # first, for they say also that the rest could not be drawn
                self._show_status(state)
                self._tell_of_readings(state.remarks)
                self._notices.show(self._banner(state))
                if self._recorder is not None and self._recorder.error:
                    self._try(self.record)
            self._take_scan(count)
            self.scene.magnified = float(self._magnified.value.split()[0])
            truth = (state.truth, state.tool_truth)
            self.scene.show(Frame(state.q, state.covariance, state.wheels, *truth, *self._scan[1:], state.joints))
            if robot.base.stop:
                self._trails["base driven"].grow(np.array([*state.q[:2], 0.0]))
            self._trails["tool driven"].grow(tool[:3, 3])
            self._follower.show(np.array([*state.q[:2], 0.0]), self._follow.value)
            if not self._dragging and not self._busy and self.plan is None:
                self._put_gizmo(tool)
            if self._started and time.monotonic() > self._started + 1.0 and state.goal != "follow":
                self._plan_ended(state.why)
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
        word = (
            f"⚠ silent for {age:.1f} s" if age > _SILENT else "<b>stopped</b>" if state.stop else text_html(state.goal)
        )
        done = f" {100 * state.progress:.0f} %" if state.goal == "follow" else ""
        planning = f" · <b>{text_html(self._busy)}</b>" if self._busy else ""
        words = f"{word}{done}{planning} · held by {held}"
        if self._watches:
            words += "<div><b>You watch</b>: you may look, record and press STOP; only operators command it.</div>"
        if self.client.robot.base.stop:
            slow = f"<b>Slowed down</b>: {text_html(state.limited)}" if state.limited else ""
            words += f'<div style="min-height:3em">{slow if state.minds_obstacles else "obstacles not minded"}</div>'
        if state.remarks:
            said = "".join(f"<li>{text_html(remark)}</li>" for remark in state.remarks)
            words += f"<b>Its readings are not as they should be</b><ul>{said}</ul>"
        text = f'<div style="{_STATUS}">{words}</div>'
        if self._status.content != text:
            self._status.content = text
        for button, disabled in ((self._reset, not state.latched), (self._release, not self.client.holds)):
            if button.disabled != disabled:
                button.disabled = disabled

    def _tell_of_readings(self, remarks: Sequence[str]) -> None:
        """Give a notice of what is new; the panel shows what lasts."""
        for remark in remarks:
            if (kind := without_numbers(remark)) not in self._known_remarks:
                self._known_remarks.add(kind)
                self._tell("The robot's readings", remark)

    def _banner(self, state: Any) -> tuple[str, str] | None:
        """Return what everybody at the page must know: that the robot is stopped, and what to do."""
        since = state.stamp - state.stopped_at
        if not state.stop or (since < _LASTING and not state.latched):
            return None
        by = f" by {state.stopped_by}" if state.stopped_by else ""
        if state.latched and self._watches:
            then = "An operator has to clear the stop."
        elif state.latched:
            then = f"'{_CLEAR}' lets it take commands again; nothing moves by itself."
        else:
            then = "It takes commands again when the cause has gone."
        return f"Stopped {_ago(since)}{by}", f"Cause: {state.cause}. {state.stop} {then}"

    def _release_when_alone(self) -> None:
        """Release the robot a little after the last browser has gone: nobody sees it any more."""
        now = time.monotonic()
        if self._server.get_clients():
            self._watched = now
        elif self._watched and now > self._watched + _ALONE:
            self._watched = 0.0
            self._try(self.client.release)


def _ago(seconds: float) -> str:
    return f"{seconds:.0f} s ago" if seconds < 100 else f"{seconds / 60:.0f} min ago"
