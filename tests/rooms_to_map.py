"""Rooms to map: drives through walls, and paths that drift from them."""

from itertools import pairwise

import numpy as np

from longreach.geometry import se2
from longreach.mapping import mapper
from longreach.mapping.mapper import PathRow
from longreach.measurement import LaserScan
from longreach.sim.room import box, cast

BEAMS = 180
ANGLES = -np.pi + 2 * np.pi / BEAMS * np.arange(BEAMS)


def rows_of(truth, drift=(0.0, 0.0, 0.0), sigma=(0.02, 0.02, 0.006)):
    """Rows of a path whose every metre is off by a drift (3,), and that says so: sigma (3,) per root of a metre."""
    rows, pose, P = [PathRow(0.0, np.zeros(3), 1e-6 * np.eye(3))], np.zeros(3), 1e-6 * np.eye(3)
    for k, step in enumerate(se2.between(truth[:-1], truth[1:]), 1):
        d = float(np.hypot(*step[:2])) + 0.1 * abs(step[2])
        step = se2.retract(step, d * np.array(drift))
        A = se2.adjoint(se2.inverse(step))
        pose, P = se2.compose(pose, step), A @ P @ A.T + d * np.diag(np.square(sigma)) + 1e-12 * np.eye(3)
        rows.append(PathRow(0.2 * k, pose, P))
    return rows


def scans_of(truth, walls, rng, reach=10.0):
    """Scans with 10 mm of noise, 0.2 s apart."""
    ranges = cast(walls, truth, ANGLES) + 0.01 * rng.standard_normal((len(truth), BEAMS))
    ranges = np.where(ranges < reach, ranges, np.inf)
    return [LaserScan(0.2 * k, r, -np.pi, 2 * np.pi / BEAMS, range_max=reach) for k, r in enumerate(ranges)]


def driven(corners, step=0.25):
    """Poses along straight lines from corner to corner, turning at each."""
    poses = []
    for (x0, y0), (x1, y1) in pairwise(corners):
        to, n = np.arctan2(y1 - y0, x1 - x0), max(round(np.hypot(x1 - x0, y1 - y0) / step), 1)
        if poses:
            turn = (to - poses[-1][2] + np.pi) % (2 * np.pi) - np.pi
            poses += [(x0, y0, poses[-1][2] + turn * k / 8) for k in range(1, 8)]
        poses += [(x0 + (x1 - x0) * k / n, y0 + (y1 - y0) * k / n, to) for k in range(n)]
    return np.array(poses)


def ring(rng):
    """A block with a corridor around it, in which things stand at random; walls (m, 4)."""
    things = [
        box(*at, 0.6, 0.4, rng.uniform(0, 3)) for at in ((4.0, 0.9), (11.0, -0.8), (12.9, 4.0), (11.2, 7.5), (2.0, 8.8))
    ]
    return np.vstack([box(6.0, 4.0, 15.0, 11.0, 0.0), box(6.0, 4.0, 9.0, 5.0, 0.0), *things])


ROUND = [(0.0, 0.0), (12.0, 0.0), (12.0, 8.0), (0.0, 8.0), (0.0, 0.0)]


def mapped(truth, walls, rng, **drift):
    """The mapper after a drive."""
    return mapper.settled(mapper.step(mapper.init(np.eye(4)), scans_of(truth, walls, rng), rows_of(truth, **drift)))
