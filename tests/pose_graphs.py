"""Pose graphs with known truth: a walk along the streets of a grid, closures where it meets itself, some wrong."""

import numpy as np
from scipy.spatial import cKDTree

from longreach.geometry import se2
from longreach.mapping.pose_graph import Edges, PoseGraph, dead_reckoned

COVARIANCE = np.array([[4e-4, 5e-5, 1e-5], [5e-5, 2e-4, -2e-5], [1e-5, -2e-5, 2.5e-5]])


def walk(rng, n, width=6):
    """Poses (n, 3) of steps of 1 m along the streets of a grid with 4 m between them, `width` streets wide."""
    poses, inside = [np.zeros(3)], 2.0 * width + 0.5
    for k in range(n - 1):
        turn = rng.choice([0.0, np.pi / 2, -np.pi / 2]) if k % 4 == 3 else 0.0
        for _ in range(4):
            following = se2.compose(poses[-1], se2.compose(np.array([0.0, 0.0, turn]), np.array([1.0, 0.0, 0.0])))
            ahead = se2.compose(following, np.array([3.0, 0.0, 0.0]))
            if k % 4 != 3 or np.all(np.abs(ahead[:2]) < inside):
                break
            turn += np.pi / 2
        poses.append(following)
    return np.array(poses)


def measured(rng, truth, i, j, covariance=COVARIANCE):
    """Edges between poses i and j with errors ξ = log(z⁻¹ · truth) of just that covariance."""
    xi = rng.multivariate_normal(np.zeros(3), covariance, len(i))
    z = se2.compose(se2.between(truth[i], truth[j]), se2.exp(-xi))
    return Edges(np.array(i), np.array(j), z, np.repeat(covariance[None], len(i), axis=0))


def street_graph(rng, n=200, closures=60, wrong=0.0, width=6):
    """A graph from dead reckoning, its true poses, and which closures are wrong (m,)."""
    truth = walk(rng, n, width)
    odometry = measured(rng, truth, np.arange(n - 1), np.arange(1, n))
    pairs = cKDTree(truth[:, :2]).query_pairs(1.5, output_type="ndarray")
    pairs = rng.permutation(pairs[np.abs(pairs[:, 1] - pairs[:, 0]) > 10])[:closures]
    good = measured(rng, truth, *pairs.T)
    bad = rng.random(len(pairs)) < wrong
    z = good.z.copy()
    z[bad] = np.column_stack([rng.uniform(-5, 5, (bad.sum(), 2)), rng.uniform(-np.pi, np.pi, bad.sum())])
    poses = dead_reckoned(odometry, truth[0], n)
    return PoseGraph(poses, odometry, Edges(good.i, good.j, z, good.covariance)), truth, bad
