"""Pairwise consistency of closures."""

from itertools import combinations, pairwise

import numpy as np

from longreach.geometry import se2
from longreach.mapping.consistency import chained, cycle_chi2, largest_clique, reversed_edge


def test_the_largest_clique_is_that_of_a_search_through_all_subsets(rng):
    for _ in range(20):
        n = 8
        agree = np.triu(rng.random((n, n)) < 0.6, 1)
        agree = agree | agree.T
        sizes = [k for k in range(1, n + 1) for rows in combinations(range(n), k) if _is_clique(agree, rows)]
        found = largest_clique(agree)
        assert len(found) == max(sizes)
        assert _is_clique(agree, found)
        given = largest_clique(agree, [3])
        assert 3 in given
        assert _is_clique(agree, given)


def _is_clique(agree, rows):
    return all(agree[a, b] for a, b in combinations(rows, 2))


def test_a_cycle_of_true_relative_poses_has_no_error():
    poses = [np.array(p) for p in ((0.0, 0.0, 0.0), (2.0, 1.0, 0.5), (1.0, 4.0, 2.0), (0.0, 0.0, 0.0))]
    edges = [(se2.between(a, b), 0.01 * np.eye(3)) for a, b in pairwise(poses)]
    assert cycle_chi2(*edges) < 1e-20


def test_errors_of_a_cycle_have_the_chi2_of_three_degrees_of_freedom(rng):
    poses = [np.array(p) for p in ((0.0, 0.0, 0.0), (2.0, 1.0, 0.5), (1.0, 4.0, 2.0), (0.0, 0.0, 0.0))]
    sigma = np.array([0.03, 0.01, 0.005])
    values = []
    for _ in range(800):
        edges = [
            (se2.retract(se2.between(a, b), sigma * rng.standard_normal(3)), np.diag(sigma**2))
            for a, b in pairwise(poses)
        ]
        values.append(cycle_chi2(*edges))
    assert 2.7 < np.mean(values) < 3.3


def test_an_edge_reversed_twice_is_the_edge():
    edge = np.array([1.0, -2.0, 0.7]), np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.002], [0.0, 0.002, 0.01]])
    pose, covariance = reversed_edge(reversed_edge(edge))
    np.testing.assert_allclose(pose, edge[0], atol=1e-12)
    np.testing.assert_allclose(covariance, edge[1], atol=1e-12)
    there_and_back, _ = chained(edge, reversed_edge(edge))
    np.testing.assert_allclose(there_and_back, 0.0, atol=1e-12)
