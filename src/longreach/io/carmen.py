"""CARMEN logs: laser scans and wheel odometry as text, plain or compressed (.gz, .bz2).

The order of the lines is the order of motion. Stamps that run backwards are kept as recorded and counted; a repaired
clock stands beside them (`Recording.recorded_stamps`). Lines that matter:

    FLASER n r1 … rn  x y θ  ox oy oθ  ipc_time host logger_time     laser pose, robot pose in raw odometry
    ODOM x y θ  tv rv accel  ipc_time host logger_time

A stamp is the ipc_time. n beams go counter-clockwise from -90° over 180°; an odd n holds both ends.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from longreach.errors import RecordingError
from longreach.geometry import se2
from longreach.io.recording_info import RecordingInfo, topic_info
from longreach.io.text_lines import numbers, text_lines
from longreach.measurement import LaserScan, Odometry, Recording
from longreach.robot.description import RobotDescription
from longreach.trajectory import PoseTrajectory, monotone_clock

# At least; the host after the stamp shows that the stamp is whole.
_AFTER_RANGES = 8  # x y θ ox oy oθ ipc_time host
_ODOM_WORDS = 9
FRAME = "laser"


@dataclass(eq=False)
class CarmenLog:
    """What a log holds in the order of its lines: of scans x y θ ox oy oθ ipc_time, of odometry x y θ ipc_time."""

    ranges: list[np.ndarray] = field(default_factory=list)
    scans: list[list[float]] = field(default_factory=list)
    odometry: list[list[float]] = field(default_factory=list)
    others: dict[str, int] = field(default_factory=dict)
    laser_offset: float = 0.0


def read_log(path: Path, progress: Callable[[float], None] | None = None) -> CarmenLog:
    """Read all lines of a log.

    Raises:
        RecordingError: a line is cut short or holds what is no number; there is neither a scan nor odometry.
    """
    log = CarmenLog()
    for line, text in text_lines(path):
        words = text.split()
        if words[0] == "FLASER":
            _take_scan(log, path, line, words)
        elif words[0] == "ODOM":
            if len(words) < _ODOM_WORDS:
                raise RecordingError(f"{path}, line {line}: an ODOM line has x y θ tv rv accel and a time; it is cut.")
            row = numbers(path, line, [*words[1:4], words[7]])
            log.odometry.append(row)
        else:
            log.others[words[0]] = log.others.get(words[0], 0) + 1
            if words[:2] == ["PARAM", "robot_frontlaser_offset"] and len(words) > 2:
                log.laser_offset = numbers(path, line, [words[2]])[0]
        if progress is not None and line % 1000 == 0:
            progress(line)
    if not log.scans and not log.odometry:
        readable = [word[:20] for word in sorted(log.others) if word.isascii() and word.isprintable()]
        found = ", ".join(readable[:5]) or ("nothing that is text" if log.others else "no lines at all")
        raise RecordingError(f"{path} holds neither FLASER nor ODOM lines, so it is no CARMEN log; it has {found}.")
    return log


def _take_scan(log: CarmenLog, path: Path, line: int, words: list[str]) -> None:
    count = int(words[1]) if len(words) > 1 and words[1].isdigit() else -1
    if count < 1 or len(words) < 2 + count + _AFTER_RANGES:
        raise RecordingError(f"{path}, line {line}: a FLASER line of {count} ranges is cut short or has no count.")
    values = numbers(path, line, words[2 : 2 + count + 7])
    log.ranges.append(np.array(values[:count]))
    log.scans.append(values[count:])


def read_carmen(path: Path, robot: RobotDescription, progress: Callable[[float], None] | None = None) -> Recording:
    """Read a log: scans, and the wheels as the robot's own driver integrated them.

    The wheels' poses are those that stand in the scans' lines, which hold at the scans' own stamps; those of ODOM lines
    only where there are no scans. Ranges that read the log's largest value again and again are its mark for no return.
    """
    log = read_log(path, progress)
    rows = np.array(log.scans if log.scans else log.odometry)
    finite = np.all(np.isfinite(rows), axis=1)
    remarks = []
    if not finite.all():
        remarks.append(f"{np.count_nonzero(~finite)} lines with a pose or stamp that is not finite were left out.")
        rows = rows[finite]
        log.ranges = [r for r, good in zip(log.ranges, finite.tolist(), strict=True) if good] if log.scans else []
    if len(rows) == 0:
        raise RecordingError(f"{path} holds no line with finite numbers.")
    recorded = rows[:, -1]
    clock = monotone_clock(recorded)
    backwards = int(np.count_nonzero(np.diff(recorded) <= 0))
    if backwards:
        remarks.append(
            f"{backwards} of {len(recorded)} stamps run backwards; the order of the file was kept and a clock repaired "
            f"at {np.count_nonzero(clock != recorded)} of them."
        )
    if log.others.keys() & {"RLASER"}:
        remarks.append(f"{log.others['RLASER']} RLASER lines (a second scanner) were not used.")
    poses = rows[:, -4:-1]
    stamps = clock.tolist()
    return Recording(
        name=path.name,
        wheels=tuple(Odometry(stamp, pose=pose) for stamp, pose in zip(stamps, poses, strict=True)),
        scans=_scans(log, stamps, robot, remarks),
        mounts={FRAME: _mount(rows, log.laser_offset)} if log.scans else {},
        recorded_stamps={c: r for c, r in zip(stamps, recorded.tolist(), strict=True) if c != r},
        remarks=tuple(remarks),
    )


def _scans(log: CarmenLog, stamps: list[float], robot: RobotDescription, remarks: list[str]) -> tuple[LaserScan, ...]:
    if not log.ranges:
        return ()
    lidar = robot.lidar
    range_min = (lidar and lidar.range_min) or 0.0
    range_max = (lidar and lidar.range_max) or np.inf
    mark = _no_return_mark(log.ranges)
    if mark < range_max:
        remarks.append(f"Ranges of {mark:.2f} m and more were taken for no returns: the log repeats its largest value.")
        range_max = np.nextafter(mark, 0.0)
    if len({len(r) for r in log.ranges}) > 1:
        remarks.append("The number of beams changes within the log.")
    scans = []
    for stamp, ranges in zip(stamps, log.ranges, strict=True):
        n = len(ranges)
        first = -np.pi / 2 if lidar is None or lidar.angle_min is None else lidar.angle_min
        increment = lidar.angle_increment if lidar is not None and lidar.angle_increment is not None else None
        if increment is None:
            increment = np.pi / max(n - n % 2, 1)
        scans.append(LaserScan(stamp, ranges, float(first), float(increment), range_min, range_max, frame=FRAME))
    return tuple(scans)


def _no_return_mark(ranges: list[np.ndarray]) -> float:
    """Return the smallest range that means no return, inf where the largest range is just a far wall.

    A far wall spreads over many values; a mark is one value, or a few within 0.5 % of it, with a gap below.
    """
    values = np.concatenate(ranges)
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return np.inf
    top = values.max()
    near = np.count_nonzero(values >= 0.995 * top)
    below = np.count_nonzero((values >= 0.985 * top) & (values < 0.995 * top))
    return 0.995 * top if near > max(10, 0.001 * len(values)) and below < 0.1 * near else np.inf


def _mount(rows: np.ndarray, laser_offset: float) -> np.ndarray:
    """Return T_base_laser: from the two poses of each scan where they agree all along, else the log's parameter."""
    T = np.eye(4)
    seen = se2.between(rows[:, 3:6], rows[:, 0:3])
    x, y, yaw = np.median(seen, axis=0).tolist()
    if np.abs(seen - np.array([x, y, yaw])).max() > 1e-3:
        x, y, yaw = laser_offset, 0.0, 0.0
    c, s = np.cos(yaw), np.sin(yaw)
    T[:2, :2], T[:2, 3] = [[c, -s], [s, c]], [x, y]
    return T


def read_corrected_poses(path: Path, recording: Recording | None = None) -> PoseTrajectory:
    """Read the laser poses of a log whose FLASER lines were corrected afterwards; its ODOM lines were not.

    Such logs count their stamps from anywhere, with few digits. With the recording that they were made from, their
    scans are found in it by their ranges, and take its stamps; those that are not found are left out.
    """
    log = read_log(path)
    if not log.scans:
        raise RecordingError(f"{path} has no FLASER lines, whose poses are the reference in a corrected log.")
    rows = np.array(log.scans)
    if recording is not None:
        stamp_of = {_fingerprint(scan.ranges): scan.stamp for scan in recording.scans}
        found = [stamp_of.get(_fingerprint(ranges)) for ranges in log.ranges]
        known = np.array([stamp is not None for stamp in found])
        if 2 * np.count_nonzero(known) > len(rows):
            clock = np.array([stamp for stamp in found if stamp is not None])
            order = np.argsort(clock, kind="stable")
            return PoseTrajectory(recording.as_recorded(clock[order]), rows[known, :3][order], clock=clock[order])
    return PoseTrajectory(rows[:, 6], rows[:, :3])


def _fingerprint(ranges: np.ndarray) -> bytes:
    return np.round(100.0 * ranges).astype(np.int32).tobytes()  # logs give centimetres


def inspect(path: Path) -> RecordingInfo:
    """Count and time the lines of a log by their kind."""
    log = read_log(path)
    kinds = {"FLASER": log.scans, "ODOM": log.odometry}
    stamps = {kind: np.array([row[-1] for row in rows]) for kind, rows in kinds.items() if rows}
    both = np.concatenate(list(stamps.values()))
    beams = sorted({len(ranges) for ranges in log.ranges})
    remarks = [f"Scans have {' or '.join(str(n) for n in beams)} beams."] if beams else []
    remarks += [f"{count} {kind} lines are not used." for kind, count in sorted(log.others.items())]
    return RecordingInfo(
        format="CARMEN log",
        start=float(both.min()),
        duration=float(np.ptp(both)),
        topics=tuple(topic_info(kind, "CARMEN line", values) for kind, values in stamps.items()),
        remarks=tuple(remarks),
    )
