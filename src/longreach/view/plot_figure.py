"""The plots of a run as one figure, for where there is no page that draws them."""

import io

import matplotlib as mpl
from matplotlib.figure import Figure

from longreach.evaluation import style
from longreach.view.frame import Run

_HEIGHT = 1.9  # of a panel [inch]
_POINTS = 600  # of a curve


def figure(run: Run) -> Figure:
    """Return one panel a plot, all over the same time."""
    fig = style.figure(_HEIGHT * len(run.plots) + 0.4, "")
    panels = fig.subplots(len(run.plots), sharex=True, squeeze=False)[:, 0]
    step = max(1, len(run.times) // _POINTS)
    for axes, plot in zip(panels, run.plots, strict=True):
        style.panel(axes, "", "")
        for curve in plot.curves:
            axes.plot(run.times[::step], curve.values[::step], color=curve.colour, linewidth=1.3, label=curve.name)
        axes.set_ylim(plot.lowest, plot.highest)
        axes.margins(x=0.01)
        axes.set_title(plot.title, fontsize=style.LABEL_SIZE, loc="left", pad=18 if len(plot.curves) > 1 else 6)
        if len(plot.curves) > 1:
            axes.legend(
                loc="lower left", bbox_to_anchor=(0, 1.0), ncols=len(plot.curves), frameon=False,
                fontsize=style.TICK_SIZE - 1, handlelength=1.6, columnspacing=1.2, borderaxespad=0.1,
            )  # fmt: skip
    panels[-1].set_xlabel("time [s]", fontsize=style.LABEL_SIZE)
    fig.align_ylabels()
    return fig


def svg(run: Run) -> bytes:
    """Return the figure as an SVG file, its text as text."""
    out = io.BytesIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "longreach", "font.family": "sans-serif"}):
        figure(run).savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()
