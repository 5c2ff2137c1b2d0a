"""Figures of a map: its closures, how well they fit, how uncertain its poses are, errors of relations by span."""

import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure

from longreach.evaluation import scan_map, style
from longreach.evaluation.relations import RelationErrors
from longreach.trajectory import PoseTrajectory

# What became of a closure: colour, line and width. Accepted ones are many, and do not hide the map.
STATUS = {
    "accepted": (style.GREEN, "solid", 0.6),
    "refused": (style.PURPLE, (0, (3, 2)), 0.6),
    "waiting": (style.ORANGE, (0, (3, 2)), 0.8),
    "withdrawn": (style.BLACK, (0, (1, 1)), 1.0),
}
_ELLIPSES = 60  # along a path
_SCALES = (1, 2, 5, 10, 20, 50, 100)  # of ellipses, so that they are seen


def closure_map(
    points: Float[np.ndarray, "n 2"],
    paths: Mapping[str, PoseTrajectory],
    closures: Mapping[str, Float[np.ndarray, "k 2 2"]],
) -> Figure:
    """Draw laser points [m], paths through them, and by status the lines (k, 2, 2) between the ends of closures."""
    fig, axes = scan_map.density(points, np.concatenate([path.poses[:, :2] for path in paths.values()]))
    for status, (colour, line, width) in STATUS.items():
        lines = closures.get(status, np.zeros((0, 2, 2)))
        if len(lines):
            label = f"{status} ({len(lines)})"
            drawn = LineCollection(list(lines), colors=colour, linestyles=[line], linewidths=width, label=label)
            axes.add_collection(drawn, autolim=False)
    _draw(axes, paths)
    return fig


def uncertainty_map(points: Float[np.ndarray, "n 2"], paths: Mapping[str, PoseTrajectory]) -> Figure:
    """Draw paths and 95 % ellipses of their positions, enlarged where they are too small to be seen."""
    along = np.concatenate([path.poses[:, :2] for path in paths.values()])
    fig, axes = scan_map.density(points, along, darkest=0.4)
    found = [row for path in paths.values() for row in _ellipses(path)]
    extent = float(np.max(np.ptp(along, axis=0), initial=1.0))
    largest = max((row[2] for row in found), default=0.0)
    scale = max((s for s in _SCALES if s * largest <= 0.1 * extent), default=1)
    if found:
        x, y, a, b, angle = np.array(found).T
        ellipses = EllipseCollection(
            scale * a, scale * b, np.degrees(angle), units="xy", offsets=np.column_stack([x, y]),
            offset_transform=axes.transData, facecolors="none", edgecolors=style.BLUE, linewidths=0.9,
        )  # fmt: skip
        axes.add_collection(ellipses, autolim=False)
        name = "95 % ellipse of the position" + (f", {scale} × as large" if scale > 1 else "")
        axes.plot([], [], "o", markerfacecolor="none", color=style.BLUE, label=name)
    _draw(axes, paths)
    return fig


def _draw(axes: Axes, paths: Mapping[str, PoseTrajectory]) -> None:
    for (_, path), look in zip(paths.items(), style.looks(paths).values(), strict=True):
        axes.plot(*style.thin(*path.poses[:, :2].T), color=look.colour, linewidth=1.0, label=f"path: {look.label}")
        style.mark_start(axes, path.poses)
    style.legend_above(axes)


def _ellipses(path: PoseTrajectory) -> list[tuple[float, float, float, float, float]]:
    """Return x, y, both diameters and the angle of 95 % ellipses at even distances along a path."""
    if path.covariance is None or len(path) == 0:
        return []
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path.poses[:, :2], axis=0).T))])
    rows, found = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], _ELLIPSES))), []
    for k in rows:
        x, y, t = path.poses[k]
        values, vectors = np.linalg.eigh(path.covariance[k, :2, :2])
        a, b = 2.0 * math.sqrt(5.991) * np.sqrt(np.maximum(values[::-1], 0.0))
        found.append((x, y, a, b, t + math.atan2(vectors[1, 1], vectors[0, 1])))
    return found


def closure_residuals(chi2: Mapping[str, Float[np.ndarray, " k"]], limit: float) -> Figure:
    """Draw which part of the closures fits the map as solved within each χ², by status, beside what is expected of it.

    limit: of χ², at which a closure is withdrawn.
    """
    from scipy.special import gammainc

    fig = style.figure(3.9, "")
    axes = style.panel(fig.add_subplot(), "χ² of a closure in the map, 3 degrees of freedom", "closures below [%]")
    x = np.geomspace(0.01, 1000.0, 200)
    axes.plot(x, 100 * gammainc(1.5, 0.5 * x), color="0.5", linewidth=1.4, linestyle=(0, (4, 2)), label="expected")
    for status, values in chi2.items():
        if len(values):
            part = 100 * np.arange(1.0, len(values) + 1.0) / len(values)
            shown = np.sort(np.clip(values, x[0], x[-1]))
            colour, line, _ = STATUS[status]
            axes.step(shown, part, where="post", color=colour, linestyle=line, linewidth=1.6,
                      label=f"{status} ({len(values)})")  # fmt: skip
    axes.axvline(limit, color="0.3", linewidth=0.8)
    axes.annotate("99.9 %", (limit, 4), textcoords="offset points", xytext=(4, 0), fontsize=style.TICK_SIZE)
    axes.set_xscale("log")
    style.plain_logarithmic(axes.xaxis)
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(0, 100)
    style.legend_above(axes)
    return fig


def errors_by_span(errors: Mapping[str, RelationErrors], short: float = 5.0, long: float = 60.0) -> Figure:
    """Draw the mean error of short relations, long ones and all, and the 99th percentile of all, a bar a trajectory."""
    fig = style.figure(3.9, "")
    names = (f"mean, up to {short:g} s", f"mean, over {long:g} s", "mean, all", "99th percentile, all")
    for axes, part, unit in zip(fig.subplots(1, 2), ("translation", "rotation"), ("m", "deg"), strict=True):
        for k, ((_, e), look) in enumerate(zip(errors.items(), style.looks(errors).values(), strict=True)):
            values = np.degrees(e.rotation) if part == "rotation" else e.translation
            groups = (values[e.span <= short], values[e.span > long], values)
            bars = [float(g.mean()) if len(g) else math.nan for g in groups]
            bars.append(float(np.percentile(values, 99)) if len(values) else math.nan)
            at = np.arange(len(names)) + (k - 0.5 * (len(errors) - 1)) * 0.8 / len(errors)
            drawn = axes.barh(at, np.nan_to_num(bars), 0.7 / len(errors), color=look.colour, label=look.label)
            axes.bar_label(drawn, [f"{bar:.3g}" if math.isfinite(bar) else "none" for bar in bars], padding=3,
                           fontsize=style.TICK_SIZE)  # fmt: skip
        style.panel(axes, f"{part} error [{unit}]", "")
        axes.set_yticks(np.arange(len(names)), names if part == "translation" else [""] * len(names))
        axes.invert_yaxis()
        axes.margins(x=0.2)
        axes.grid(visible=False, axis="y")
        if part == "translation":
            style.legend_above(axes)
    return fig
