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

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.errors import EstimationError
from longreach.geometry import se2
from longreach.measurement import LaserScan, RelativePoseMeasurement
from longreach.odometry import _pyramid_kernels, _range_flow_kernels

_LONGEST_SWEEP = 1.5  # of the time between scans; a sweep that claims to last longer has a wrong time_increment
_FEWEST_BEAMS = 8  # of a scan
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
class ScanGeometry:
    """The tables of one kind of scan: beam angles a level, and where the laser sits in the base."""

    beams: int
    angle_min: float
    angle_increment: float
    flipped: bool
    pose_base_laser: Float[np.ndarray, "3"]
    start: np.ndarray
    cos: Float[np.ndarray, " total"]
    sin: Float[np.ndarray, " total"]
    increments: Float[np.ndarray, " levels"]


@dataclass(frozen=True, eq=False)
class RangeFlowState:
    """The last scan's pyramid, the last motion of the laser (a twist per scan), and its running mean."""

    stamp: float
    geometry: ScanGeometry
    pyramid: Float[np.ndarray, " total"]
    motion: Float[np.ndarray, "2 3"]


@dataclass(frozen=True, eq=False)
class ScanMatch:
    """What one scan gave: the base's pose relative to the reference scan, or None and the reason why not."""

    stamp: float
    measurement: RelativePoseMeasurement | None
    reason: str
    rows: int

    @property
    def twist(self) -> Float[np.ndarray, "3"] | None:
        """Mean body twist of the base [m/s, m/s, rad/s] between the two scans."""
        if self.measurement is None or not self.stamp > self.measurement.stamp_reference:
            return None
        return se2.log(self.measurement.pose) / (self.stamp - self.measurement.stamp_reference)


def scan_geometry(scan: LaserScan, T_base_laser: Float[np.ndarray, "4 4"], levels: int) -> ScanGeometry:
    """Make the tables for scans like this one, from a laser mounted at T_base_laser.

    A laser upside down, or one that counts its beams clockwise, is turned into one that counts counter-clockwise.

    Raises:
        EstimationError: the laser's plane is tilted by more than 15° against the floor, or it has fewer than 8 beams.
    """
    tilt = math.degrees(math.acos(min(1.0, abs(T_base_laser[2, 2]))))
    if tilt > 15.0:
        raise EstimationError(f"The LIDAR is tilted by {tilt:.0f}° against the floor; planar odometry bears up to 15°.")
    beams = len(scan.ranges)
    if beams < _FEWEST_BEAMS:
        raise EstimationError(f"A scan has {beams} beams; LIDAR odometry needs at least {_FEWEST_BEAMS}.")
    sense = 1.0 if T_base_laser[2, 2] > 0 else -1.0
    first, increment = sense * scan.angle_min, sense * scan.angle_increment
    flipped = bool(increment < 0)
    if flipped:
        first, increment = first + (beams - 1) * increment, -increment
    sizes = [beams]
    while len(sizes) < levels and sizes[-1] >= 16:
        sizes.append((sizes[-1] + 1) // 2)
    angles = np.concatenate([first + increment * 2**level * np.arange(n) for level, n in enumerate(sizes)])
    return ScanGeometry(
        beams=beams,
        angle_min=scan.angle_min,
        angle_increment=scan.angle_increment,
        flipped=flipped,
        pose_base_laser=se2.from_se3(T_base_laser),
        start=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        cos=np.cos(angles),
        sin=np.sin(angles),
        increments=increment * 2.0 ** np.arange(len(sizes)),
    )


def init(scan: LaserScan, T_base_laser: Float[np.ndarray, "4 4"], config: RangeFlowConfig) -> RangeFlowState:
    """Start from a first scan."""
    geometry = scan_geometry(scan, T_base_laser, config.levels)
    pyramid = np.empty(geometry.start[-1])
    ranges = np.empty(geometry.beams)
    _pyramid_kernels.clean(scan.ranges, float(scan.range_min), float(scan.range_max), geometry.flipped, ranges)
    _pyramid_kernels.build_pyramid(ranges, geometry.start, config.reach, pyramid)
    return RangeFlowState(scan.stamp, geometry, pyramid, np.zeros((2, 3)))


def _same_kind(scan: LaserScan, geometry: ScanGeometry) -> bool:
    return (
        len(scan.ranges) == geometry.beams
        and abs(scan.angle_min - geometry.angle_min) < 1e-6
        and abs(scan.angle_increment - geometry.angle_increment) < 1e-9
    )


def _share(state: RangeFlowState, scan: LaserScan) -> float:
    """Return which part of the motion between the two scans goes by from one beam to the next; 0 for an instant."""
    period = scan.stamp - state.stamp
    share = scan.time_increment / period if period > 0 else 0.0
    return share if 0.0 < share * len(scan.ranges) <= _LONGEST_SWEEP else 0.0


def step(
    state: RangeFlowState, scan: LaserScan, T_base_laser: Float[np.ndarray, "4 4"], config: RangeFlowConfig
) -> tuple[RangeFlowState, ScanMatch]:
    """Match a scan against the last one.

    Returns the new state and the match: the pose of the base at this scan seen from the base at the last one, with the
    covariance (3, 3) of ξ = log(pose⁻¹ · truth). A scan of another kind (number of beams, angles) starts anew, one
    of fewer than 8 beams is passed over.
    """
    if len(scan.ranges) < _FEWEST_BEAMS:
        reason = f"the scan has {len(scan.ranges)} beams, where at least {_FEWEST_BEAMS} are needed"
        return state, ScanMatch(scan.stamp, None, reason, 0)
    if not _same_kind(scan, state.geometry):
        reason = f"the scan has {len(scan.ranges)} beams and other angles than the last one"
        return init(scan, T_base_laser, config), ScanMatch(scan.stamp, None, reason, 0)
    g = state.geometry
    pyramid, motion = np.empty_like(state.pyramid), state.motion.copy()
    pose, covariance = np.empty(3), np.empty((3, 3))
    rows = _range_flow_kernels.step_scan(
        scan.ranges,
        float(scan.range_min),
        float(scan.range_max),
        g.flipped,
        _share(state, scan),
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
