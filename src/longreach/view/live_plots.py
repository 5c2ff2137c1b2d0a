"""Plots of a robot's last half minute; their axes only ever widen, so that nothing jumps."""

from collections import deque
from typing import Any

import numpy as np

from longreach.robot.manipulability import manipulability
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.view.curves import JOINT_COLOURS

_SPAN = 30.0  # [s]
_MOST = 700


class LivePlots:
    """Plots in the panel, of errors where the truth is known, deviations, speeds, manipulability and loop time."""

    def __init__(self, server: Any, robot: MobileManipulator) -> None:
        self._robot, self._rows = robot, deque(maxlen=_MOST)
        arm = [n.removesuffix("_joint").replace("_", " ") for n in robot.joint_names[robot.arm]]
        lines = {
            "Error of the estimate [mm]": (["base"], 1.0),
            "Standard deviation of the base [mm]": (["along", "across"], 1.0),
            "Joint velocity, of its limit [%]": (arm, 20.0),
            "Manipulability of the arm √det(JJᵀ) [1]": (["M"], 0.1),
            "Time of the robot's loop [ms]": (["loop"], 2.0),
        }
        self._plots: list[tuple[Any, list[float], int]] = []
        with server.gui.add_folder("Plots, the last 30 s"):
            for title, (names, highest) in lines.items():
                server.gui.add_html(f'<div style="font-size:.8em;font-weight:600;padding:.3em .6em 0">{title}</div>')
                series = [{"label": "t [s]"}]
                series += [
                    {"label": n, "stroke": JOINT_COLOURS[i % 7], "width": 1.6, "points": {"show": False}}
                    for i, n in enumerate(names)
                ]
                low = -highest if "of its limit" in title else 0.0
                grid = {"show": True, "stroke": "#e6e8eb", "width": 1}
                handle = server.gui.add_uplot(
                    (np.array([-_SPAN, 0.0]), *(np.zeros(2) for _ in names)), tuple(series), height=130,
                    scales=_scales(low, highest), axes=({"grid": grid, "size": 28}, {"grid": grid, "size": 44}),
                    legend={"show": len(names) > 1, "live": False}, padding=(8, 10, 0, 0),
                )  # fmt: skip
                self._plots.append((handle, [low, highest], len(names)))

    def take(self, state: Any, show: bool) -> None:
        """Keep a state, and draw."""
        robot = self._robot
        if self._rows and state.stamp <= self._rows[-1][0]:
            return
        off = 0.0 if state.truth is None else 1e3 * float(np.linalg.norm(state.q[:2] - state.truth[:2]))
        sigma = 1e3 * np.sqrt(np.maximum(np.diag(state.covariance)[:2], 0.0))
        speed = 100.0 * state.velocity[robot.arm] / robot.limits.velocity[robot.arm]
        m = float(manipulability(robot, state.q, "m", "arm")[0]) if robot.dof - robot.arm.start >= 6 else 0.0
        self._rows.append(np.array([state.stamp, off, *sigma, *speed, m, 1e3 * state.loop_time]))
        if show and len(self._rows) > 1:
            self._draw()

    def _draw(self) -> None:
        table = np.array(self._rows)
        t = table[:, 0] - table[-1, 0]
        table, t, at = table[t >= -_SPAN], t[t >= -_SPAN], 1
        for handle, span, count in self._plots:
            values = table[:, at : at + count]
            at += count
            highest, lowest = float(values.max()), float(values.min())
            if highest > span[1] or lowest < span[0]:
                span[1] = max(span[1], 1.3 * highest)
                span[0] = min(span[0], 1.3 * lowest)
                handle.scales = _scales(span[0], span[1])
            handle.data = (t, *values.T)


def _scales(low: float, high: float) -> dict[str, Any]:
    """Return fixed axes."""
    return {"x": {"time": False, "auto": False, "range": (-_SPAN, 0.0)}, "y": {"auto": False, "range": (low, high)}}
