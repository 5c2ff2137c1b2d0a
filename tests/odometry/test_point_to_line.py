"""Points against lines: the rows that a match is solved from, and the lines of a keyframe."""

import numpy as np
from jacobians import assert_is_jacobian

from longreach.geometry import se2
from longreach.measurement import LaserScan
from longreach.odometry import _match_kernels
from longreach.odometry.point_to_line import Points, lines_of, points_of
from longreach.odometry.scan_geometry import scan_geometry
from longreach.sim.room import cast, polygonal_room

BEAMS = 360
ANGLES = -np.pi + 2 * np.pi / BEAMS * np.arange(BEAMS)


def seen(pose, walls=None, noise=None):
    walls = polygonal_room() if walls is None else walls
    ranges = cast(walls, np.asarray(pose, dtype=float)[None], ANGLES)[0]
    if noise is not None:
        ranges = ranges + 0.01 * noise.standard_normal(BEAMS)
    geometry = scan_geometry(LaserScan(0.0, ranges, -np.pi, 2 * np.pi / BEAMS), np.eye(4), 5)
    return points_of(ranges, (0.0, np.inf), geometry, np.zeros(3), 0.0), geometry


def rows_at(points: Points, lines, geometry, pose):
    rows = np.empty((_match_kernels.ROWS, BEAMS))
    m = _match_kernels.line_rows(
        *points.xyr, *geometry.finest, geometry.increments[0], lines.beams, lines.lines, pose, 0.2, 0, rows
    )
    return rows[:, :m]


def test_the_rows_are_the_derivative_of_the_distances_by_the_pose():
    wall = np.array([[2.0, -300.0, 2.3, 300.0]])  # one line, so that no point changes its own
    old, geometry = seen(np.zeros(3), wall)
    pose = np.array([0.1, -0.05, 0.02])
    lines, (new, _) = lines_of(old, geometry, np.inf), seen(pose, wall)
    off = se2.compose(pose, np.array([0.02, 0.01, 1e-3]))
    rows = rows_at(new, lines, geometry, off)
    assert rows.shape[1] > 100
    kept = slice(20, 100)  # away from the ends, where a beam may fall off the wall

    def distances(at):
        return rows_at(new, lines, geometry, at)[3, kept]

    def retract(at, xi):
        return se2.compose(at, se2.exp(xi))

    assert_is_jacobian(distances, rows[:3, kept].T, off, retract, atol=1e-4)


def test_at_the_true_pose_the_points_lie_on_the_lines():
    pose = np.array([0.1, -0.05, 0.02])
    (old, geometry), (new, _) = seen(np.zeros(3)), seen(pose)
    rows = rows_at(new, lines_of(old, geometry, np.inf), geometry, pose)
    assert np.median(np.abs(rows[3])) < 1e-6


def test_the_noise_of_a_scan_is_found(rng):
    points, geometry = seen(np.zeros(3), noise=rng)
    assert 0.007 < lines_of(points, geometry, np.inf).noise < 0.014
    assert lines_of(points, geometry, 0.005).noise == 0.005
