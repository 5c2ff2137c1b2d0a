"""Figures of executed plans: where tool and base were and were thought to be (figure 6.4), and how far off that was."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from longreach.evaluation import style
from longreach.evaluation.execution import Traces

_REFERENCE = style.Look("reference", "0.65", "solid", 4.0)
_ESTIMATE = style.Look("estimate", style.BLUE, (0, (5, 1.5)), 1.6)
_TRUTH = style.Look("truth", style.BLACK, "solid", 1.6)
_COLOURS = (style.VERMILION, style.BLUE, style.GREEN)
_LINES = ("solid", (0, (5, 1.5)), (0, (1.2, 1.2)))


def tool_and_base(traces: Traces, title: str = "") -> Figure:
    """Draw figure 6.4: the tool seen from three sides, and the base from above; truth, estimate and reference.

    The tool is drawn along and across its own line, from where it was to begin: what is across in mm, to be seen.
    """
    fig = style.figure(6.6, title)
    (above, side), (behind, base) = fig.subplots(2, 2)
    tools = {
        _REFERENCE: traces.tool_reference[:, :3, 3],
        _TRUTH: traces.tool_truth[:, :3, 3],
        _ESTIMATE: traces.tool_estimate[:, :3, 3],
    }
    bases = {_REFERENCE: traces.base_reference, _TRUTH: traces.base_truth, _ESTIMATE: traces.base_estimate}
    start = traces.tool_reference[0, :3, 3]
    for look, p in tools.items():
        along, across, up = (p - start).T
        _line(above, look, along, 1e3 * across)
        _line(side, look, along, 1e3 * up)
        _line(behind, look, 1e3 * across, 1e3 * up)
    for look, pose in bases.items():
        _line(base, look, pose[:, 0], pose[:, 1])
    style.panel(above, "tool x [m]", "tool y [mm]")
    style.panel(side, "tool x [m]", "tool z [mm]")
    style.panel(behind, "tool y [mm]", "tool z [mm]")
    style.panel(base, "base x [m]", "base y [m]")
    base.set_aspect("equal", adjustable="datalim")
    for axes in (above, side, behind):
        _at_least(axes, 5.0)
    style.legend_above(above)
    return fig


def _line(axes: Axes, look: style.Look, x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> None:
    x, y = style.thin(x, y)
    axes.plot(x, y, color=look.colour, linestyle=look.line, linewidth=look.width, label=look.label)


def _at_least(axes: Axes, half: float) -> None:
    """Let the vertical axis show `half` to both sides of its middle at least: noise is not to fill the panel."""
    low, high = axes.get_ylim()
    middle = 0.5 * (low + high)
    axes.set_ylim(min(low, middle - half), max(high, middle + half))


def tool_errors(traces: Mapping[str, Traces], title: str = "") -> Figure:
    """Draw over time how far the tool was from its plan, a line a run, and how well the first run knew where it was.

    Below, the truth from the estimate in the tool's own axes with the ±3σ that was stated for it.
    """
    fig = style.figure(6.6, title)
    grid = fig.add_gridspec(2, 3, height_ratios=(1.2, 1.0))
    axes = fig.add_subplot(grid[0, :])
    for k, (name, t) in enumerate(traces.items()):
        off = np.linalg.norm((t.tool_truth - t.tool_reference)[:, :3, 3], axis=1)
        x, y = style.thin(t.stamps - t.stamps[0], 1e3 * off)
        axes.plot(x, y, color=_COLOURS[k % 3], linestyle=_LINES[k % 3], linewidth=1.6, label=name)
    style.panel(axes, "time [s]", "tool from plan [mm]")
    axes.margins(x=0.01)
    axes.set_ylim(bottom=0.0)
    style.legend_above(axes)
    first = next(iter(traces.values()))
    t = first.stamps - first.stamps[0]
    off = np.einsum("nji,nj->ni", first.tool_estimate[:, :3, :3], (first.tool_truth - first.tool_estimate)[:, :3, 3])
    sigma = np.sqrt(np.maximum(np.einsum("nii->ni", first.tool_covariance[:, :3, :3]), 0.0))
    for i, name in enumerate("xyz"):
        panel = style.panel(fig.add_subplot(grid[1, i]), "time [s]", f"estimate's error, {name} [mm]")
        panel.fill_between(t, -3e3 * sigma[:, i], 3e3 * sigma[:, i], color="#DDDDDD", zorder=0)
        panel.plot(*style.thin(t, 1e3 * off[:, i]), color=style.BLUE, linewidth=1.2)
        panel.margins(x=0.01)
        _at_least(panel, 1.0)
    return fig


EXECUTION_CAPTIONS = {
    "tool_and_base": "Where the tool (three views) and the base (from above) were, were thought to be, and should be "
    "(figure 6.4). What the tool does across its line is in millimetres.",
    "tool_errors": "Above: how far the hand really was from its path. Below: how far it was from where the robot "
    "thought it was, in the hand's own axes; grey is the ±3σ that the estimate stated.",
    "executed": "Optimised against not optimised, as executed (figure 6.5); grey: what the base's tolerances allow.",
}
