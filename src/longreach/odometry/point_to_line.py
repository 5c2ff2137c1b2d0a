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

from longreach.geometry import se2
from longreach.odometry import _line_kernels, _match_kernels, _range_flow_kernels
from longreach.odometry.range_flow import RangeFlowConfig
from longreach.odometry.scan_geometry import ScanGeometry

_FLOW = RangeFlowConfig().settings  # of guesses
_SMALLEST_NOISE = 1e-3  # [m]; the gate of a scan without noise must be wider than the errors of a guess


@dataclass(frozen=True, eq=False)
class Points:
    """The points of a scan in the laser's frame, counter-clockwise: x, y, r (3, n) [m], r = 0 where there is none."""

    xyr: Float[np.ndarray, "3 n"]
    count: int


@dataclass(frozen=True, eq=False)
class Lines:
    """The lines of a keyframe (n, 5), which lies in which direction, how many, their noise and the scan's reach [m]."""

    lines: Float[np.ndarray, "n 5"]
    beams: Int[np.ndarray, " n"]
    count: int
    noise: float
    reach: float


@dataclass(frozen=True, eq=False)
class Fit:
    """A pose (3,) of the base seen from the keyframe, with its covariance, and how well it explains the scan.

    directions (k, 3): of ξ, along which nothing was told. support: share of the points that agree but for noise.
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


def flow_guess(old: Points, new: Points, geometry: ScanGeometry) -> Float[np.ndarray, "3"]:
    """Return the base's motion between two scans by range flow, which needs no guess."""
    g, laser = geometry, np.zeros(3)
    _range_flow_kernels.guess_motion(old.xyr[2], new.xyr[2], g.start, g.cos, g.sin, g.increments, _FLOW, laser)
    if not np.isfinite(laser).all():
        return np.zeros(3)
    return se2.compose(se2.compose(g.pose_base_laser, laser), se2.inverse(g.pose_base_laser))
