"""Scan matching, points to lines: the points of a scan against the lines of a keyframe.

As point-to-line ICP (Censi 2008), with these differences:
* a point belongs to the line that the keyframe has in its direction, so that no neighbour is searched for;
* lines are as long as the noise allows, and fitted to inverse ranges, which leaves no bias (`_line_kernels.fit_lines`);
* distances weigh by the noise along the beam, and fall out beyond four times what they are found to scatter;
* the covariance comes from the residuals at the solution (`_match_kernels.line_covariance`), by the closed form of
  Censi 2007 in the sandwich form of robust statistics (Huber & Ronchetti 2009, chapter 7).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from longreach.odometry import _line_kernels, _match_kernels
from longreach.odometry.scan_geometry import ScanGeometry

_SMALLEST_NOISE = 1e-4  # [m]; a scan without noise has lines, too


@dataclass(frozen=True, eq=False)
class Points:
    """The points of a scan in the laser's frame, counter-clockwise: x, y, r (3, n) [m], r = 0 where there is none."""

    xyr: Float[np.ndarray, "3 n"]
    count: int


@dataclass(frozen=True, eq=False)
class Lines:
    """The lines of a keyframe (n, 5), which of them lies in which direction, their noise and the scan's reach [m]."""

    lines: Float[np.ndarray, "n 5"]
    beams: Int[np.ndarray, " n"]
    noise: float
    reach: float


@dataclass(frozen=True, eq=False)
class Fit:
    """A pose (3,) of the base seen from the keyframe, with its covariance, and how well it explains the scan.

    directions (k, 3): of ξ, along which nothing was told. support: mean robust weight of the rows [1].
    """

    pose: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    shared: Float[np.ndarray, "3 3"]
    rows: int
    scale: float
    support: float
    directions: Float[np.ndarray, "k 3"]


def points_of(
    ranges: Float[np.ndarray, " n"],
    limits: tuple[float, float],
    geometry: ScanGeometry,
    motion: Float[np.ndarray, "3"],
    share: float,
) -> Points:
    """Return the points of a scan, carried to where its sweep began by the laser's motion (3,) from scan to scan."""
    xyr = np.empty((3, len(ranges)))
    count = _line_kernels.scan_points(
        ranges, *limits, geometry.flipped, geometry.cos, geometry.sin, motion, share, xyr[0], xyr[1], xyr[2]
    )
    return Points(xyr, count)


def lines_of(points: Points, geometry: ScanGeometry) -> Lines:
    """Make a keyframe out of a scan."""
    x, y, r = points.xyr
    n = len(r)
    noise = max(_line_kernels.range_noise(x, y, r, np.empty(n)), _SMALLEST_NOISE)
    lines, beams = np.zeros((n, 5)), np.empty(n, dtype=np.int64)
    _line_kernels.fit_lines(x, y, r, noise, lines)
    _line_kernels.beams_by_direction(x, y, r, geometry.cos, geometry.sin, geometry.increments[0], beams)
    return Lines(lines, beams, noise, float(np.median(r[r > 0])) if points.count else 1.0)


def fit(
    points: Points,
    key: Lines,
    geometry: ScanGeometry,
    settings: _match_kernels.LineSettings,
    guess: Float[np.ndarray, "3"],
    free: Float[np.ndarray, "3"],
) -> Fit:
    """Match points to the lines of a keyframe, from a guess (3,) of the base's pose.

    free (3,): the variance of x, y [m²] and θ [rad²] of the guess along directions that the scan does not tell.
    """
    x, y, r = points.xyr
    pose, covariance, shared = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    told, V = np.empty(3), np.empty((3, 3))
    rows, scale, support = _match_kernels.match_points(
        x,
        y,
        r,
        geometry.cos,
        geometry.sin,
        geometry.increments[0],
        key.beams,
        key.lines,
        key.reach,
        settings,
        geometry.pose_base_laser,
        guess,
        free,
        pose,
        covariance,
        shared,
        told,
        V,
    )
    return Fit(pose, covariance, shared, rows, scale, support, _directions(told, V, key.reach, geometry))


def _directions(told: np.ndarray, V: np.ndarray, reach: float, geometry: ScanGeometry) -> np.ndarray:
    """Return the directions of the base's ξ that are not told, as rows of length 1."""
    if told.all():
        return np.zeros((0, 3))
    found = V.T[told == 0.0] / np.array([1.0, 1.0, reach])
    x, y, t = geometry.pose_base_laser
    c, s = np.cos(t), np.sin(t)
    found = found @ np.array([[c, -s, y], [s, c, -x], [0.0, 0.0, 1.0]]).T
    return found / np.linalg.norm(found, axis=1, keepdims=True)
