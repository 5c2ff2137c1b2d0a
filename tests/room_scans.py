"""Scans cast in a room and in a corridor, along a path of the base."""

import numpy as np

from longreach.geometry import se2
from longreach.measurement import LaserScan
from longreach.odometry import local_map
from longreach.odometry.lidar import LidarConfig, matcher_of
from longreach.odometry.scan_geometry import scan_geometry
from longreach.sim.room import cast, polygonal_room

ROOM = polygonal_room()
CORRIDOR = np.array([[-200.0, -1.0, 200.0, -1.0], [-200.0, 1.2, 200.0, 1.2]])
STEP = np.array([0.08, 0.01, 0.03])
NOWHERE = np.eye(4)
POINT_TO_LINE = matcher_of(LidarConfig())


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


def features_of(scan, T_base_laser=NOWHERE, motion=(0.0, 0.0, 0.0), share=0.0):
    """Features of a scan for point-to-line matching; motion (3,): of the laser, from scan to scan."""
    return POINT_TO_LINE.features(scan, scan_geometry(scan, T_base_laser, 5), np.array(motion), share)


def map_of(poses, **kind):
    """The local map of scans taken at poses, each placed where it was taken."""
    return local_map.merged([local_map.keyframe(features_of(scan_at(pose, **kind)), np.array(pose)) for pose in poses])


def sweeps_along(poses, twists, n=360, walls=ROOM):
    """Ranges of sweeps from -π on that begin at poses and move on by a twist each."""
    angles = -np.pi + 2 * np.pi / n * np.arange(n)
    starts = [
        [se2.compose(pose, se2.exp(twist * k / n))[None] for k in range(n)]
        for pose, twist in zip(poses, twists, strict=True)
    ]
    return [np.array([cast(walls, at, angles[k : k + 1])[0, 0] for k, at in enumerate(swept)]) for swept in starts]


def normalized(error, covariance):
    """The squared error over its covariance: NEES."""
    return error @ np.linalg.solve(covariance, error)
