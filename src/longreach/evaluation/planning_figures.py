"""Figures of optimised plans: figure 6.5 of the thesis, and how an optimisation converged."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from longreach.evaluation import style

_LEAST = 1e-16  # what a logarithmic axis shows of 0
_BAND = "#DDDDDD"


def optimised_against_not(
    measures: Mapping[str, Float[np.ndarray, " n"]],
    bases: Mapping[str, Float[np.ndarray, "n 3"]],
    tools: Mapping[str, Float[np.ndarray, "n 3"]],
    reference: Float[np.ndarray, "n 3"],
    radius: float,
    band: float,
    title: str = "",
    times: Float[np.ndarray, " n"] | None = None,
) -> Figure:
    """Draw figure 6.5: tool position, manipulability, base heading and base position of plans by name.

    Arguments: measures: manipulability at each waypoint; bases: [x, y, θ] [m, rad]; tools: positions [m]; reference:
        the base's, about which its tolerances radius [m] and band [rad] are shown; times: of the rows [s], else they
        are waypoints.
    """
    fig = style.figure(6.8, title)
    (tool, measure), (heading, position) = fig.subplots(2, 2)
    style.panel(tool, "x [m]", "tool y [m]")
    rows, row = (np.arange(len(reference)), "waypoint") if times is None else (times, "time [s]")
    style.panel(measure, row, "manipulability")
    style.panel(heading, row, "θ - θ_goal [rad]")
    style.panel(position, row, "base from goal [mm]")
    heading.fill_between(rows, -band, band, color=_BAND, zorder=0)
    position.fill_between(rows, 0.0, 1e3 * radius, color=_BAND, zorder=0)
    for name, look in style.looks(measures).items():
        drawn = {"color": look.colour, "linestyle": look.line, "linewidth": look.width, "label": look.label}
        off = bases[name] - reference
        tool.plot(tools[name][:, 0], tools[name][:, 1], **drawn)
        measure.plot(rows, measures[name], **drawn)
        heading.plot(rows, np.remainder(off[:, 2] + np.pi, 2.0 * np.pi) - np.pi, **drawn)
        position.plot(rows, 1e3 * np.linalg.norm(off[:, :2], axis=1), **drawn)
    tool.ticklabel_format(axis="y", useOffset=False)
    middle = float(np.mean([part[:, 1].mean() for part in tools.values()]))
    spread = max([0.05, *(float(np.abs(part[:, 1] - middle).max()) for part in tools.values())])
    tool.set_ylim(middle - 1.2 * spread, middle + 1.2 * spread)
    style.legend_above(measure)
    return fig


def convergence(history: Sequence[Mapping[str, float]], title: str = "") -> Figure:
    """Draw merit, violation, trust region and penalty after each iteration, as an SqpSolution's history has them."""
    fig = style.figure(5.4, title)
    rounds = np.arange(1, len(history) + 1)
    labels = {"merit": "merit above its last", "violation": "violation", "trust": "trust region", "penalty": "penalty"}
    for axes, (name, label) in zip(fig.subplots(2, 2, sharex=True).ravel(), labels.items(), strict=True):
        style.panel(axes, "iteration" if name in ("trust", "penalty") else "", label)
        values = np.array([row[name] for row in history], dtype=float)
        if name == "merit" and len(values):
            values = values - values[-1]
        axes.plot(rounds, np.maximum(values, _LEAST), color=style.BLUE, marker="o", markersize=3.5)
        axes.set_yscale("log")
        axes.margins(x=0.03)
    return fig
