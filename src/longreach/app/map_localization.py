"""A recording localised in a map: what must agree before, the fold over its scans, and the error in the map's frame."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.app.evaluate import Evaluation, Progress, against_truth, carried_to_truth
from longreach.errors import MappingError
from longreach.estimation.planar.state import Correction
from longreach.evaluation.alignment import moved
from longreach.localization.localizer import Row
from longreach.mapping import global_start, known_map, map_localizer
from longreach.mapping.known_map import KnownMap
from longreach.mapping.map_file import Map, load_map
from longreach.mapping.map_localizer import MapRow
from longreach.mapping.mapper import PathRow
from longreach.mapping.occupancy import Occupancy, read_map_server
from longreach.measurement import LaserScan, Recording
from longreach.robot.description import RobotDescription

_BLOCK = 500  # scans between two reports of progress
_SIGMAS = (0.5, 0.5, 0.26)  # [m, m, rad] of a start without its own; those of RViz's initial pose
_TELLS = 5  # reasons of corrections that a remark names at most


@dataclass(frozen=True, eq=False)
class Start:
    """Where the base is on the map at first: pose (3,), and deviations (3,) along the map's axes [m, m, rad]."""

    pose: Float[np.ndarray, "3"]
    sigmas: Float[np.ndarray, "3"]

    @property
    def covariance(self) -> Float[np.ndarray, "3 3"]:
        """Of ξ, in the base's axes."""
        c, s = math.cos(self.pose[2]), math.sin(self.pose[2])
        R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        return R @ np.diag(self.sigmas**2) @ R.T


class OnMap(NamedTuple):
    """What localising in a map gives: a row each scan, what became of each fit, and sentences about it."""

    rows: list[MapRow]
    corrections: list[Correction]
    remarks: list[str]


def parsed_start(text: str) -> Start | None:
    """Read x,y,theta or x,y,theta,sx,sy,stheta [m, m, rad]; None: `global`, the base is searched for.

    Raises:
        MappingError: it is neither.
    """
    if text.strip() == "global":
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) == 3:
        numbers += _SIGMAS
    good = len(numbers) == 6 and all(map(math.isfinite, numbers)) and min(numbers[3:]) > 0.0
    if not good:
        raise MappingError(
            f'The start "{text}" is none: give x,y,theta or x,y,theta,sx,sy,stheta in metres and radians, with '
            "deviations larger than 0, or global."
        )
    return Start(np.array(numbers[:3]), np.array(numbers[3:]))


def opened_file(path: Path | None, start: str | None, fixes: Path | None = None) -> dict[str, Any]:
    """Return `map` and `start` for `estimate`, of what a command line names; nothing where there is no map.

    Raises:
        MappingError: the file is no map; the start is none, or has no map; there are fixes, too.
    """
    if path is None:
        if start is not None:
            raise MappingError("A start is one on a map; give --map as well.")
        return {}
    if fixes is not None:
        raise MappingError("A map and fixes both say where the base is; give --map or --fixes.")
    read = read_map_server if path.suffix in (".yaml", ".yml") else load_map
    return {"map": read(path), "start": parsed_start(start or "global")}


def opened(map_: Map | Occupancy, robot: RobotDescription, recording: Recording, start: Start | None) -> KnownMap:
    """Prepare a map for the scans of a recording, and a start on it.

    Raises:
        MappingError: the map is of another robot or scanner, or shows nothing; no scan is there; the start is off it.
    """
    if not recording.scans:
        raise MappingError(f"{recording.name} has no scans; to localise in a map takes a LIDAR's.")
    if isinstance(map_, Map):
        _check_fits(map_, robot, recording)
        known = known_map.prepared(map_)
    else:
        known = known_map.drawn(map_)
    if start is not None:
        map_localizer.init(known, np.eye(4), start.pose, start.covariance)
    return known


def _check_fits(map_: Map, robot: RobotDescription, recording: Recording) -> None:
    """Refuse a map of another robot or scanner."""
    robots = sorted({session.robot for session in map_.sessions})
    if robot.name not in robots:
        raise MappingError(
            f"The map is of {', '.join(robots)}, and the recording of {robot.name}; give a map that this robot made."
        )
    kinds = {(len(scan.ranges), round(scan.angle_increment, 6)) for scan in map_.scans}
    beams, step = kind = len(recording.scans[0].ranges), round(recording.scans[0].angle_increment, 6)
    if kind not in kinds:
        n, other = sorted(kinds)[0]
        raise MappingError(
            f"The map was made with a scanner of {n} beams {math.degrees(other):.3g}° apart, and this one has {beams}, "
            f"{math.degrees(step):.3g}° apart; give a map that this scanner made."
        )


def followed(
    known: KnownMap,
    T_base_laser: Float[np.ndarray, "4 4"],
    scans: Sequence[LaserScan],
    path: Sequence[Row],
    start: Start | None,
    tell: Progress,
) -> OnMap:
    """Fold the localizer on a map over scans and the path of the odometry.

    Raises:
        MappingError: the start is not on the map.
    """
    stamps = {scan.stamp for scan in scans}
    rows = [PathRow(*row) for row in path if row.stamp in stamps]
    state = global_start.init(known, T_base_laser)
    if start is not None:
        state = replace(state, settled=map_localizer.init(known, T_base_laser, start.pose, start.covariance))
    given: list[MapRow] = []
    corrections: list[Correction] = []
    for i in range(0, len(rows), _BLOCK):
        tell("localisation", i / len(rows))
        part = rows[i : i + _BLOCK]
        some = [scan for scan in scans if part[0].stamp <= scan.stamp <= part[-1].stamp]
        state, on_map, said = global_start.step(state, some, part)
        given, corrections = given + on_map, corrections + said
    ordinary = [c for c in corrections if not c.reason.startswith((global_start.LOST, global_start.FOUND))]
    said = [*_searched(state, rows, given), *_remarks(ordinary), *_lost(given, corrections)]
    return OnMap(given, corrections, said)


def _seconds_lost(rows: Sequence[MapRow]) -> float:
    """Return for how long rows are lost [s]."""
    return math.fsum(b.stamp - a.stamp for a, b in pairwise(rows) if a.lost)


def _searched(state: global_start.GlobalStartState, rows: Sequence[PathRow], given: Sequence[MapRow]) -> list[str]:
    """Say what became of the search for the start."""
    if given:
        late = given[0].stamp - rows[0].stamp
        return [f"map: the base was found after {late:.1f} s of driving."] if late > 0.0 else []
    if not state.hypotheses:
        return ["map: no place on it agrees with the scans, so nothing is localized."]
    places = ", ".join(
        f"({h.pose[0]:.2f}, {h.pose[1]:.2f}) m {math.degrees(h.pose[2]):.0f}° with {100 * h.weight:.0f} %"
        for h in state.hypotheses[:_TELLS]
    )
    return [
        f"map: where the base is, is ambiguous, so nothing is localized: it could be at {places}; "
        "drive on, or give --start."
    ]


def _remarks(corrections: Sequence[Correction]) -> list[str]:
    """Say where the map did not hold for a while, and what was taken after it."""
    remarks, refused = [], [c for c in corrections if c.status != "used"]
    if refused:
        remarks.append(
            f"map: of {len(corrections)} fits {len(refused)} were not taken; the first at {refused[0].stamp:.2f} s, "
            f"because {refused[0].reason}."
        )
    if corrections and not any(c.status == "used" for c in corrections):
        remarks.append("No scan fits the map where the base was said to start: `localized` is odometry from there.")
    again = [c for c in corrections if c.status == "used" and c.reason]
    for c in again[:_TELLS]:
        size = 1e3 * float(np.hypot(*c.innovation[:2]))
        remarks.append(f"map: at {c.stamp:.2f} s a fit {size:.0f} mm off was {c.reason}.")
    return remarks


def _lost(rows: Sequence[MapRow], corrections: Sequence[Correction]) -> list[str]:
    """Say when the base was lost, and when it was found again."""
    alarms = [c for c in corrections if c.reason.startswith(global_start.LOST)]
    found = [c for c in corrections if c.reason.startswith(global_start.FOUND)]
    remarks = [f"map: at {c.stamp:.2f} s {c.reason}." for c in alarms[:_TELLS]]
    for c in found[:_TELLS]:
        off = float(np.hypot(*c.innovation[:2]))
        remarks.append(f"map: at {c.stamp:.2f} s {c.reason}, {off:.2f} m from where odometry had it.")
    if len(alarms) > _TELLS:
        remarks.append(f"map: it was lost {len(alarms)} times.")
    if rows and rows[-1].lost:
        remarks.append("map: at the end the base is lost: `localized` is odometry from then on.")
    return remarks


def judged(evaluation: Evaluation, map_: Map | Occupancy, on_map: OnMap) -> Evaluation:
    """Say for how long `localized` was lost, and hold it against the truth: carried there as the mapping run was, else
    by what fits best.
    """
    if "localized" in evaluation.metrics:
        lost = {"lost": {"value": _seconds_lost(on_map.rows), "unit": "s"}}
        own = {**evaluation.metrics["localized"], **lost}
        evaluation = replace(evaluation, metrics={**evaluation.metrics, "localized": own})
    localized, truth = evaluation.trajectories.get("localized"), evaluation.trajectories.get("truth")
    if localized is None or truth is None or len(localized) < 2:
        return evaluation
    motion, remarks = map_.T_truth_map if isinstance(map_, Map) else None, evaluation.remarks
    if motion is None:
        motion = carried_to_truth(evaluation, "localized")
        said = (
            "The map does not know where its truth was, so `localized` is carried to the truth by its own best motion."
        )
        remarks = (*remarks, said)
    assert motion is not None
    config = evaluation.config.model_copy(update={"align": "none"})
    found = against_truth(moved(localized, motion), truth, config)
    metrics = {**evaluation.metrics, "localized": {**evaluation.metrics["localized"], **found}}
    return replace(evaluation, metrics=metrics, remarks=remarks)
