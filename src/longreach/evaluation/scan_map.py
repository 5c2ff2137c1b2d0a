"""The map that the scans draw when they are laid along a path: people see drift there first."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from longreach.evaluation import style
from longreach.geometry import se2
from longreach.measurement import LaserScan
from longreach.trajectory import PoseTrajectory

_CELLS = 900  # along the longer side, about one a pixel of the figure
_SMALLEST_CELL = 0.02  # [m], about the noise of a scanner
_OUTLIERS = 0.2  # [%] of the points that may fall outside at each side
_PALEST = 0.25  # shade of a cell with a single point, to be seen on white


def scan_points(
    trajectory: PoseTrajectory, scans: Sequence[LaserScan], T_base_laser: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "n 2"]:
    """Return where all returns of the scans lie in the trajectory's frame [m]; scans it has no pose for are left out.

    A scan is taken to be an instant. The mount may be upside down: its rotation acts in space.
    """
    poses, known = trajectory.at(np.array([scan.stamp for scan in scans], dtype=float))
    points = [np.zeros((0, 2))]
    for scan, pose, good in zip(scans, poses, known, strict=True):
        if good:
            r, angles = scan.returns, scan.angles
            hit = r > 0
            rays = np.stack((np.cos(angles[hit]), np.sin(angles[hit])), axis=1) * r[hit, None]
            points.append(se2.transform(pose, rays @ T_base_laser[:2, :2].T + T_base_laser[:2, 3]))
    return np.concatenate(points)


def _corners(path: np.ndarray, points: np.ndarray) -> np.ndarray:
    sample = points[:: max(1, len(points) // 100_000)]
    if len(sample):
        path = np.concatenate((path, np.percentile(sample, [_OUTLIERS, 100 - _OUTLIERS], axis=0)))
    if len(path) == 0:
        path = np.zeros((1, 2))
    low, high = path.min(axis=0), path.max(axis=0)
    margin = 0.03 * float(np.max(high - low)) + 0.1
    return np.stack((low - margin, high + margin))


def _shades(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Count the points per cell (rows are y) and return log shades from 0, white, to 1, black."""
    side = corners[1] - corners[0]
    cell = max(float(np.max(side)) / _CELLS, _SMALLEST_CELL)
    across, up = np.maximum(np.ceil(side / cell).astype(int), 1).tolist()
    index = np.floor((points - corners[0]) * (np.array([across, up]) / side)).astype(np.int64)
    inside = np.all((index >= 0) & (index < [across, up]), axis=1)
    counts = np.bincount(index[inside, 1] * across + index[inside, 0], minlength=across * up).reshape(up, across)
    if not counts.any():
        return np.zeros((up, across))
    darkest = float(np.percentile(counts[counts > 0], 98))
    shades = _PALEST + (1 - _PALEST) * np.minimum(np.log1p(counts) / np.log1p(darkest), 1.0)
    return np.where(counts > 0, shades, 0.0)


def scan_map(
    trajectory: PoseTrajectory, points: Float[np.ndarray, "n 2"], title: str = "", name: str = "fused"
) -> Figure:
    """Draw laser points [m] as a density, darker where more fell, and the path they were laid along over it."""
    fig, axes = density(points, trajectory.poses[:, :2], title)
    x, y = style.thin(trajectory.poses[:, 0], trajectory.poses[:, 1])
    look = style.looks({name: None})[name]
    axes.plot(x, y, color=look.colour, linewidth=1.0, label=f"path: {look.label}")
    style.mark_start(axes, trajectory.poses)
    style.legend_above(axes)
    return fig


def density(
    points: Float[np.ndarray, "n 2"], along: Float[np.ndarray, "k 2"], title: str = "", darkest: float = 1.0
) -> tuple[Figure, Axes]:
    """Draw points [m] as a density, darker where more fell, in axes with room for the positions `along` as well."""
    corners = _corners(along, points)
    fig = style.figure(style.plane_height(corners), title)
    axes = style.panel(fig.add_subplot(), "x [m]", "y [m]")
    axes.grid(visible=False)
    (left, bottom), (right, top) = corners.tolist()
    shades, extent = darkest * _shades(points, corners), (left, right, bottom, top)
    axes.imshow(shades, cmap="Greys", vmin=0, vmax=1, origin="lower", extent=extent, interpolation="nearest")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0)
    return fig, axes
