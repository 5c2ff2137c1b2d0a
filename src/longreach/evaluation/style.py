"""How figures look: colours that a colour-blind reader can tell apart, with a line style each; no global state."""

import io
import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

WIDTH = 8.0  # [inch]; shown in a report 768 pixels wide, 10 pt text then has the size of the text around it
LABEL_SIZE = 10
TICK_SIZE = 9
_DPI = 150
_MOST_POINTS = 5000  # of a line: more than pixels across the figure


class Look(NamedTuple):
    """Name in the legend, colour, and line of one trajectory."""

    label: str
    colour: str
    line: Any
    width: float = 1.6


# Okabe & Ito 2008, "Color universal design".
BLACK, ORANGE, SKY, GREEN, BLUE, VERMILION, PURPLE = (
    "#000000",
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
_LOOKS = {
    "truth": Look("truth (GT)", BLACK, "solid", 2.2),
    "wheels": Look("wheels (W)", ORANGE, (0, (5, 1.5))),
    "lidar": Look("LIDAR (L)", GREEN, (0, (5, 1.5, 1.2, 1.5))),
    "fused": Look("fused", BLUE, "solid"),
    "mapped": Look("mapped", VERMILION, "solid"),
}
_OTHERS = ((VERMILION, (0, (1.2, 1.2))), (PURPLE, (0, (8, 2))), (SKY, (0, (3, 1, 1, 1, 1, 1))))


def looks(names: Mapping[str, Any]) -> dict[str, Look]:
    """Return the look of each name: its own for truth, wheels, lidar and fused, and a free one for any other."""
    others = [name for name in names if name not in _LOOKS]
    free = {name: Look(name, *_OTHERS[i % len(_OTHERS)]) for i, name in enumerate(others)}
    return {name: _LOOKS.get(name) or free[name] for name in names}


def figure(height: float, title: str) -> Figure:
    """Return an empty figure of the report's width that makes room for all its text."""
    fig = Figure(figsize=(WIDTH, height), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(fig)
    if title:
        fig.suptitle(title, fontsize=LABEL_SIZE + 2)
    return fig


def panel(axes: Axes, xlabel: str, ylabel: str) -> Axes:
    """Label axes with quantity and unit, and put a quiet grid under the data."""
    axes.set_xlabel(xlabel, fontsize=LABEL_SIZE)
    axes.set_ylabel(ylabel, fontsize=LABEL_SIZE)
    axes.tick_params(labelsize=TICK_SIZE)
    axes.grid(color="0.88", linewidth=0.7)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return axes


def mark_start(axes: Axes, poses: Float[np.ndarray, "n 3"]) -> None:
    """Put a white disc on the first position; the legend names it once."""
    if len(poses):
        known = axes.get_legend_handles_labels()[1]
        label = "_start" if "start" in known else "start"  # matplotlib leaves names with _ out of a legend
        axes.plot(*poses[0, :2], "o", color=BLACK, markerfacecolor="white", markersize=7, zorder=4, label=label)


def legend_above(axes: Axes) -> None:
    """Put the legend in one row above the axes, where it hides nothing."""
    handles, labels = axes.get_legend_handles_labels()
    if labels:
        axes.legend(
            handles, labels, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=min(len(labels), 5), frameon=False,
            fontsize=TICK_SIZE, handlelength=2.6, columnspacing=1.4, borderaxespad=0.2,
        )  # fmt: skip


def plain_logarithmic(axis: Axis) -> None:
    """Write the ticks of a logarithmic axis as 0.1, 1, 10."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def plane_height(extent: Float[np.ndarray, "2 2"]) -> float:
    """Return the height [inch] of a figure that shows the rectangle, corners (low, high), at one scale."""
    across, up = np.maximum(extent[1] - extent[0], 1e-9)
    return float(np.clip((WIDTH - 0.8) * up / across, 3.2, 7.6)) + 1.2  # the margins hold ticks, labels and legend


def thin(*columns: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return every k-th row of the columns, and the last, so that at most some 5000 are drawn."""
    n = len(columns[0])
    rows = np.arange(0, n, max(1, math.ceil(n / _MOST_POINTS)))
    if n and rows[-1] != n - 1:
        rows = np.append(rows, n - 1)
    return tuple(column[rows] for column in columns)


def png(fig: Figure) -> bytes:
    """Return the figure as a PNG file."""
    out = io.BytesIO()
    fig.savefig(out, format="png", dpi=_DPI)
    return out.getvalue()
