"""Maps of the room of `room_scans`, made of scans at poses that are known, and the way of a base through it."""

import numpy as np
from room_scans import NOWHERE, ROOM, scan_at

from longreach.evaluation.alignment import rigid_alignment
from longreach.geometry import se2
from longreach.mapping.map_file import Map, Session
from longreach.mapping.mapper import PathRow
from longreach.mapping.pose_graph import Edges, PoseGraph, no_edges

SIGMAS = np.array([0.002, 0.002, 0.001])  # of a map's poses, from keyframe to keyframe


def walk(step=0.25, turns=1.0):
    """Poses (3,) on a circle through the room, `step` [m] apart."""
    radius = 0.8
    count = int(2 * np.pi * radius * turns / step)
    t = step / radius * np.arange(count)
    return [np.array([radius * np.sin(a), -radius * np.cos(a), a]) for a in t]


def map_along(poses, rng, walls=ROOM, beams=360):
    """The map of scans at poses, which are in it as they truly are."""
    return _map_of(np.array(poses), np.array(poses), rng, walls, beams)


def wrong_map_along(poses, rng, walls=ROOM, beams=360):
    """The same, with keyframes that are off as their covariances say, carried to the truth as well as that goes."""
    true, steps = np.array(poses), SIGMAS * rng.standard_normal((len(poses), 3))
    found = [true[0]]
    for k in range(1, len(true)):
        found.append(se2.retract(se2.compose(found[-1], se2.between(true[k - 1], true[k])), steps[k]))
    carried = rigid_alignment(np.array(found)[:, :2], true[:, :2])
    return _map_of(true, np.array([se2.compose(carried, pose) for pose in found]), rng, walls, beams)


def _map_of(true, poses, rng, walls, beams):
    n = len(poses)
    edges = Edges(
        np.arange(n - 1), np.arange(1, n), se2.between(poses[:-1], poses[1:]), np.stack([np.diag(SIGMAS**2)] * (n - 1))
    )
    scans = tuple(scan_at(pose, 0.5 * k, walls, beams, rng=rng) for k, pose in enumerate(true))
    session = Session("room", "none", {scans[0].frame: NOWHERE})
    return Map(PoseGraph(poses, edges, no_edges()), np.zeros(0), scans, np.zeros((n, 3)), np.zeros(n, int), (session,))


def rows_along(poses, rng, drift=0.0, walls=ROOM, beams=360):
    """Scans at poses, 0.1 s apart, and the rows of an odometry that drifts by a part of the way, and says so."""
    at, P, rows = np.zeros(3), np.diag([1e-8, 1e-8, 1e-9]), []
    for k, pose in enumerate(poses):
        if k:
            moved = se2.between(poses[k - 1], pose)
            moved = moved * [1.0 + drift, 1.0, 1.0 + 0.2 * drift]
            A, way = se2.adjoint(se2.inverse(moved)), np.hypot(*moved[:2])
            P = A @ P @ A.T + np.diag([(drift * way) ** 2, 1e-10, 1e-10])
            at = se2.compose(at, moved)
        rows.append(PathRow(0.1 * k, at, P))
    scans = [scan_at(pose, 0.1 * k, walls, beams, rng=rng) for k, pose in enumerate(poses)]
    return scans, rows
