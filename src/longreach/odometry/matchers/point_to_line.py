"""Point-to-line matching against a local map: a fit from the prior, and a search over its window where that is poor.

As point-to-line ICP (Censi 2008), with these differences:
* the surface at a point is the implicit moving least squares mean of all that the map's keyframes saw there
  (Kolluri 2008; as IMLS-SLAM, Deschaud 2018), first over a wide radius, then over a narrow one;
* where less agrees than should, a correlative search over the prior's window (Olson 2009) gives another start;
* distances weigh by the noise along the beam, and have no weight beyond five times what they are found to scatter;
* the covariance comes from the residuals at the solution (`_point_to_line_kernels.sandwich`).
"""

import math
from dataclasses import dataclass

import numpy as np

from longreach.measurement import LaserScan
from longreach.odometry import local_map
from longreach.odometry.local_map import LocalMap
from longreach.odometry.matchers import _correlative_kernels, _feature_kernels, _point_to_line_kernels
from longreach.odometry.matchers._point_to_line_kernels import FitSettings
from longreach.odometry.matchers.scan_matcher import Features, Fit, Prior
from longreach.odometry.scan_geometry import ScanGeometry

_FEWEST = 12  # returns on surfaces of the map, below which there is no match
_FEWEST_INLIERS = 0.1  # share of the returns that agree, below which there is no match
_POOR = 0.75  # share below which a search looks for a better start
_WINDOW = 3.0  # deviations of the prior that are searched
_WIDEST = np.array([0.7, 0.7, 0.35])  # deviations [m, m, rad] of a window at most


@dataclass(frozen=True, eq=False)
class PointToLine:
    """Match to a local map; distance, turned, overlap: of keyframes, as of `LidarConfig`."""

    settings: FitSettings
    distance: float
    turned: float
    overlap: float

    def features(self, scan: LaserScan, geometry: ScanGeometry, motion: np.ndarray, share: float) -> Features:
        """Take the points of a scan in the base's frame, and the directions of the surfaces there."""
        values = np.empty((_feature_kernels.FEATURES, len(scan.ranges)))
        low, high, g = float(scan.range_min), float(scan.range_max), geometry
        count, noise, reach = _feature_kernels.scan_features(
            scan.ranges, low, high, g.flipped, g.cos, g.sin, g.increments[0], g.pose_base_laser, motion, share, values
        )
        return Features(values, count, noise, reach)

    def extended(self, reference: LocalMap | None, features: Features, fit: Fit | None) -> tuple[LocalMap, np.ndarray]:
        """Add a scan's surfaces to the map, at the pose where it was matched."""
        pose = np.zeros(3) if fit is None else fit.pose
        before = () if reference is None else reference.keyframes
        return local_map.merged((*before, local_map.keyframe(features, pose))), pose

    def followed(self, reference: LocalMap, features: Features, fit: Fit) -> LocalMap:
        """Return the map as it is: only keyframes change it."""
        return reference

    def match(self, features: Features, reference: LocalMap, geometry: ScanGeometry, prior: Prior) -> Fit | str:
        """Fit from the prior; where less agrees than should, also from the best place in its window."""
        if features.count < _FEWEST:
            return f"only {features.count} beams see something"
        found = self.fit(features, reference, prior, prior.pose)
        if found.inlier_ratio < _POOR:
            start, sigma = np.array(prior.pose), np.minimum(prior.sigma, _WIDEST)
            points, m, origin = features.values, features.count, reference.surfaces.origin
            _correlative_kernels.search(points, m, prior.pose, sigma, _WINDOW, origin, *reference.field, start)
            if start.tolist() != prior.pose.tolist():  # nor was nothing found
                other = self.fit(features, reference, prior, start)
                found = other if other.inlier_ratio > found.inlier_ratio else found
        return _fault(found) or found

    def fit(self, features: Features, to: LocalMap, prior: Prior, start: np.ndarray) -> Fit:
        """Fit from a start, under a prior, whatever comes of it."""
        values, m, reach, noise = features.values, features.count, features.reach, min(features.noise, 1.2 * to.noise)
        pose, covariance, shared, directions, rows, scale, agree = _point_to_line_kernels.match(
            values, m, reach, noise, self.settings, start, prior, to.surfaces
        )
        return Fit(pose, covariance, shared, rows, scale, agree / m, directions)

    def is_far(self, fit: Fit, features: Features, geometry: ScanGeometry, reference: LocalMap) -> bool:
        """Whether every keyframe of the map was taken from elsewhere, or looking elsewhere, or the map ends here."""
        few, turned = fit.rows < self.overlap * features.count, self.turned * geometry.view
        return few or _point_to_line_kernels.is_far(reference.poses, fit.pose, self.distance, turned)


def _fault(found: Fit) -> str:
    """Return why a fit is none, or nothing."""
    if found.rows < _FEWEST:
        return f"only {found.rows} beams see something that the map has"
    if found.inlier_ratio < _FEWEST_INLIERS:
        return f"only {100 * found.inlier_ratio:.0f} % of the beams agree with the map"
    return "" if math.isfinite(found.scale) else "the match is not finite"
