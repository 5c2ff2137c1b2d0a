"""Scan matching by symmetric range flow: how a scan's ranges differ from those of a keyscan, and of the last scan.

Source: Jaimez, Monroy, Lopez-Antequera & Gonzalez-Jimenez 2018, "Robust planar odometry based on symmetric range flow
and multiscan alignment". Where ours differs from its authors' implementation, and why:
* true beam angles, any field of view and mounting; NaN, infinity and 0 are no returns; it starts from a prior;
* between neighbouring points inverse ranges are interpolated, which are those of a straight line;
* the covariance is measured from the residuals (`flow_covariance`), an error of the last scan's pose goes on as far as
  that scan takes part, and directions that the scans do not show are as wide as the prior says.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.geometry import se2
from longreach.measurement import LaserScan
from longreach.odometry.matchers import _flow_kernels, _symmetric_flow_kernels
from longreach.odometry.matchers.scan_matcher import Features, Fit, Prior
from longreach.odometry.scan_geometry import ScanGeometry, same_tables

_FEWEST = 12  # beams that see something in both scans, below which there is no match
_FEWEST_INLIERS = 0.1  # share of the returns that agree, below which there is no match
_OVERLAP = 0.6  # beams that the keyscan explains at least
# Rotation [rad] since the keyscan beyond which there is a new one, a polynomial of the translation [m]; the authors'
# code: small scanners, and those of 500 beams and more. Beyond its last root no rotation is small enough.
_NEAR = np.polynomial.Polynomial((0.1054, -0.3149, 2.307, -7.617, -14.92)), 0.25
_FAR = np.polynomial.Polynomial((0.2042, 0.5319, -4.371, 11.81, -10.66)), 0.68


@dataclass(frozen=True, eq=False)
class Keyscan(Features):
    """The ranges (1, n) of a scan, counter-clockwise, 0 where there was no return, and their pyramid."""

    pyramid: Float[np.ndarray, " total"]
    geometry: ScanGeometry


@dataclass(frozen=True, eq=False)
class Scans:
    """The keyscan, in whose frame poses are, and the last scan with the pose (3,) and covariance (3, 3) it was at."""

    key: Keyscan
    last: Keyscan
    pose: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]


@dataclass(frozen=True, eq=False)
class SymmetricFlow:
    """Match by symmetric range flow; with_last: the last scan takes part, too, beside the keyscan."""

    with_last: bool

    def features(self, scan: LaserScan, geometry: ScanGeometry, motion: np.ndarray, share: float) -> Keyscan:
        """Return a scan as it would be seen from where its sweep began, with its pyramid."""
        g, low, high = geometry, float(scan.range_min), float(scan.range_max)
        r, pyramid = np.empty(g.beams), np.empty(g.start[-1])
        _flow_kernels.scan_pyramid(
            scan.ranges, low, high, g.flipped, g.cos, g.sin, g.increments[0], motion, share, g.start, r, pyramid
        )
        count = int(np.count_nonzero(r))
        return Keyscan(r[None], count, np.inf, float(np.median(r[r > 0])) if count else 1.0, pyramid, g)

    def extended(self, reference: Scans | None, features: Keyscan, fit: Fit | None) -> tuple[Scans, np.ndarray]:
        """Make a scan the keyscan: the only one, at the origin."""
        return Scans(features, features, np.zeros(3), np.zeros((3, 3))), np.zeros(3)

    def followed(self, reference: Scans, features: Keyscan, fit: Fit) -> Scans:
        """Remember the last scan."""
        return Scans(reference.key, features, fit.pose, fit.covariance)

    def match(self, features: Keyscan, reference: Scans, geometry: ScanGeometry, prior: Prior) -> Fit | str:
        """Match a scan to the keyscan, and to the last scan."""
        if features.count < _FEWEST:
            return f"only {features.count} beams see something"
        if not same_tables(geometry, reference.key.geometry):
            return "the scan has other beams than the keyscan"
        g, key, last = geometry, reference.key, reference.last
        with_last = self.with_last and last is not key
        pose, covariance, observable, V = np.full(3, np.nan), np.empty((3, 3)), np.ones(3), np.eye(3)
        rows, scale, agree = _symmetric_flow_kernels.fit_scan(
            key.pyramid, last.pyramid, features.pyramid, reference.pose, reference.covariance, with_last,
            g.start, g.cos, g.sin, g.increments, key.reach, g.pose_base_laser, prior.pose, prior.sigma, prior.free,
            pose, covariance, V, observable,
        )  # fmt: skip
        used = rows // 2 if with_last else rows
        inlier_ratio = agree / max(rows, 1) * min(used / max(min(features.count, key.count), 1), 1.0)
        if used < _FEWEST:
            return f"only {used} beams see something that the keyscan saw"
        if inlier_ratio < _FEWEST_INLIERS or not np.isfinite(scale):
            return f"only {100 * inlier_ratio:.0f} % of the beams agree with the keyscan"
        directions = np.zeros((0, 3))
        if not observable.all():
            of_laser = V.T[observable == 0.0] / np.array([1.0, 1.0, key.reach])
            directions = of_laser @ se2.adjoint(g.pose_base_laser).T
            directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return Fit(pose, covariance, 0.5 * covariance, used, scale, inlier_ratio, directions)

    def is_far(self, fit: Fit, features: Keyscan, geometry: ScanGeometry, reference: Scans) -> bool:
        """Whether the rotation is too large for the translation, as the method's authors have it."""
        allowed, furthest = _FAR if geometry.beams >= 500 else _NEAR
        distance = float(np.hypot(fit.pose[0], fit.pose[1]))
        few = fit.rows < _OVERLAP * min(features.count, reference.key.count)
        return bool(few or distance > furthest or abs(fit.pose[2]) > allowed(distance))
