"""Scan matching by symmetric range flow: how a scan's ranges differ from those of a keyscan, and of the last scan.

Source: Jaimez, Monroy, Lopez-Antequera & Gonzalez-Jimenez 2018, "Robust planar odometry based on symmetric range flow
and multiscan alignment". Where ours differs from its authors' implementation, and why:
* true beam angles, any field of view and mounting; NaN, infinity and 0 are no returns;
* a guess may be given: wheels or a filter know more of a motion than the last motion does;
* between neighbouring points inverse ranges are interpolated, which are those of a straight line;
* the covariance is measured from the residuals, their correlation included (`flow_covariance`), and an error of the
  last scan's pose goes on as far as that scan has a say; what is not told is found out, and is as wide as it can be.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.odometry import _pyramid_kernels, _symmetric_flow_kernels
from longreach.odometry.scan_fit import Fit, Points, directions_of
from longreach.odometry.scan_geometry import ScanGeometry

_REACH = 0.3  # [m] neighbours further away in range are not smoothed; the authors' code of 2016
# Rotation [rad] since the keyscan beyond which there is a new one, a polynomial of the translation [m]; the authors'
# code: small scanners, and those of 500 beams and more. Beyond its last root no rotation is small enough.
_NEAR = np.polynomial.Polynomial((0.1054, -0.3149, 2.307, -7.617, -14.92)), 0.25
_FAR = np.polynomial.Polynomial((0.2042, 0.5319, -4.371, 11.81, -10.66)), 0.68
SETTINGS = _symmetric_flow_kernels.SymmetricSettings(
    iterations=10,  # reweightings at most; the authors' code
    linearisations=3,  # a level; the authors' code
    settled=0.01,  # [m] a level's motion below which it is not linearised again; 0.05 in the authors' code
    lags=6,  # neighbouring beams whose errors may be correlated
    known=3.0,  # information over that from errors of slopes alone
    common=0.02,  # of the residuals, the part common to all beams
    agree=0.1,  # [m] a residual below it agrees
)


@dataclass(frozen=True, eq=False)
class Keyscan(Points):
    """The points of a scan with its pyramid, the scan's reach [m], and the noise of its ranges, which is not known."""

    pyramid: Float[np.ndarray, " total"]
    reach: float
    noise: float = np.inf


def keyscan_of(
    ranges: Float[np.ndarray, " n"],
    limits: tuple[float, float],
    geometry: ScanGeometry,
    motion: Float[np.ndarray, "3"],
    share: float,
) -> Keyscan:
    """Return a scan as it would be seen from where its sweep began, by the laser's motion (3,) from scan to scan."""
    r, pyramid = np.empty(geometry.beams), np.empty(geometry.start[-1])
    _pyramid_kernels.clean(ranges, *limits, geometry.flipped, r)
    cos, sin = geometry.finest
    if share > 0.0:
        swept, space = r.copy(), np.empty_like(r)
        _pyramid_kernels.deskew(swept, cos, sin, geometry.increments[0], motion, share, geometry.flipped, r, space)
    _pyramid_kernels.build_pyramid(r, geometry.start, _REACH, pyramid)
    count = int(np.count_nonzero(r))
    return Keyscan(np.stack([r * cos, r * sin, r]), count, pyramid, float(np.median(r[r > 0])) if count else 1.0)


def fit(
    new: Keyscan,
    key: Keyscan,
    last: Keyscan,
    seen: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]],
    with_last: bool,
    geometry: ScanGeometry,
    guess: Float[np.ndarray, "3"],
    doubt: Float[np.ndarray, "3"],
    free: Float[np.ndarray, "3"],
) -> Fit:
    """Match a scan to a keyscan, from a guess (3,) of the base's pose seen from there.

    seen: pose and covariance of the base at the last scan. with_last: that scan takes part, too. doubt (3,): deviation
    of the guess [m, m, rad]. free (3,): the variance of x, y [m²] and θ [rad²] along directions that are not told.
    """
    g, pose, covariance, told, V = geometry, np.full(3, np.nan), np.empty((3, 3)), np.ones(3), np.eye(3)
    rows, scale, agree = _symmetric_flow_kernels.fit_scan(
        key.pyramid,
        last.pyramid,
        new.pyramid,
        *seen,
        with_last,
        g.start,
        g.cos,
        g.sin,
        g.increments,
        key.reach,
        SETTINGS,
        g.pose_base_laser,
        guess,
        doubt,
        free,
        pose,
        covariance,
        V,
        told,
    )
    used = rows // 2 if with_last else rows
    support = agree / max(rows, 1) * min(used / max(min(new.count, key.count), 1), 1.0)
    return Fit(pose, covariance, 0.5 * covariance, used, scale, support, directions_of(told, V, key.reach, g))


def is_far(pose: Float[np.ndarray, "3"], beams: int) -> bool:
    """Whether a pose (3,) is so far from the keyscan that there has to be a new one."""
    allowed, furthest = _FAR if beams >= 500 else _NEAR
    distance = float(np.hypot(pose[0], pose[1]))
    return bool(distance > furthest or abs(pose[2]) > allowed(distance))
