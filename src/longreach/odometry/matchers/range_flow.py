"""Scan matching by range flow: how the ranges of a scan change tells how the sensor moved, no points matched.

Source: Jaimez, Monroy & Gonzalez-Jimenez 2016, "Planar odometry from a radial laser scanner. A range flow-based
approach" (the thesis' (3.24)–(3.26)). Where ours differs from its authors' implementation, and why:
* true beam angles, any field of view and mounting; NaN, infinity and 0 are no returns; identical scans are fine;
* what a sweep saw while the laser moved is carried to where it began, by the mean of the last motions;
* a warped point is shared between beams by nearness (`warp`), and the Cauchy scale comes from the residuals;
* a level is linearised again while its motion is not small; blending constants are those of its authors' 2018 method;
* the result is the base's motion, v_y included, its covariance that of the residuals (`flow_covariance`).
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.measurement import LaserScan, RelativePoseMeasurement
from longreach.odometry.matchers import _flow_kernels, _range_flow_kernels
from longreach.odometry.matchers._range_flow_kernels import RangeFlowConfig
from longreach.odometry.matchers.scan_matcher import Features, Fit, Prior, ScanMatch
from longreach.odometry.scan_geometry import ScanGeometry, same_kind, same_tables, scan_geometry, share_of_a_beam

_FEWEST_ROWS = 12  # fewer beams seen in both scans than this do not make a match


@dataclass(frozen=True, eq=False)
class RangeFlowState:
    """The last scan's pyramid, the last motion of the laser (a twist per scan), and its running mean."""

    stamp: float
    geometry: ScanGeometry
    pyramid: Float[np.ndarray, " total"]
    motion: Float[np.ndarray, "2 3"]


@dataclass(frozen=True, eq=False)
class ScanFeatures(Features):
    """The ranges themselves (1, n), and the scan; neither noise nor reach is looked for."""

    scan: LaserScan
    geometry: ScanGeometry


@dataclass(frozen=True, eq=False)
class FlowFit(Fit):
    """A fit, and the state of range flow after it."""

    after: RangeFlowState


@dataclass(frozen=True, eq=False)
class RangeFlow:
    """Match each scan to the one before, without a prior: range flow goes on from its own last motion."""

    config: RangeFlowConfig

    def features(self, scan: LaserScan, geometry: ScanGeometry, motion: np.ndarray, share: float) -> ScanFeatures:
        """Take the scan as it is; range flow undistorts it by its own motion."""
        returns = scan.returns
        return ScanFeatures(returns[None], int(np.count_nonzero(returns)), np.nan, np.nan, scan, geometry)

    def extended(
        self, reference: RangeFlowState | None, features: ScanFeatures, fit: FlowFit | None
    ) -> tuple[RangeFlowState, np.ndarray]:
        """Go on from this scan."""
        if fit is not None:
            return fit.after, np.zeros(3)
        g, scan, motion = features.geometry, features.scan, np.zeros((2, 3))
        low, high, r, pyramid = float(scan.range_min), float(scan.range_max), np.empty(g.beams), np.empty(g.start[-1])
        _flow_kernels.scan_pyramid(
            scan.ranges, low, high, g.flipped, g.cos, g.sin, g.increments[0], motion[1], 0.0, g.start, r, pyramid
        )
        return RangeFlowState(scan.stamp, g, pyramid, motion), np.zeros(3)

    def followed(self, reference: RangeFlowState, features: ScanFeatures, fit: FlowFit) -> RangeFlowState:
        """Go on from this scan."""
        return fit.after

    def match(
        self, features: ScanFeatures, reference: RangeFlowState, geometry: ScanGeometry, prior: Prior | None
    ) -> FlowFit | str:
        """Match a scan to the last one."""
        g, scan = reference.geometry, features.scan
        if not same_tables(geometry, g):
            return f"the scan has {geometry.beams} beams and other angles than the last one"
        pyramid, motion, pose, P = np.empty(g.start[-1]), reference.motion.copy(), np.empty(3), np.empty((3, 3))
        rows = _range_flow_kernels.step_scan(
            scan.ranges, float(scan.range_min), float(scan.range_max), g.flipped,
            share_of_a_beam(scan, scan.stamp - reference.stamp), reference.pyramid, pyramid, g.start, g.cos, g.sin,
            g.increments, motion, g.pose_base_laser, self.config, pose, P,
        )  # fmt: skip
        if rows < _FEWEST_ROWS:
            return f"only {rows} beams see something in both scans"
        after = RangeFlowState(scan.stamp, g, pyramid, motion)
        return FlowFit(pose, P, np.zeros((3, 3)), rows, 0.0, 1.0, np.zeros((0, 3)), after)

    def is_far(self, fit: FlowFit, features: ScanFeatures, geometry: ScanGeometry, reference: RangeFlowState) -> bool:
        """Make every scan a keyframe."""
        return True


def lidar_odometry(
    scans: Iterable[LaserScan], T_base_laser: Float[np.ndarray, "4 4"], config: RangeFlowConfig | None = None
) -> tuple[ScanMatch, ...]:
    """Match each scan against the one before, or start anew with it; the first scan has no entry."""
    matcher, last, geometry, matches = RangeFlow(config or RangeFlowConfig()), None, None, []
    for scan in scans:
        if geometry is None or not same_kind(scan, geometry):
            geometry = scan_geometry(scan, T_base_laser, 5)
        features = matcher.features(scan, geometry, np.zeros(3), 0.0)
        fit = None if last is None else matcher.match(features, last, geometry, None)
        if isinstance(fit, str):
            matches.append(ScanMatch(scan.stamp, None, fit, 0))
            fit = None
        elif last is not None and fit is not None:
            found = RelativePoseMeasurement(last.stamp, scan.stamp, fit.pose, fit.covariance, source="lidar")
            matches.append(ScanMatch(scan.stamp, found, "", fit.rows))
        last, _ = matcher.extended(last, features, fit)
    return tuple(matches)
