"""Sessions of a map: a mapper that begins on a map of before, and the map with the session that it drove."""

import numpy as np
from jaxtyping import Float

from longreach.errors import MappingError
from longreach.geometry import se2
from longreach.mapping import mapper
from longreach.mapping.keyframes import BETWEEN_SESSIONS, MATCHER, Keyframe, with_all_drift
from longreach.mapping.map_file import Map, Session
from longreach.mapping.mapper import MapperState
from longreach.mapping.pose_graph import PoseGraph, joined, no_edges
from longreach.mapping.solver import Solved
from longreach.measurement import LaserScan
from longreach.odometry.matchers.scan_matcher import Features
from longreach.odometry.scan_geometry import ScanGeometry, same_kind, scan_geometry, share_of_a_beam

_MOUNT = 0.05, np.radians(3.0)  # [m, rad] that the mounts of one laser may be apart: calibration moves it by less
_KIND = 0.1  # part by which the view and the increment of one scanner's scans may differ


def begin(map_: Map, T_base_laser: Float[np.ndarray, "4 4"]) -> MapperState:
    """Start a session on a map: where it is on the map is not known."""
    graph = map_.graph
    sure = joined(graph.odometry, graph.closures[map_.weights > 0])
    return mapper.init(T_base_laser, keyframes_of(map_), PoseGraph(graph.poses, sure, no_edges()))


def keyframes_of(map_: Map) -> tuple[Keyframe, ...]:
    """Return the keyframes of a map as they were when it was made: in the frame odom of each session."""
    graph, found, geometry = map_.graph, list[Keyframe](), None
    before = {int(j): e for e, (i, j) in enumerate(zip(graph.odometry.i, graph.odometry.j, strict=True)) if j == i + 1}
    for k, scan in enumerate(map_.scans):
        mount = map_.sessions[int(map_.session[k])].mounts[scan.frame]
        if geometry is None or not same_kind(scan, geometry) or (k and map_.session[k] != map_.session[k - 1]):
            geometry = scan_geometry(scan, mount, 5)
        if k in before:
            moved = graph.odometry.z[before[k]]
            gone = float(np.hypot(*moved[:2]))
            local = graph.odometry.covariance[before[k]]
            covariances = with_all_drift(local, gone), local
            odom, way = se2.compose(found[-1].odom, moved), found[-1].way + gone
        else:
            covariances, odom = (np.zeros((3, 3)), np.zeros((3, 3))), graph.poses[k]
            way = found[-1].way + BETWEEN_SESSIONS if found else 0.0
        twist = map_.twists[k]
        found.append(Keyframe(scan, odom, twist, *covariances, way, _features(scan, geometry, twist)))
    return tuple(found)


def _features(scan: LaserScan, geometry: ScanGeometry, twist: np.ndarray) -> Features:
    sweep = abs(scan.time_increment) * len(scan.ranges)
    motion = se2.adjoint(se2.inverse(geometry.pose_base_laser)) @ twist * sweep
    return MATCHER.features(scan, geometry, motion, share_of_a_beam(scan, sweep))


def map_of(solved: Solved, state: MapperState, session: Session, before: Map | None = None) -> Map:
    """Return the map of a mapper's keyframes as solved, with those of a map that the mapper began on."""
    n, old = len(state.keyframes), before.session if before is not None else np.zeros(0, dtype=int)
    sessions = (*(before.sessions if before is not None else ()), session)
    scans, twists = tuple(k.scan for k in state.keyframes), np.array([k.twist for k in state.keyframes])
    numbers = np.concatenate([old, np.full(n - len(old), len(sessions) - 1)])
    return Map(solved.graph, solved.weights, scans, twists, numbers, sessions)


def check_robot(map_: Map, robot: str, scan: LaserScan, T_base_laser: Float[np.ndarray, "4 4"]) -> None:
    """Raise MappingError where a scan is not from such a laser, mounted as such, as the map's scans are."""
    last = map_.scans[-1]
    session = map_.sessions[int(map_.session[-1])]
    off = np.linalg.inv(session.mounts[last.frame]) @ T_base_laser
    apart, turned = np.linalg.norm(off[:3, 3]), np.arccos(np.clip(0.5 * (np.trace(off[:3, :3]) - 1.0), -1.0, 1.0))
    if apart > _MOUNT[0] or turned > _MOUNT[1]:
        raise MappingError(
            f"The laser of {robot} is mounted {apart:.2f} m and {np.degrees(turned):.0f}° from where that of the map "
            f"is, which is of {session.robot}; give the robot that made the map, or start a map of its own."
        )
    one, other = (np.array([len(s.ranges) * s.angle_increment, s.angle_increment]) for s in (last, scan))
    if np.any(np.abs(one - other) > _KIND * np.abs(one)):
        views = [f"{np.degrees(abs(a)):.0f}° in steps of {np.degrees(abs(step)):.2g}°" for a, step in (other, one)]
        raise MappingError(
            f"The scans are of another laser than the map's: {views[0]}, not {views[1]}; give a recording of "
            f"{session.robot}, or start a map of its own."
        )


def check_new(map_: Map, name: str, scans: tuple[LaserScan, ...]) -> None:
    """Raise MappingError where scans of a recording are keyframes of a map: they would count twice."""
    known = {scan.stamp: scan for scan in scans}
    for scan in map_.scans:
        same = known.get(scan.stamp)
        if same is not None and np.array_equal(same.ranges, scan.ranges, equal_nan=True):
            raise MappingError(f"{name} is in the map already; leave it out.")
