"""A recorded run in the page: a timeline to scrub and to play, and plots that grow along it."""

import threading
import time
from typing import Any

import numpy as np

from longreach.view.frame import Run
from longreach.view.page import PlotPanel, add_legend
from longreach.view.scene import COLOURS, Follower, Growing, Scene

_FRAME = 0.04  # [s] between two pictures while it plays
_PLOTS_EVERY = 6  # pictures


class Player:
    """The run in a server's scene, at a time that a thread moves on while it plays."""

    def __init__(self, server: Any, run: Run, *, panel: bool = True) -> None:
        self.run, self._server, self._lock = run, server, threading.Lock()
        self.time, self.playing, self._count = 0.0, False, 0
        low, high = _extent(run)
        self.scene = Scene(server, run.robot, 0.5 * (low + high), 0.5 * float(np.max(high - low)) + 0.9)
        self._growing = [Growing(self.scene.add_growing_map(run.map_times, run.map_points))]
        for name, (times, points) in run.paths.items():
            self._growing.append(Growing(self.scene.add_growing_path(name, times, points, COLOURS[name])))
        for name, points in run.plans.items():
            self.scene.add_path(name, points, COLOURS[name], 2.0)
        self._plots: list[PlotPanel] = []
        self._follower, self._follow = Follower(server), None
        if panel:
            self._add_panel()
        self.seek(0.0)

    def _add_panel(self) -> None:
        gui, run = self._server.gui, self.run
        self._button = gui.add_button("Play", hint="Space bar")
        gui.add_command("Play or pause", hotkey="space").on_trigger(lambda _: self.play(not self.playing))
        self._slider = gui.add_slider("Time [s]", min=0.0, max=round(run.duration, 2), step=0.02, initial_value=0.0)
        self._speed = gui.add_dropdown("Speed", ("0.5 ×", "1 ×", "2 ×", "5 ×", "20 ×"), initial_value="1 ×")
        self._magnified = gui.add_dropdown("Ellipse", ("1 ×", "10 ×", "50 ×"), initial_value="10 ×")
        self._follow = gui.add_checkbox("Camera follows the base", False)
        self._button.on_click(lambda _: self.play(not self.playing))
        self._slider.on_update(lambda event: self.seek(self._slider.value) if event.client is not None else None)
        self._magnified.on_update(lambda _: self._magnify())
        with gui.add_folder("Legend"):
            add_legend(self._server, run.shown)
        with gui.add_folder("Plots"):
            self._plots = [PlotPanel(self._server, plot, run.times) for plot in run.plots]

    def _magnify(self) -> None:
        self.scene.magnified = float(self._magnified.value.split()[0])
        self.seek(self.time)

    def play(self, yes: bool = True) -> None:
        """Go on, from the start where it has ended, or pause."""
        if yes and self.time >= self.run.duration:
            self.seek(0.0)
        self.playing = yes
        self._button.label = "Pause" if yes else "Play"

    def seek(self, at: float, plots: bool = True) -> None:
        """Show what was at a time [s]."""
        with self._lock, self._server.atomic():
            self.time = min(max(at, 0.0), self.run.duration)
            i = self.run.index(self.time)
            frame = self.run.frames[i]
            self.scene.show(frame)
            if self._follow is not None:
                self._follower.show(np.array([*frame.q[:2], 0.0]), self._follow.value)
            for growing in self._growing:
                growing.show(self.time)
            for panel in self._plots if plots else ():
                panel.show(i + 1)

    def loop(self, until: threading.Event) -> None:
        """Play as long as nobody ends it; returns when the event is set."""
        count, last = 0, time.monotonic()
        while not until.wait(_FRAME):
            now = time.monotonic()
            passed, last = now - last, now
            if not self.playing:
                continue
            count += 1
            at = self.time + passed * float(self._speed.value.split()[0])
            self.seek(at, plots=count % _PLOTS_EVERY == 0 or at >= self.run.duration)
            self._slider.value = round(self.time, 2)
            if self.time >= self.run.duration:
                self.play(False)


def _extent(run: Run) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of where the robot goes [m]."""
    points = [p[:, :2] for _, p in run.paths.values()] + [p[:, :2] for p in run.plans.values()]
    all_points = np.concatenate(points) if points else np.zeros((1, 2))
    return all_points.min(axis=0), all_points.max(axis=0)
