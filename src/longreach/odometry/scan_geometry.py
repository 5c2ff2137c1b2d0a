"""The tables of one kind of scan: beam angles, and where the laser sits in the base."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.errors import EstimationError
from longreach.geometry import se2
from longreach.measurement import LaserScan

FEWEST_BEAMS = 8  # of a scan
_LONGEST_SWEEP = 1.5  # of the time between scans; a sweep that claims to last longer has a wrong time_increment


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

    @property
    def view(self) -> float:
        """Angle between the first and the last beam [rad]."""
        return self.beams * float(self.increments[0])


def check_mount(T_base_laser: Float[np.ndarray, "4 4"]) -> None:
    """Raise EstimationError where the laser's plane is tilted by more than 15° against the floor."""
    tilt = math.degrees(math.acos(min(1.0, abs(T_base_laser[2, 2]))))
    if tilt > 15.0:
        raise EstimationError(f"The LIDAR is tilted by {tilt:.0f}° against the floor; planar odometry bears up to 15°.")


def scan_geometry(scan: LaserScan, T_base_laser: Float[np.ndarray, "4 4"], levels: int) -> ScanGeometry:
    """Make the tables for scans like this one, from a laser mounted at T_base_laser.

    A laser upside down, or one that counts its beams clockwise, is turned into one that counts counter-clockwise.
    Raises EstimationError where it is tilted by more than 15° against the floor, or has fewer than 8 beams.
    """
    check_mount(T_base_laser)
    beams = len(scan.ranges)
    if beams < FEWEST_BEAMS:
        raise EstimationError(f"A scan has {beams} beams; LIDAR odometry needs at least {FEWEST_BEAMS}.")
    sense = 1.0 if T_base_laser[2, 2] > 0 else -1.0
    first, increment = sense * scan.angle_min, sense * scan.angle_increment
    flipped = bool(increment < 0)
    if flipped:
        first, increment = first + (beams - 1) * increment, -increment
    sizes = [beams]
    while len(sizes) < levels and sizes[-1] >= 16:
        sizes.append((sizes[-1] + 1) // 2)
    angles = np.concatenate([first + increment * 2**level * np.arange(n) for level, n in enumerate(sizes)])
    start = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    pose, increments = se2.from_se3(T_base_laser), increment * 2.0 ** np.arange(len(sizes))
    kind = beams, scan.angle_min, scan.angle_increment
    return ScanGeometry(*kind, flipped, pose, start, np.cos(angles), np.sin(angles), increments)


def same_kind(scan: LaserScan, geometry: ScanGeometry) -> bool:
    """Whether a scan has the beams that the tables are for."""
    start, step = scan.angle_min - geometry.angle_min, scan.angle_increment - geometry.angle_increment
    return bool(len(scan.ranges) == geometry.beams and abs(start) < 1e-6 and abs(step) < 1e-9)


def same_tables(a: ScanGeometry, b: ScanGeometry) -> bool:
    """Whether two kinds of scans are one."""
    start, step = a.angle_min - b.angle_min, a.angle_increment - b.angle_increment
    return bool(a.beams == b.beams and abs(start) < 1e-6 and abs(step) < 1e-9)


def share_of_a_beam(scan: LaserScan, period: float) -> float:
    """Return which part of the motion in a period [s] goes by from one beam to the next; 0 for an instant."""
    share = scan.time_increment / period if period > 0 else 0.0
    return share if 0.0 < share * len(scan.ranges) <= _LONGEST_SWEEP else 0.0
