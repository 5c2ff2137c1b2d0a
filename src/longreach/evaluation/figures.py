"""The figures of a report: figures 6.2 and 6.3 of the thesis, the relations metric, and how honest the filter is."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from longreach.evaluation import style
from longreach.evaluation.consistency import Consistency, PoseErrors, chi2_bounds
from longreach.evaluation.metrics import SquaredErrors
from longreach.evaluation.relations import RelationErrors
from longreach.trajectory import PoseTrajectory

_FLAT = 30  # a curve this many times below another is not seen beside it
_NIS_WINDOW = 100  # innovations in a running mean: its χ² band is then narrow enough to judge by


def paths(trajectories: Mapping[str, PoseTrajectory], title: str = "") -> Figure:
    """Draw paths in one plane at one scale, as figure 6.2 does; the truth lies under all others."""
    drawn = {name: t for name, t in trajectories.items() if len(t)}
    positions = [t.poses[:, :2] for t in drawn.values()] or [np.zeros((1, 2))]
    corners = np.stack((np.min([p.min(0) for p in positions], axis=0), np.max([p.max(0) for p in positions], axis=0)))
    fig = style.figure(style.plane_height(corners), title)
    axes = style.panel(fig.add_subplot(), "x [m]", "y [m]")
    for (name, trajectory), look in zip(drawn.items(), style.looks(drawn).values(), strict=True):
        x, y = style.thin(trajectory.poses[:, 0], trajectory.poses[:, 1])
        order = 2.0 if name == "truth" else 2.5
        axes.plot(x, y, color=look.colour, linestyle=look.line, linewidth=look.width, label=look.label, zorder=order)
    for trajectory in drawn.values():
        style.mark_start(axes, trajectory.poses)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.05)
    style.legend_above(axes)
    return fig


def squared_errors(errors: Mapping[str, SquaredErrors], title: str = "") -> Figure:
    """Draw the mean squared errors from the start to each instant, as figure 6.3 does.

    Position above, heading below where it is known; the squared errors themselves stand pale behind. The scale is
    logarithmic where a linear one would lay one of the curves on the axis.
    """
    headings = any(e.heading is not None for e in errors.values())
    fig = style.figure(6.2 if headings else 3.6, title)
    panels = np.atleast_1d(fig.subplots(2 if headings else 1, sharex=True))
    start = min((e.clock[0] for e in errors.values() if len(e.clock)), default=0.0)
    for (_, e), look in zip(errors.items(), style.looks(errors).values(), strict=True):
        series = [(e.position, e.position_mean), (e.heading, e.heading_mean)][: len(panels)]
        for axes, (squared, mean) in zip(panels, series, strict=True):
            if squared is None or mean is None:
                continue
            t, squared, mean = style.thin(e.clock - start, squared, mean)
            axes.plot(t, squared, color=look.colour, linewidth=0.8, alpha=0.3)
            axes.plot(t, mean, color=look.colour, linestyle=look.line, linewidth=look.width, label=look.label)
    for axes, label in zip(panels, ("position MSE [m²]", "heading MSE [rad²]"), strict=False):
        style.panel(axes, "", label)
        axes.margins(x=0.01)
        _show_all(axes, [e.heading_mean if axes is not panels[0] else e.position_mean for e in errors.values()])
    panels[0].plot([], [], color="0.7", linewidth=0.8, label="squared errors")
    panels[-1].set_xlabel("time [s]", fontsize=style.LABEL_SIZE)
    style.legend_above(panels[0])
    fig.align_ylabels()
    return fig


def _show_all(axes: Axes, means: Sequence[Float[np.ndarray, " _"] | None]) -> None:
    """Start the scale at 0, or make it logarithmic where the last values are too far apart for that."""
    last = [float(mean[-1]) for mean in means if mean is not None and len(mean) and mean[-1] > 0]
    axes.set_ylim(bottom=0)
    if last and max(last) > _FLAT * min(last):
        axes.set_yscale("log")
        axes.set_ylim(bottom=min(last) / 100)
        style.plain_logarithmic(axes.yaxis)


def error_with_bounds(errors: PoseErrors, title: str = "", name: str = "fused") -> Figure:
    """Draw the error in x, y and θ of the body frame, and the band of ±3 standard deviations that should hold it."""
    fig = style.figure(6.8, title)
    look = style.looks({name: None})[name]
    labels = ("x error [m]", "y error [m]", "θ error [deg]")
    time = errors.clock - errors.clock[:1]
    for i, (axes, label) in enumerate(zip(fig.subplots(3, sharex=True), labels, strict=True)):
        scale = np.degrees(1.0) if i == 2 else 1.0
        deviation = np.sqrt(np.maximum(errors.covariance[:, i, i], 0.0))
        t, xi, band = style.thin(time, scale * errors.xi[:, i], 3 * scale * deviation)
        axes.fill_between(t, -band, band, color=style.SKY, alpha=0.3, linewidth=0, label="±3σ as stated")
        axes.plot(t, xi, color=look.colour, linewidth=1.2, label=f"error: {look.label}")
        style.panel(axes, "time [s]" if i == 2 else "", label)
        axes.margins(x=0.01)
        if i == 0:
            style.legend_above(axes)
    fig.align_ylabels()
    return fig


def relation_distributions(errors: Mapping[str, RelationErrors], title: str = "") -> Figure:
    """Draw which part of the relations has an error below each value, translation beside rotation."""
    fig = style.figure(3.9, title)
    left, right = fig.subplots(1, 2, sharey=True)
    smallest = {left: 1e-3, right: 1e-2}  # smaller errors are drawn at the edge
    for (_, e), look in zip(errors.items(), style.looks(errors).values(), strict=True):
        for axes, values in ((left, e.translation), (right, np.degrees(e.rotation))):
            part = np.arange(1.0, len(values) + 1.0) / max(len(values), 1)
            x, y = style.thin(np.sort(np.maximum(values, smallest[axes])), 100 * part)
            axes.plot(x, y, color=look.colour, linestyle=look.line, linewidth=look.width, label=look.label)
    style.panel(left, "translation error [m]", "relations with a smaller error [%]")
    style.panel(right, "rotation error [deg]", "")
    for axes in (left, right):
        axes.axhline(50, color="0.5", linewidth=0.8, linestyle=(0, (1, 2)))
        axes.set_xscale("log")
        style.plain_logarithmic(axes.xaxis)
        axes.set_xlim(left=smallest[axes])
    left.set_ylim(0, 100)
    style.legend_above(left)
    return fig


def _running_mean(values: Float[np.ndarray, " n"], window: int) -> Float[np.ndarray, " m"]:
    total = np.concatenate(([0.0], np.cumsum(values)))
    return (total[window:] - total[:-window]) / window


def _innovation_panel(axes: Axes, time: Float[np.ndarray, " n"], nis: Consistency, look: style.Look) -> None:
    n = len(nis.values)
    window = min(_NIS_WINDOW, n)
    if window == 0:
        return
    dof = float(np.mean(nis.dof))
    low, high = chi2_bounds(dof, window)
    t, values = style.thin(time, np.maximum(nis.values, 1e-3 * dof))
    axes.plot(t, values, ".", color="0.75", markersize=2, zorder=1.5, label="one innovation")
    axes.axhspan(low, high, color=style.SKY, alpha=0.4, linewidth=0, label=f"95 % band of a mean of {window}")
    t, mean = style.thin(_running_mean(time, window), _running_mean(nis.values, window))
    marker = "o" if window == n else None
    axes.plot(t, mean, color=look.colour, linewidth=1.6, marker=marker, label=f"running mean of {window}")
    axes.axhline(dof, color="0.3", linewidth=0.8, linestyle=(0, (4, 2)))


def innovation(nis: Mapping[str, Consistency], title: str = "") -> Figure:
    """Draw each source's normalised innovation squared and its running mean against the χ² band.

    The running mean stays in the band where the filter's covariances are honest; above it they are too small, below
    too large.
    """
    fig = style.figure(0.9 + 2.5 * max(len(nis), 1), title)
    start = min((c.clock[0] for c in nis.values() if len(c.clock)), default=0.0)
    panels = np.atleast_1d(fig.subplots(max(len(nis), 1), sharex=True))
    for axes, (source, consistency), look in zip(panels, nis.items(), style.looks(nis).values(), strict=False):
        _innovation_panel(axes, consistency.clock - start, consistency, look)
        axes.set_yscale("log")
        style.plain_logarithmic(axes.yaxis)
        style.panel(axes, "", f"NIS, {source} [–]")
        axes.margins(x=0.01)
        style.legend_above(axes)
    panels[-1].set_xlabel("time [s]", fontsize=style.LABEL_SIZE)
    fig.align_ylabels()
    return fig
