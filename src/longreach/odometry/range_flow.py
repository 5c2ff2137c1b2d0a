"""LIDAR odometry by range flow: how the ranges of a scan change tells how the sensor moved, no points matched.

Source: Jaimez, Monroy & Gonzalez-Jimenez 2016, "Planar odometry from a radial laser scanner. A range flow-based
approach" (the thesis' (3.24)–(3.26)). Where ours differs from its authors' implementation, and why:
* true beam angles, any field of view and mounting; NaN, infinity and 0 are no returns; identical scans are fine;
* what a sweep saw while the laser moved is carried to where it began, by the mean of the last motions;
* a warped point is shared between beams by nearness, not nearness squared, which hid rotations below a beam;
* the Cauchy scale comes from the residuals (95 % efficiency), not from mean|R_t|;
* a level is linearised again while its motion is not small; blending constants are those of its authors' 2018 method;
* the covariance is measured from the residuals, their correlation included (`_range_flow_kernels.flow_covariance`);
* the result is the base's motion, v_y included.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.measurement import LaserScan, RelativePoseMeasurement
from longreach.odometry import _pyramid_kernels, _range_flow_kernels
from longreach.odometry.scan_geometry import FEWEST_BEAMS, ScanGeometry, same_kind, scan_geometry, share_of_a_beam
from longreach.odometry.scan_match import ScanMatch

_FEWEST_ROWS = 12  # fewer beams seen in both scans than this do not make a match


class RangeFlowConfig(BaseModel):
    """Parameters of range flow; the defaults serve 180 to 1081 beams at 5 to 40 Hz."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    levels: int = Field(
        default=5, ge=1, le=8, description="Levels of the pyramid [1]; 5: the authors' code (coarsest 1/16)."
    )
    iterations: int = Field(
        default=5, ge=1, le=50, description="Reweightings a level at most [1]; 5: the authors' code."
    )
    linearisations: int = Field(default=3, ge=1, le=20, description="Linearisations a level at most [1]; 3: SRF 2018.")
    settled: float = Field(default=0.01, gt=0, description="A level's motion below this ends it [m + rad].")
    reach: float = Field(
        default=0.3, gt=0, description="Neighbours further away in range are not smoothed [m]; authors' code."
    )
    noise: float = Field(
        default=0.1,
        gt=0,
        description="Floor under the derivatives in a row's weight [m]; 0.2 in SRF 2018, 0.01 of scanners.",
    )
    blend_covariance: float = Field(default=5000.0, ge=0, description="Pull to the last motion per variance; SRF 2018.")
    blend_constant: float = Field(default=0.02, ge=0, description="Constant pull to the last motion [1]; SRF 2018.")
    share: float = Field(
        default=0.02,
        ge=0,
        description="Deviation of a translation in distances between beams, from aliasing [1]; ours.",
    )
    lags: int = Field(default=6, ge=0, le=50, description="Neighbouring beams whose errors may be correlated [1].")

    @cached_property
    def settings(self) -> _range_flow_kernels.Settings:
        """The same as the kernels take it."""
        return _range_flow_kernels.Settings(
            reach=self.reach,
            iterations=self.iterations,
            linearisations=self.linearisations,
            settled=self.settled,
            noise=self.noise,
            c=self.blend_covariance,
            d=self.blend_constant,
            lags=self.lags,
            share=self.share,
        )


@dataclass(frozen=True, eq=False)
class RangeFlowState:
    """The last scan's pyramid, the last motion of the laser (a twist per scan), and its running mean."""

    stamp: float
    geometry: ScanGeometry
    pyramid: Float[np.ndarray, " total"]
    motion: Float[np.ndarray, "2 3"]


def init(scan: LaserScan, T_base_laser: Float[np.ndarray, "4 4"], config: RangeFlowConfig) -> RangeFlowState:
    """Start from a first scan."""
    return start(scan, scan_geometry(scan, T_base_laser, config.levels), config)


def start(scan: LaserScan, geometry: ScanGeometry, config: RangeFlowConfig) -> RangeFlowState:
    """Start from a first scan whose tables are known."""
    pyramid = np.empty(geometry.start[-1])
    ranges = np.empty(geometry.beams)
    _pyramid_kernels.clean(scan.ranges, float(scan.range_min), float(scan.range_max), geometry.flipped, ranges)
    _pyramid_kernels.build_pyramid(ranges, geometry.start, config.reach, pyramid)
    return RangeFlowState(scan.stamp, geometry, pyramid, np.zeros((2, 3)))


def step(
    state: RangeFlowState, scan: LaserScan, T_base_laser: Float[np.ndarray, "4 4"], config: RangeFlowConfig
) -> tuple[RangeFlowState, ScanMatch]:
    """Match a scan against the last one.

    Returns the new state and the match: the pose of the base at this scan seen from the base at the last one, with the
    covariance (3, 3) of ξ = log(pose⁻¹ · truth). A scan of another kind (number of beams, angles) starts anew, one
    of fewer than 8 beams is passed over.
    """
    if len(scan.ranges) < FEWEST_BEAMS:
        reason = f"the scan has {len(scan.ranges)} beams, where at least {FEWEST_BEAMS} are needed"
        return state, ScanMatch(scan.stamp, None, reason, 0)
    if not same_kind(scan, state.geometry):
        reason = f"the scan has {len(scan.ranges)} beams and other angles than the last one"
        return init(scan, T_base_laser, config), ScanMatch(scan.stamp, None, reason, 0)
    return advance(state, scan, state.geometry, config)


def advance(
    state: RangeFlowState, scan: LaserScan, geometry: ScanGeometry, config: RangeFlowConfig
) -> tuple[RangeFlowState, ScanMatch]:
    """Match a scan against the last one, of the same kind, whose tables are known."""
    g = state.geometry
    if not same_kind(scan, g):
        reason = f"the scan has {len(scan.ranges)} beams and other angles than the last one"
        return start(scan, geometry, config), ScanMatch(scan.stamp, None, reason, 0)
    pyramid, motion = np.empty_like(state.pyramid), state.motion.copy()
    pose, covariance = np.empty(3), np.empty((3, 3))
    rows = _range_flow_kernels.step_scan(
        scan.ranges,
        float(scan.range_min),
        float(scan.range_max),
        g.flipped,
        share_of_a_beam(scan, scan.stamp - state.stamp),
        state.pyramid,
        pyramid,
        g.start,
        g.cos,
        g.sin,
        g.increments,
        motion,
        g.pose_base_laser,
        config.settings,
        pose,
        covariance,
    )
    if rows < _FEWEST_ROWS:
        reason = f"only {rows} beams see something in both scans"
        return RangeFlowState(scan.stamp, g, pyramid, np.zeros((2, 3))), ScanMatch(scan.stamp, None, reason, rows)
    measurement = RelativePoseMeasurement(state.stamp, scan.stamp, pose, covariance, source="lidar")
    return RangeFlowState(scan.stamp, g, pyramid, motion), ScanMatch(scan.stamp, measurement, "", rows)


def lidar_odometry(
    scans: Iterable[LaserScan],
    T_base_laser: Float[np.ndarray, "4 4"],
    config: RangeFlowConfig | None = None,
    show_progress: Callable[[int], None] | None = None,
) -> tuple[ScanMatch, ...]:
    """Match each scan against the one before; the first scan gives no match and no entry.

    show_progress is called now and then with the number of scans done.
    """
    config = config or RangeFlowConfig()
    state = None
    matches = []
    for i, scan in enumerate(scans):
        if state is None:
            state = init(scan, T_base_laser, config)
            continue
        state, match = step(state, scan, T_base_laser, config)
        matches.append(match)
        if show_progress and i % 200 == 0:
            show_progress(i)
    return tuple(matches)
