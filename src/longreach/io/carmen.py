"""CARMEN logs: laser scans and wheel odometry as text, plain or compressed (.gz, .bz2, .xz).

The order of the lines is the order of motion. Stamps that run backwards are kept as recorded and counted; a repaired
clock stands beside them (`Recording.recorded_stamps`). Lines that matter, each with `ipc_time host logger_time` at its
end; a stamp is the ipc_time:

    FLASER n r1 … rn  x y θ  ox oy oθ                        laser pose, robot pose in raw odometry
    ROBOTLASER1 LASER  x y θ  ox oy oθ  tv rv forward side axis
    RAWLASER1 LASER                                          no poses; another line may repeat the scan with them
    ODOM x y θ  tv rv accel
    RLASER, ROBOTLASER2, RAWLASER2                           likewise, of a second scanner

LASER: type start_angle field_of_view increment maximum_range accuracy remission_mode n r1 … rn m, and m remissions.
n beams of FLASER go counter-clockwise from -90° over 180°; an odd n holds both ends.

Source: the comments at the start of the logs that CARMEN's logger writes.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from longreach.errors import RecordingError
from longreach.geometry import se2
from longreach.io.recording_info import RecordingInfo, topic_info
from longreach.io.text_lines import numbers, text_lines
from longreach.measurement import LaserScan, Odometry, Recording
from longreach.robot.description import RobotDescription
from longreach.trajectory import PoseTrajectory, monotone_clock

_ODOM_WORDS = 9  # at least; the host after the stamp shows that the stamp is whole
# Numbers that follow the ranges, without the stamp: poses, and what else there is.
_AFTER_RANGES = {"FLASER": 6, "RLASER": 6, "ROBOTLASER1": 11, "ROBOTLASER2": 11, "RAWLASER1": 0, "RAWLASER2": 0}
# Of the same scanner, in the order in which their lines are taken where several repeat a scan.
_SCANNERS = (("FLASER", "ROBOTLASER1", "RAWLASER1"), ("RLASER", "ROBOTLASER2", "RAWLASER2"))
_FRONT, _REAR = "robot_frontlaser_", "robot_rearlaser_"
FRAME = "laser"


class ScanLine(NamedTuple):
    """A scan: pose of laser and robot x y θ ox oy oθ where it has them, and as it says, first angle, increment, range.

    NaN where it does not.
    """

    kind: str
    stamp: float
    ranges: np.ndarray
    poses: list[float]
    first: float = np.nan
    increment: float = np.nan
    range_max: float = np.nan


@dataclass(eq=False)
class CarmenLog:
    """What a log holds in the order of its lines: of odometry x y θ ipc_time."""

    scans: list[ScanLine] = field(default_factory=list)
    odometry: list[list[float]] = field(default_factory=list)
    others: dict[str, int] = field(default_factory=dict)
    damaged: list[str] = field(default_factory=list)  # a sentence on each line that cannot be read
    cut: list[str] = field(default_factory=list)  # one that says so where the file is
    parameters: dict[str, float] = field(default_factory=dict)  # of where the lasers are


def read_log(path: Path, progress: Callable[[float], None] | None = None) -> CarmenLog:
    """Read all lines of a log.

    Raises:
        RecordingError: there is neither a scan nor odometry.
    """
    log = CarmenLog()
    for line, text in text_lines(path, log.cut.append):
        words = text.split()
        try:
            _take_line(log, path, line, words)
        except RecordingError as error:
            log.damaged.append(str(error))
        if progress is not None and line % 1000 == 0:
            progress(line)
    if log.scans or log.odometry:
        return log
    if damage := [*log.damaged, *log.cut]:
        raise RecordingError(damage[0])
    readable = [word[:20] for word in sorted(log.others) if word.isascii() and word.isprintable()]
    found = ", ".join(readable[:5]) or ("nothing that is text" if log.others else "no lines at all")
    raise RecordingError(
        f"{path} holds no FLASER, ROBOTLASER, RAWLASER or ODOM lines, so it is no CARMEN log; it has {found}."
    )


def _take_line(log: CarmenLog, path: Path, line: int, words: list[str]) -> None:
    """Add what a line holds to a log.

    Raises:
        RecordingError: it is cut short or holds what is no number.
    """
    if words[0] in _AFTER_RANGES:
        log.scans.append(_scan_line(path, line, words))
    elif words[0] == "ODOM":
        if len(words) < _ODOM_WORDS:
            raise RecordingError(f"{path}, line {line}: an ODOM line has x y θ tv rv accel and a time; it is cut.")
        log.odometry.append(numbers(path, line, [*words[1:4], words[7]]))
    else:
        log.others[words[0]] = log.others.get(words[0], 0) + 1
        if words[0] == "PARAM" and len(words) > 2 and words[1].startswith((_FRONT, _REAR)) and "offset" in words[1]:
            log.parameters[words[1]] = numbers(path, line, [words[2]])[0]


def _damage(log: CarmenLog) -> list[str]:
    """Say what of a log cannot be read."""
    said = [f"{sentence} It was read up to there." for sentence in log.cut]
    if log.damaged:
        count = len(log.damaged)
        counted = "A line was left out" if count == 1 else f"{count} lines were left out; the first"
        said.append(f"{counted}: {log.damaged[0]}")
    return said


def _scan_line(path: Path, line: int, words: list[str]) -> ScanLine:
    kind = words[0]
    start = 2 if kind in ("FLASER", "RLASER") else 9
    count = _count(words, start - 1)
    end = start + count
    if start > 2 and count >= 0:  # remissions
        end += 1 + max(0, _count(words, end))
    after = _AFTER_RANGES[kind]
    if count < 1 or len(words) < end + after + 2:  # the stamp, and the host, which shows that the stamp is whole
        n = max(count, -1)
        raise RecordingError(f"{path}, line {line}: a {kind} line of {n} ranges is cut short or has no count.")
    ranges = np.array(numbers(path, line, words[start : start + count]))
    *rest, stamp = numbers(path, line, words[end : end + after + 1])
    if start == 2:
        return ScanLine(kind, stamp, ranges, rest)
    first, view, increment, range_max = numbers(path, line, words[2:6])
    if not 0 < increment < np.inf:
        increment = view / max(count - count % 2, 1)  # as in FLASER lines
    return ScanLine(kind, stamp, ranges, rest[:6], first, increment, range_max if range_max > 0 else np.nan)


def _count(words: list[str], at: int) -> int:
    return int(words[at]) if at < len(words) and words[at].isdecimal() else -1


def read_carmen(path: Path, robot: RobotDescription, progress: Callable[[float], None] | None = None) -> Recording:
    """Read a log: scans, and the wheels as the robot's own driver integrated them.

    The wheels' poses are those that stand in the scans' lines, which hold at the scans' own stamps; those of ODOM lines
    only where no scan has one. Ranges that read the log's largest value again and again are its mark for no return.
    """
    log = read_log(path, progress)
    remarks = _damage(log)
    lines = _of_one_scanner(log, remarks)
    rows = np.array([[*scan.poses[3:], scan.stamp] for scan in lines if scan.poses] or log.odometry).reshape(-1, 4)
    has_poses = bool(lines) and bool(lines[0].poses)
    stamps = np.array([scan.stamp for scan in lines])
    finite_scans = np.array([np.all(np.isfinite([scan.stamp, *scan.poses])) for scan in lines], dtype=bool)
    finite = finite_scans if has_poses else np.all(np.isfinite(rows), axis=1)
    dropped = np.count_nonzero(~finite) + (0 if has_poses else np.count_nonzero(~finite_scans))
    if dropped:
        remarks.append(f"{dropped} lines with a pose or stamp that is not finite were left out.")
    rows, stamps = rows[finite], stamps[finite_scans]
    lines = [scan for scan, good in zip(lines, finite_scans.tolist(), strict=True) if good]
    if len(rows) + len(lines) == 0:
        raise RecordingError(f"{path} holds no line with finite numbers.")
    clock, recorded = _repaired(rows[:, 3], remarks)
    scan_clock = clock
    if not has_poses:
        scan_clock, more = _repaired(stamps, remarks)
        recorded |= more
    return Recording(
        name=path.name,
        wheels=tuple(Odometry(stamp, pose=pose) for stamp, pose in zip(clock, rows[:, :3], strict=True)),
        scans=_scans(lines, scan_clock, robot, remarks),
        mounts={FRAME: _mount(lines, log.parameters)} if lines else {},
        recorded_stamps=recorded,
        remarks=tuple(remarks),
    )


def _of_one_scanner(log: CarmenLog, remarks: list[str]) -> list[ScanLine]:
    """Return the scans of the first scanner that has some: those with poses if there are any, and each once."""
    scans: list[ScanLine] = []
    for kinds in _SCANNERS:
        found = [scan for scan in log.scans if scan.kind in kinds]
        if scans:
            for kind in kinds:
                if count := sum(scan.kind == kind for scan in found):
                    remarks.append(f"{count} {kind} lines (a second scanner) were not used.")
            continue
        posed = [scan for scan in found if scan.poses]
        scans = posed or found
        if posed and len(posed) < len(found):
            remarks.append(f"{len(found) - len(posed)} {kinds[2]} lines, which have no poses, were not used.")
    kinds_of: dict[tuple[float, bytes], str] = {}
    kept = [s for s in scans if kinds_of.setdefault((s.stamp, _fingerprint(s.ranges)), s.kind) == s.kind]
    if len(kept) < len(scans):
        remarks.append(f"{len(scans) - len(kept)} scans stand in the log by two kinds of lines; they were read once.")
    return kept


def _repaired(recorded: np.ndarray, remarks: list[str]) -> tuple[list[float], dict[float, float]]:
    """Return a clock that runs forwards, and its stamps → stamps as recorded where they differ."""
    clock = monotone_clock(recorded)
    backwards = int(np.count_nonzero(np.diff(recorded) <= 0))
    if backwards:
        remarks.append(
            f"{backwards} of {len(recorded)} stamps run backwards; the order of the file was kept and a clock repaired "
            f"at {np.count_nonzero(clock != recorded)} of them."
        )
    return clock.tolist(), {c: r for c, r in zip(clock.tolist(), recorded.tolist(), strict=True) if c != r}


def _scans(
    lines: list[ScanLine], clock: list[float], robot: RobotDescription, remarks: list[str]
) -> tuple[LaserScan, ...]:
    if not lines:
        return ()
    lidar = robot.lidar
    range_min = (lidar and lidar.range_min) or 0.0
    range_max = (lidar and lidar.range_max) or np.inf
    mark = _no_return_mark([scan.ranges for scan in lines])
    if mark < min(range_max, np.nanmin([np.inf, *(scan.range_max for scan in lines)])):
        remarks.append(f"Ranges of {mark:.2f} m and more were taken for no returns: the log repeats its largest value.")
    range_max = min(range_max, np.nextafter(mark, 0.0))
    if len({len(scan.ranges) for scan in lines}) > 1:
        remarks.append("The number of beams changes within the log.")
    scans = []
    for stamp, scan in zip(clock, lines, strict=True):
        n = len(scan.ranges)
        first = -np.pi / 2 if np.isnan(scan.first) else scan.first
        increment = np.pi / max(n - n % 2, 1) if np.isnan(scan.increment) else scan.increment
        if lidar is not None:
            first = first if lidar.angle_min is None else lidar.angle_min
            increment = increment if lidar.angle_increment is None else lidar.angle_increment
        largest = range_max if np.isnan(scan.range_max) else min(range_max, np.nextafter(scan.range_max, 0.0))
        scans.append(
            LaserScan(stamp, scan.ranges, float(first), float(increment), range_min, float(largest), frame=FRAME)
        )
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


def _mount(lines: list[ScanLine], parameters: dict[str, float]) -> np.ndarray:
    """Return T_base_laser: from the two poses of each scan where they agree all along, else the log's parameters."""
    T = np.eye(4)
    side = _FRONT if lines[0].kind in _SCANNERS[0] else _REAR
    x, y, yaw = (parameters.get(f"{side}{name}", 0.0) for name in ("offset", "side_offset", "angular_offset"))
    if side == _REAR and f"{side}angular_offset" not in parameters:
        yaw = np.pi
    if lines[0].poses:
        rows = np.array([scan.poses for scan in lines])
        seen = se2.between(rows[:, 3:], rows[:, :3])
        middle = np.median(seen, axis=0)
        if np.abs(seen - middle).max() <= 1e-3:
            x, y, yaw = middle.tolist()
    c, s = np.cos(yaw), np.sin(yaw)
    T[:2, :2], T[:2, 3] = [[c, -s], [s, c]], [x, y]
    return T


def read_corrected_poses(path: Path, recording: Recording | None = None) -> PoseTrajectory:
    """Read the laser poses of a log whose FLASER lines were corrected afterwards; its ODOM lines were not.

    Such logs count their stamps from anywhere, with few digits. With the recording that they were made from, their
    scans are found in it by their ranges, and take its stamps; those that are not found are left out.
    """
    log = read_log(path)
    if damage := _damage(log):
        raise RecordingError(f"A reference has to be whole. {damage[0]}")
    lines = [scan for scan in _of_one_scanner(log, []) if scan.poses]
    if not lines:
        raise RecordingError(f"{path} has no FLASER lines, whose poses are the reference in a corrected log.")
    poses = np.array([scan.poses[:3] for scan in lines])
    if recording is not None:
        stamp_of = {_fingerprint(scan.ranges): scan.stamp for scan in recording.scans}
        found = [stamp_of.get(_fingerprint(scan.ranges)) for scan in lines]
        known = np.array([stamp is not None for stamp in found])
        if 2 * np.count_nonzero(known) > len(lines):
            clock = np.array([stamp for stamp in found if stamp is not None])
            order = np.argsort(clock, kind="stable")
            return PoseTrajectory(recording.as_recorded(clock[order]), poses[known][order], clock=clock[order])
    return PoseTrajectory(np.array([scan.stamp for scan in lines]), poses)


def _fingerprint(ranges: np.ndarray) -> bytes:
    return np.round(100.0 * ranges).astype(np.int32).tobytes()  # logs give centimetres


def inspect(path: Path) -> RecordingInfo:
    """Count and time the lines of a log by their kind."""
    log = read_log(path)
    stamps: dict[str, list[float]] = {}
    for scan in log.scans:
        stamps.setdefault(scan.kind, []).append(scan.stamp)
    if log.odometry:
        stamps["ODOM"] = [row[-1] for row in log.odometry]
    both = np.concatenate(list(stamps.values()))
    beams = sorted({len(scan.ranges) for scan in log.scans})
    remarks = _damage(log)
    remarks += [f"Scans have {' or '.join(str(n) for n in beams)} beams."] if beams else []
    remarks += [f"{count} {kind} lines are not used." for kind, count in sorted(log.others.items())]
    return RecordingInfo(
        format="CARMEN log",
        start=float(both.min()),
        duration=float(np.ptp(both)),
        topics=tuple(topic_info(kind, "CARMEN line", np.array(values)) for kind, values in stamps.items()),
        remarks=tuple(remarks),
    )
