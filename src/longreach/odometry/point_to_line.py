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
from longreach.odometry.scan_fit import Fit, Points, directions_of
from longreach.odometry.scan_geometry import ScanGeometry

_SMALLEST_NOISE = 1e-3  # [m]; the gate of a scan without noise must be wider than the errors of a guess


@dataclass(frozen=True, eq=False)
class Lines:
    """The lines of a keyframe (n, 5), which lies in which direction, how many, their noise and the scan's reach [m]."""

    lines: Float[np.ndarray, "n 5"]
    beams: Int[np.ndarray, " n"]
    count: int
    noise: float
    reach: float


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
        ranges, *limits, geometry.flipped, *geometry.finest, motion, share, xyr[0], xyr[1], xyr[2]
    )
    return Points(xyr, count)


def lines_of(points: Points, geometry: ScanGeometry, noise: float) -> Lines:
    """Make a keyframe out of a scan; noise [m]: of its ranges at most, as clutter looks like it."""
    x, y, r = points.xyr
    n = len(r)
    noise = max(min(_line_kernels.range_noise(x, y, r, np.empty(n)), noise), _SMALLEST_NOISE)
    lines, beams = np.zeros((n, 5)), np.empty(n, dtype=np.int64)
    _line_kernels.fit_lines(x, y, r, noise, lines)
    _line_kernels.beams_by_direction(x, y, r, *geometry.finest, geometry.increments[0], beams)
    count = int(np.count_nonzero(lines[:, 2]))
    return Lines(lines, beams, count, noise, float(np.median(r[r > 0])) if points.count else 1.0)


def fit(
    points: Points,
    key: Lines,
    geometry: ScanGeometry,
    settings: _match_kernels.LineSettings,
    guess: Float[np.ndarray, "3"],
    doubt: Float[np.ndarray, "3"],
    free: Float[np.ndarray, "3"],
) -> Fit:
    """Match points to the lines of a keyframe, from a guess (3,) of the base's pose.

    doubt (3,): deviation of the guess [m, m, rad], weighed against what the scan tells.
    free (3,): the variance of x, y [m²] and θ [rad²] of the guess along directions that the scan does not tell.
    """
    beams, lines, places = key.beams[None], key.lines[None], np.zeros((1, 3))
    x, y, r = points.xyr
    pose, covariance, shared = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    told, V = np.empty(3), np.empty((3, 3))
    rows, scale, agree = _match_kernels.match_points(
        x,
        y,
        r,
        *geometry.finest,
        geometry.increments[0],
        beams,
        lines,
        places,
        key.reach,
        key.noise,
        settings,
        geometry.pose_base_laser,
        guess,
        doubt,
        free,
        pose,
        covariance,
        shared,
        told,
        V,
    )
    support = agree / max(min(points.count, key.count), 1)
    return Fit(pose, covariance, shared, rows, scale, support, directions_of(told, V, key.reach, geometry))
