"""The figures of an estimate in space: where the base went, and how high, tilted and turned it was, with ±3σ."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from longreach.evaluation import style

CAPTIONS = {
    "plane": "The path in the plane. Ellipses hold the position with three standard deviations, as stated.",
    "height": "Height, and the band of ±3σ that the filter stated for it.",
    "angles": "Roll, pitch and yaw, full turns counted, and the band of ±3σ that the filter stated for them.",
    "velocity": "Velocity and rates of the base in its own axes.",
    "innovation": "How surprised the filter was by each source. The running mean stays in the band when the "
    "covariances are of the right size; above it they are too small, below it too large.",
}
_ELLIPSES = 12  # along the path; more hide it
_GAP = 1.0  # [s] from row to row; a line across more would be made up


def plane(states: Float[np.ndarray, "n 15"], covariance: Float[np.ndarray, "n 6 6"], title: str = "") -> Figure:
    """Draw the path in the plane; covariance is that of position and angles in the world."""
    xy = states[:, :2]
    fig = style.figure(style.plane_height(np.stack((xy.min(axis=0), xy.max(axis=0)))), title)
    axes = style.panel(fig.add_subplot(), "x [m]", "y [m]")
    look = style.looks({"fused": None})["fused"]
    for i in np.linspace(0, len(xy) - 1, min(_ELLIPSES, len(xy))).astype(int).tolist():
        variance, axis = np.linalg.eigh(covariance[i, :2, :2])
        across, along = 6 * np.sqrt(np.maximum(variance, 0.0))
        angle = float(np.degrees(np.arctan2(axis[1, 1], axis[0, 1])))
        axes.add_patch(Ellipse((xy[i, 0], xy[i, 1]), along, across, angle=angle, color=style.SKY, alpha=0.3, lw=0))
    axes.add_patch(Ellipse((np.nan, np.nan), 0, 0, color=style.SKY, alpha=0.3, lw=0, label="±3σ as stated"))
    axes.plot(*style.thin(xy[:, 0], xy[:, 1]), color=look.colour, linewidth=look.width, label=look.label)
    style.mark_start(axes, states[:, [0, 1, 5]])
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.05)
    style.legend_above(axes)
    return fig


def height(
    stamps: Float[np.ndarray, " n"],
    states: Float[np.ndarray, "n 15"],
    covariance: Float[np.ndarray, "n 6 6"],
    title: str = "",
) -> Figure:
    """Draw z over time."""
    return _banded(stamps, states[:, 2:3], _deviation(covariance)[:, 2:3], ("z [m]",), title)


def angles(
    stamps: Float[np.ndarray, " n"],
    states: Float[np.ndarray, "n 15"],
    covariance: Float[np.ndarray, "n 6 6"],
    title: str = "",
) -> Figure:
    """Draw roll, pitch and yaw over time."""
    rho, sigma = np.degrees(np.unwrap(states[:, 3:6], axis=0)), np.degrees(_deviation(covariance)[:, 3:])
    return _banded(stamps, rho, sigma, ("roll [deg]", "pitch [deg]", "yaw [deg]"), title)


def velocity(stamps: Float[np.ndarray, " n"], states: Float[np.ndarray, "n 15"], title: str = "") -> Figure:
    """Draw the twist over time, linear above, angular below."""
    fig = style.figure(5.6, title)
    colours = (style.BLUE, style.VERMILION, style.GREEN)
    labels = (("v_x", "v_y", "v_z"), ("ω_x", "ω_y", "ω_z"))
    units = ("velocity [m/s]", "rates [rad/s]")
    for axes, first, names, unit in zip(fig.subplots(2, sharex=True), (6, 9), labels, units, strict=True):
        for i, (name, colour) in enumerate(zip(names, colours, strict=True)):
            t, v = style.thin(stamps - stamps[0], states[:, first + i])
            axes.plot(t, v, color=colour, linewidth=1.0, label=name)
        style.panel(axes, "time [s]" if first == 9 else "", unit)
        axes.margins(x=0.01)
        style.legend_above(axes)
    fig.align_ylabels()
    return fig


def _deviation(covariance: Float[np.ndarray, "n 6 6"]) -> Float[np.ndarray, "n 6"]:
    return np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))


def _banded(stamps: np.ndarray, values: np.ndarray, sigma: np.ndarray, labels: Sequence[str], title: str) -> Figure:
    fig = style.figure(1.2 + 2.0 * len(labels), title)
    panels = np.atleast_1d(fig.subplots(len(labels), sharex=True))
    for i, (axes, label) in enumerate(zip(panels, labels, strict=True)):
        t, middle, band, before = style.thin(
            stamps - stamps[0], values[:, i], 3 * sigma[:, i], np.diff(stamps, prepend=stamps[:1])
        )
        middle = np.where(before > _GAP, np.nan, middle)
        axes.fill_between(
            t, middle - band, middle + band, color=style.SKY, alpha=0.3, linewidth=0, label="±3σ as stated"
        )
        axes.plot(t, middle, color=style.BLUE, linewidth=1.2, label="fused")
        style.panel(axes, "time [s]" if axes is panels[-1] else "", label)
        axes.margins(x=0.01)
        reach = np.nanmax(np.abs(middle - np.nanmedian(middle))) if np.isfinite(middle).any() else 1.0
        if reach > 1e-6 and np.nanmax(band) > 4 * reach:  # a band that grew large would flatten what it is about
            axes.set_ylim(np.nanmedian(middle) - 4 * reach, np.nanmedian(middle) + 4 * reach)
    style.legend_above(panels[0])
    fig.align_ylabels()
    return fig
