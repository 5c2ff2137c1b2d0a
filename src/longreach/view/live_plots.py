"""Plots of a robot's last half minute; their axes only ever widen, so that nothing jumps."""

from collections import deque
from typing import Any, NamedTuple

import numpy as np

from longreach.evaluation import style
from longreach.robot.manipulability import manipulability
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.view.curves import JOINT_COLOURS

_SPAN = 30.0  # [s]
_MOST = 700
_ERROR, _TOOL_ERROR = "Error of the base's estimate [mm]", "Error of the tool's estimate [mm]"


class _Plot(NamedTuple):
    handles: tuple[Any, Any]
    span: list[float]
    curves: int


class LivePlots:
    """Plots in the panel, of errors where the truth is known, deviations, speeds, manipulability and loop time.

    A value that is not known is left out, and so is a plot of which none is.
    """

    def __init__(self, server: Any, robot: MobileManipulator) -> None:
        self._robot, self._server, self._rows = robot, server, deque(maxlen=_MOST)
        arm = [n.removesuffix("_joint").replace("_", " ") for n in robot.joint_names[robot.arm]]
        self._plots: list[_Plot] = []
        with server.gui.add_folder("Plots, the last 30 s"):
            self._add(_ERROR, {"error": style.BLUE, "3σ as stated": style.SKY}, 1.0)
            self._add(_TOOL_ERROR, {"error": style.GREEN}, 1.0)
            self._add("Standard deviation of the base [mm]", {"along": style.BLUE, "across": style.ORANGE}, 1.0)
            self._add("Standard deviation of the heading [°]", {"heading": style.BLUE}, 0.05)
            colours = {name: JOINT_COLOURS[i % 7] for i, name in enumerate(arm)}
            self._add("Joint velocity, of its limit [%]", colours, 20.0, -20.0)
            self._add("Manipulability of the arm √det(JJᵀ) [m³]", {"M": style.GREEN}, 0.1)
            self._add("Time of the robot's loop [ms]", {"loop": style.BLUE}, 2.0)

    def _add(self, title: str, curves: dict[str, str], highest: float, lowest: float = 0.0) -> None:
        gui = self._server.gui
        heading = gui.add_html(
            f'<div style="font-size:.8em;font-weight:600;padding:.3em .6em 0">{title}</div>', visible=False
        )
        series = [{"label": "t [s]"}]
        series += [{"label": n, "stroke": c, "width": 1.6, "points": {"show": False}} for n, c in curves.items()]
        grid = {"show": True, "stroke": "#e6e8eb", "width": 1}
        handle = gui.add_uplot(
            (np.array([-_SPAN, 0.0]), *(np.zeros(2) for _ in curves)), tuple(series), height=130, visible=False,
            scales=_scales(lowest, highest), axes=({"grid": grid, "size": 28}, {"grid": grid, "size": 44}),
            legend={"show": len(curves) > 1, "live": False}, padding=(8, 10, 0, 0),
        )  # fmt: skip
        self._plots.append(_Plot((heading, handle), [lowest, highest], len(curves)))

    def take(self, state: Any, show: bool) -> None:
        """Keep a state, and draw."""
        robot = self._robot
        if self._rows and state.stamp <= self._rows[-1][0]:
            return
        off = tool_off = m = np.nan
        if state.truth is not None:
            off = 1e3 * float(np.linalg.norm(state.q[:2] - state.truth[:2]))
        if state.tool_truth is not None:
            tool_off = 1e3 * float(np.linalg.norm(robot.forward(state.q)[:3, 3] - state.tool_truth[:3, 3]))
        if robot.dof - robot.arm.start >= 6:
            m = float(manipulability(robot, state.q, "m", "arm")[0])
        sigma = np.sqrt(np.maximum(np.diag(state.covariance), 0.0))
        bound = 3e3 * float(np.sqrt(max(np.linalg.eigvalsh(state.covariance[:2, :2])[-1], 0.0)))
        speed = 100.0 * state.velocity[robot.arm] / robot.limits.velocity[robot.arm]
        deviations = [1e3 * sigma[0], 1e3 * sigma[1], np.degrees(sigma[2])]
        self._rows.append(np.array([state.stamp, off, bound, tool_off, *deviations, *speed, m, 1e3 * state.loop_time]))
        if show and len(self._rows) > 1:
            self._draw()

    def _draw(self) -> None:
        table = np.array(self._rows)
        t = table[:, 0] - table[-1, 0]
        table, t, at = table[t >= -_SPAN], t[t >= -_SPAN], 1
        for (heading, handle), span, count in self._plots:
            known = np.isfinite(table[:, at : at + count]).all(axis=1)
            values = table[known, at : at + count]
            at += count
            if len(values) < 2 or not count:
                continue
            if not handle.visible:
                heading.visible = handle.visible = True
            highest, lowest = float(values.max()), float(values.min())
            if highest > span[1] or lowest < span[0]:
                span[1] = max(span[1], 1.3 * highest)
                span[0] = min(span[0], 1.3 * lowest)
                handle.scales = _scales(span[0], span[1])
            handle.data = (t[known], *values.T)


def _scales(low: float, high: float) -> dict[str, Any]:
    """Return fixed axes."""
    return {"x": {"time": False, "auto": False, "range": (-_SPAN, 0.0)}, "y": {"auto": False, "range": (low, high)}}
