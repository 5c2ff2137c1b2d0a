"""Scans cast in a room and in a corridor, along a path of the base."""

import numpy as np

from longreach.geometry import se2
from longreach.measurement import LaserScan
from longreach.sim.room import cast, polygonal_room

ROOM = polygonal_room()
CORRIDOR = np.array([[-200.0, -1.0, 200.0, -1.0], [-200.0, 1.2, 200.0, 1.2]])
STEP = np.array([0.08, 0.01, 0.03])
NOWHERE = np.eye(4)


def scan_at(pose, stamp=0.0, walls=ROOM, beams=360, fov=2 * np.pi, rng=None, sense=1.0):
    angles = sense * (-fov / 2 + fov / beams * np.arange(beams))
    ranges = cast(walls, np.asarray(pose, dtype=float)[None], angles)[0]
    if rng is not None:
        ranges = ranges + 0.01 * rng.standard_normal(beams)
    return LaserScan(stamp, ranges=ranges, angle_min=angles[0], angle_increment=sense * fov / beams)


def along(motion, count, start=(-1.0, -0.5, 0.2)):
    poses = [np.array(start)]
    for _ in range(count):
        poses.append(se2.compose(poses[-1], np.array(motion)))
    return poses


def scans_along(poses, **kind):
    return [scan_at(pose, 0.1 * i, **kind) for i, pose in enumerate(poses)]


def error_of(match, poses):
    """Of ξ, against where the reference and the scan truly were."""
    reference, now = (poses[round(10 * s)] for s in (match.measurement.stamp_reference, match.stamp))
    return se2.difference(match.measurement.pose, se2.between(reference, now))
