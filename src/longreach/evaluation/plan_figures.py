"""The figures of a plan: paths of tool and base (figure 6.4), joints, velocities, manipulability, tasks' errors."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from longreach.configuration import ConfigurationTrajectory, TaskReport
from longreach.evaluation import style

_TOOL = style.Look("tool", style.VERMILION, "solid")
_BASE = style.Look("base", style.BLUE, "solid")
_LEAST = 1e-16  # errors below are drawn there
_COLOURS = (
    style.BLUE,
    style.ORANGE,
    style.GREEN,
    style.VERMILION,
    style.PURPLE,
    style.SKY,
    style.BLACK,
    "0.5",
    "#8C564B",
)
_LINES = ("solid", (0, (5, 1.5)), (0, (1.2, 1.2)))

Path2 = Float[np.ndarray, "_ 2"] | None


def plan_paths(tool: Path2, tool_reference: Path2, base: Path2, base_reference: Path2, title: str = "") -> Figure:
    """Draw where tool and base go, seen from above, over where they should; None is left out."""
    given = [path for path in (tool, tool_reference, base, base_reference) if path is not None]
    points = np.concatenate(given)
    fig = style.figure(style.plane_height(np.stack([points.min(axis=0), points.max(axis=0)])), title)
    axes = style.panel(fig.add_subplot(), "x [m]", "y [m]")
    for what, look, path, reference in (("tool", _TOOL, tool, tool_reference), ("base", _BASE, base, base_reference)):
        if reference is not None:
            axes.plot(*reference.T, color="0.6", linewidth=4.0, solid_capstyle="round", label=f"{what}: reference")
        if path is not None:
            axes.plot(*path.T, color=look.colour, linewidth=look.width, label=f"{what}: plan")
            axes.plot(*path[0], "o", color=style.BLACK, markerfacecolor="white", markersize=6, zorder=4)
    axes.plot([], [], "o", color=style.BLACK, markerfacecolor="white", markersize=6, label="start")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.05)
    style.legend_above(axes)
    return fig


def joints(trajectory: ConfigurationTrajectory, prismatic: Sequence[bool], title: str = "") -> Figure:
    """Draw all joints over time, prismatic ones above, the others below."""
    fig = style.figure(6.2, title)
    panels = fig.subplots(2, sharex=True)
    t = trajectory.stamps - trajectory.stamps[0]
    for axes, kind, label, scale in (
        (panels[0], True, "prismatic joints [m]", 1.0),
        (panels[1], False, "revolute joints [deg]", 180 / np.pi),
    ):
        _curves(
            axes,
            t,
            trajectory.q,
            trajectory.joint_names,
            [i for i, p in enumerate(prismatic) if bool(p) is kind],
            scale,
        )
        style.panel(axes, "", label)
    panels[1].set_xlabel("time [s]", fontsize=style.LABEL_SIZE)
    fig.align_ylabels()
    return fig


def velocities(trajectory: ConfigurationTrajectory, limits: Float[np.ndarray, " n"], title: str = "") -> Figure:
    """Draw each joint's speed as a share of its limit, which a robot can follow up to 100 %."""
    fig = style.figure(4.0, title)
    axes = fig.add_subplot()
    t = trajectory.stamps - trajectory.stamps[0]
    share = trajectory.velocities / limits
    _curves(axes, t, share, trajectory.joint_names, list(range(share.shape[1])), 100.0)
    for bound in (-100, 100):
        axes.axhline(bound, color="0.3", linewidth=0.9, linestyle=(0, (4, 2)))
    style.panel(axes, "time [s]", "speed [% of the joint's limit]")
    return fig


def _curves(
    axes: Axes, t: np.ndarray, values: np.ndarray, names: Sequence[str], which: list[int], scale: float
) -> None:
    for k, i in enumerate(which):
        x, y = style.thin(t, scale * values[:, i])
        colour, line = _COLOURS[k % len(_COLOURS)], _LINES[(k // 3) % len(_LINES)]
        axes.plot(x, y, color=colour, linestyle=line, linewidth=1.6, label=names[i] if names else f"joint {i}")
    axes.margins(x=0.01)
    _legend(axes)


def _legend(axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    if labels:
        axes.legend(
            handles, labels, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=style.TICK_SIZE
        )


def manipulability(
    stamps: Float[np.ndarray, " n"], values: Mapping[str, Float[np.ndarray, " n"]], title: str = ""
) -> Figure:
    """Draw a measure of manipulability over time for each of the plans."""
    fig = style.figure(3.6, title)
    axes = fig.add_subplot()
    for k, (name, m) in enumerate(values.items()):
        x, y = style.thin(stamps - stamps[0], m)
        axes.plot(x, y, color=_COLOURS[k], linestyle=_LINES[k % len(_LINES)], linewidth=1.6, label=name)
    style.panel(axes, "time [s]", "manipulability M [m³]")
    axes.margins(x=0.01)
    style.legend_above(axes)
    return fig


def task_errors(stamps: Float[np.ndarray, " n"], reports: Sequence[TaskReport], title: str = "") -> Figure:
    """Draw the size of each task's error over time, on a logarithmic scale; where it is not met, with a marker."""
    fig = style.figure(6.0, title)
    panels = fig.subplots(2, sharex=True)
    t = stamps - stamps[0]
    for k, report in enumerate(reports):
        for axes, error in ((panels[0], report.linear), (panels[1], report.angular)):
            if np.any(error > 0):
                size = np.maximum(error, _LEAST)
                axes.plot(t, size, color=_COLOURS[k], linestyle=_LINES[k % 3], linewidth=1.6, label=report.name)
                axes.plot(t[report.unmet], size[report.unmet], ".", color=_COLOURS[k], markersize=4)
    for axes, label in zip(panels, ("position error [m]", "angle error [rad]"), strict=True):
        axes.set_yscale("log")
        style.panel(axes, "", label)
        axes.margins(x=0.01)
    style.legend_above(panels[0])
    panels[1].set_xlabel("time [s]", fontsize=style.LABEL_SIZE)
    fig.align_ylabels()
    return fig


PLAN_CAPTIONS = {
    "paths": "Tool and base from above: the plan over the reference, which is drawn broad and grey.",
    "joints": "All joints along the plan.",
    "velocities": "How fast each joint moves, as a share of its limit. Beyond ±100 % the robot cannot follow.",
    "manipulability": "How well the whole body can move the tool in all directions; 0 at a singularity.",
    "optimised": "Optimised against not optimised (figure 6.5); grey: what the base's tolerances allow.",
    "convergence": "How the optimisation came to its end, iteration by iteration.",
    "task_errors": "What is left of each task's error; dots mark where it is more than what counts as met.",
}
