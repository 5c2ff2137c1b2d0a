"""Matching by the range flow of 2016, from scan to scan: every scan is a keyframe. See `odometry.range_flow`."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.measurement import LaserScan
from longreach.odometry import range_flow
from longreach.odometry.matchers.scan_matcher import Features, Fit, Prior
from longreach.odometry.range_flow import RangeFlowConfig, RangeFlowState
from longreach.odometry.scan_geometry import ScanGeometry


@dataclass(frozen=True, eq=False)
class ScanFeatures(Features):
    """The ranges themselves (1, n), and the scan."""

    scan: LaserScan


@dataclass(frozen=True, eq=False)
class FlowFit(Fit):
    """A fit, and the state of range flow after it."""

    after: RangeFlowState


@dataclass(frozen=True, eq=False)
class RangeFlow:
    """Match each scan to the one before, without a prior: range flow goes on from its own last motion."""

    config: RangeFlowConfig

    def features(
        self, scan: LaserScan, geometry: ScanGeometry, motion: Float[np.ndarray, "3"], share: float
    ) -> ScanFeatures:
        """Take the scan as it is; range flow undistorts it by its own motion."""
        returns = scan.returns
        count = int(np.count_nonzero(returns))
        return ScanFeatures(
            returns[None], count, np.inf, float(np.median(returns[returns > 0])) if count else 1.0, scan
        )

    def extended(
        self, reference: RangeFlowState | None, features: ScanFeatures, geometry: ScanGeometry, fit: FlowFit | None
    ) -> tuple[RangeFlowState, Float[np.ndarray, "3"]]:
        """Go on from this scan."""
        if fit is not None:
            return fit.after, np.zeros(3)
        return range_flow.start(features.scan, geometry, self.config), np.zeros(3)

    def followed(self, reference: RangeFlowState, features: ScanFeatures, fit: FlowFit) -> RangeFlowState:
        """Go on from this scan."""
        return fit.after

    def match(
        self, features: ScanFeatures, reference: RangeFlowState, geometry: ScanGeometry, prior: Prior
    ) -> FlowFit | str:
        """Match a scan to the last one."""
        after, match = range_flow.advance(reference, features.scan, geometry, self.config)
        if match.measurement is None:
            return match.reason
        found = match.measurement
        return FlowFit(found.pose, found.covariance, np.zeros((3, 3)), match.rows, 0.0, 1.0, np.zeros((0, 3)), after)

    def is_far(self, fit: FlowFit, features: ScanFeatures, geometry: ScanGeometry, reference: RangeFlowState) -> bool:
        """Make every scan a keyframe."""
        return True
