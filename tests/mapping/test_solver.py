import numpy as np
import pytest
from pose_graphs import COVARIANCE, measured, street_graph, walk
from scipy.optimize import least_squares
from scipy.stats import chi2 as chi2_distribution

from longreach.errors import MappingError
from longreach.geometry import se2
from longreach.mapping.pose_graph import Edges, PoseGraph, innovation_chi2, jacobians, joined, no_edges, residuals
from longreach.mapping.solver import (
    chi2_quantile,
    marginals,
    optimize,
    optimize_robust,
    relative_covariances,
    variance_factors,
)


def dense_covariance(solved):
    """(3n, 3n) by inverting the normal equations of a graph of one part, the first pose fixed."""
    graph, n = solved.graph, len(solved.poses)
    edges = graph.edges
    weights = np.concatenate([np.ones(len(graph.odometry)), solved.weights])
    A, B = jacobians(solved.poses, edges, residuals(solved.poses, edges))
    J = np.zeros((len(edges), 3, n, 3))
    rows = np.arange(len(edges))
    J[rows, :, edges.i], J[rows, :, edges.j] = A, B
    J = J.reshape(len(edges), 3, 3 * n)
    H = np.einsum("mai,mab,mbj->ij", J, weights[:, None, None] * np.linalg.inv(edges.covariance), J)
    covariance = np.zeros((3 * n, 3 * n))
    covariance[3:, 3:] = np.linalg.inv(H[3:, 3:])
    return covariance


def wide_start(rng, graph):
    """The same graph with poses off by 0.3 m and 0.3 rad."""
    poses = se2.retract(
        graph.poses, 0.3 * rng.normal(size=graph.poses.shape) * (np.arange(len(graph.poses)) > 0)[:, None]
    )
    return PoseGraph(poses, graph.odometry, graph.closures)


def test_a_solution_is_that_of_a_dense_solver(rng):
    graph, _, _ = street_graph(rng, n=40, closures=15)
    edges, whitener = graph.edges, np.linalg.cholesky(np.linalg.inv(graph.edges.covariance))

    def cost(free):
        poses = np.vstack([graph.poses[:1], free.reshape(-1, 3)])
        return np.einsum("mab,ma->mb", whitener, residuals(poses, edges)).ravel()

    dense = least_squares(cost, graph.poses[1:].ravel(), method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    solved = optimize(wide_start(rng, graph))
    assert solved.converged
    np.testing.assert_allclose(se2.difference(dense.x.reshape(-1, 3), solved.poses[1:]), 0.0, atol=1e-7)
    np.testing.assert_allclose(np.sum(solved.chi2), 2 * dense.cost, rtol=1e-9)


def test_marginals_and_relative_covariances_are_those_of_the_dense_inverse(rng):
    graph, _, _ = street_graph(rng, n=120, closures=80)
    weights = rng.uniform(size=80) * (rng.random(80) < 0.7)
    solved = optimize(graph, weights)
    P = dense_covariance(solved)
    blocks = P.reshape(120, 3, 120, 3).transpose(0, 2, 1, 3)
    scale = np.abs(blocks).max()
    np.testing.assert_allclose(marginals(solved), blocks[np.arange(120), np.arange(120)], atol=1e-9 * scale)
    i, j = rng.integers(0, 120, (2, 100))
    A = np.array([se2.adjoint(pose) for pose in se2.between(solved.poses[j], solved.poses[i])])
    J = np.zeros((100, 3, 120, 3))
    J[np.arange(100), :, j] += np.eye(3)
    J[np.arange(100), :, i] -= A
    J = J.reshape(100, 3, 360)
    np.testing.assert_allclose(relative_covariances(solved, i, j), J @ P @ J.transpose(0, 2, 1), atol=1e-9 * scale)


def test_a_solution_is_solved_again_without_a_change(rng):
    solved = optimize(street_graph(rng)[0])
    again = optimize(solved.graph)
    np.testing.assert_array_equal(again.poses, solved.poses)
    assert again.iterations == 0


def test_a_rigid_motion_of_all_poses_moves_the_solution_and_changes_no_covariance(rng):
    graph, _, _ = street_graph(rng)
    T = np.array([12.0, -7.0, 2.5])
    one = optimize(graph)
    other = optimize(PoseGraph(se2.compose(T, graph.poses), graph.odometry, graph.closures))
    np.testing.assert_allclose(se2.difference(se2.compose(T, one.poses), other.poses), 0.0, atol=1e-7)
    np.testing.assert_allclose(marginals(other), marginals(one), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(other.chi2, one.chi2, rtol=1e-6, atol=1e-9)


def test_the_order_of_keyframes_changes_no_relative_pose_and_no_relative_covariance(rng):
    graph, _, _ = street_graph(rng)
    new = rng.permutation(len(graph.poses))  # where each pose goes

    def moved(edges):
        return Edges(new[edges.i], new[edges.j], edges.z, edges.covariance)

    poses = np.empty_like(graph.poses)
    poses[new] = graph.poses
    one, other = optimize(graph), optimize(PoseGraph(poses, moved(graph.odometry), moved(graph.closures)))
    i, j = rng.integers(0, len(poses), (2, 50))
    here = se2.between(one.poses[i], one.poses[j])
    there = se2.between(other.poses[new[i]], other.poses[new[j]])
    np.testing.assert_allclose(se2.difference(here, there), 0.0, atol=1e-7)
    np.testing.assert_allclose(
        relative_covariances(other, new[i], new[j]), relative_covariances(one, i, j), rtol=1e-6, atol=1e-10
    )


def test_errors_of_solved_poses_are_as_large_as_their_covariances_say(rng):
    runs, n = 300, 40
    truth = walk(rng, n)
    pairs = np.array([[0, 20], [3, 30], [10, 39], [5, 25]])
    nees, relative, cost = [], [], []
    for _ in range(runs):
        odometry = measured(rng, truth, np.arange(n - 1), np.arange(1, n))
        solved = optimize(PoseGraph(truth, odometry, measured(rng, truth, *pairs.T)))
        xi = se2.difference(solved.poses[[20, 39]], truth[[20, 39]])
        nees.append(np.einsum("ni,ni->n", xi, np.linalg.solve(marginals(solved)[[20, 39]], xi[:, :, None])[:, :, 0]))
        i, j = np.array([15, 30]), np.array([22, 8])
        xi = se2.difference(se2.between(solved.poses[i], solved.poses[j]), se2.between(truth[i], truth[j]))
        P = relative_covariances(solved, i, j)
        relative.append(np.einsum("ni,ni->n", xi, np.linalg.solve(P, xi[:, :, None])[:, :, 0]))
        cost.append(np.sum(solved.chi2))
    low, high = chi2_distribution.ppf([1e-4, 1 - 1e-4], 3 * runs) / runs
    for each in (*np.transpose(nees), *np.transpose(relative)):
        assert low < np.mean(each) < high
    low, high = chi2_distribution.ppf([1e-4, 1 - 1e-4], 3 * len(pairs) * runs) / runs  # 3 (m - (n - 1)) free
    assert low < np.mean(cost) < high


def test_wrong_closures_are_withdrawn_and_true_ones_kept_where_half_are_wrong(rng):
    graph, truth, wrong = street_graph(rng, n=300, closures=100, wrong=0.5)
    solved = optimize_robust(graph)
    assert solved.converged
    assert solved.iterations < 130  # 85; 170 where truncated at once, and taken back one by one
    assert np.all(solved.weights[wrong] == 0)
    assert np.mean(solved.weights[~wrong] == 1) > 0.98  # 1 of 1000 true ones lies beyond the quantile
    alone = optimize(PoseGraph(graph.poses, graph.odometry, graph.closures[solved.weights > 0]))
    np.testing.assert_allclose(se2.difference(alone.poses, solved.poses), 0.0, atol=1e-7)
    assert np.linalg.norm(solved.poses[:, :2] - truth[:, :2], axis=1).max() < 1.0
    assert np.linalg.norm(optimize(graph).poses[:, :2] - truth[:, :2], axis=1).max() > 2.0


def test_true_closures_at_the_end_of_a_long_open_stretch_are_taken_back():
    graph, _, wrong = street_graph(np.random.default_rng(5), n=400, closures=60, wrong=0.8, width=10)
    np.testing.assert_array_equal(optimize_robust(graph).weights, ~wrong)  # graduated non-convexity alone loses 5 of 8


def test_without_wrong_closures_a_robust_solution_is_the_plain_one(rng):
    graph, _, _ = street_graph(rng)
    solved = optimize_robust(graph, probability=0.999999)
    assert np.all(solved.weights == 1)
    np.testing.assert_array_equal(solved.poses, optimize(graph).poses)


def test_a_closure_is_withdrawn_by_later_evidence_and_comes_back_when_that_is_gone(rng):
    truth = walk(rng, 200)
    odometry = measured(rng, truth, np.arange(199), np.arange(1, 200))
    start = PoseGraph(truth, odometry, no_edges())
    lies = se2.compose(se2.between(truth[[10]], truth[[190]]), np.array([[0.5, 0.0, 0.0]]))
    wrong = Edges(np.array([10]), np.array([190]), lies, COVARIANCE[None])
    first = optimize_robust(PoseGraph(optimize(start).poses, odometry, wrong))
    assert first.weights.tolist() == [1.0]
    later = measured(rng, truth, np.array([10, 12, 9]), np.array([189, 191, 190]))
    second = optimize_robust(PoseGraph(first.poses, odometry, joined(wrong, later)))
    assert second.weights.tolist() == [0.0, 1.0, 1.0, 1.0]
    third = optimize_robust(PoseGraph(second.poses, odometry, wrong))
    assert third.weights.tolist() == [1.0]


def test_the_chi2_of_a_new_edge_is_what_the_sum_of_errors_grows_by(rng):
    graph, _, _ = street_graph(rng, n=100, closures=20)
    few = optimize(PoseGraph(graph.poses, graph.odometry, graph.closures[:19]))
    more = optimize(PoseGraph(few.poses, graph.odometry, graph.closures))
    new = graph.closures[19:]
    price = innovation_chi2(few.poses, new, relative_covariances(few, new.i, new.j))
    np.testing.assert_allclose(np.sum(more.chi2) - np.sum(few.chi2), price[0], rtol=0.02)


def test_parts_that_nothing_joins_keep_their_first_poses_and_have_infinite_covariance_between_them(rng):
    truth = np.vstack([walk(rng, 20), walk(rng, 20) + np.array([100.0, 0.0, 0.0])])
    i = np.delete(np.arange(39), 19)
    graph = PoseGraph(truth, measured(rng, truth, i, i + 1), measured(rng, truth, np.array([3]), np.array([25])))
    apart = optimize(graph, np.zeros(1))
    np.testing.assert_array_equal(apart.poses[[0, 20]], truth[[0, 20]])
    P = relative_covariances(apart, np.array([3, 3]), np.array([25, 5]))
    assert np.all(np.diag(P[0]) == np.inf)
    assert np.all(np.isfinite(P[1]))
    assert innovation_chi2(apart.poses, graph.closures, P[:1]).tolist() == [0.0]
    together = optimize(graph)
    assert np.all(np.isfinite(relative_covariances(together, np.array([3]), np.array([25]))))
    assert not np.array_equal(together.poses[20], truth[20])


def test_a_single_pose_is_its_own_solution():
    solved = optimize_robust(PoseGraph(np.array([[1.0, 2.0, 3.0]]), no_edges(), no_edges()))
    assert solved.status == "converged after 0 iterations"
    np.testing.assert_array_equal(marginals(solved), np.zeros((1, 3, 3)))


def test_a_solution_that_is_not_reached_says_so(rng):
    solved = optimize(wide_start(rng, street_graph(rng)[0]), iterations=1)
    assert not solved.converged
    assert solved.status == "not converged after 1 iterations"


def test_a_graph_without_poses_and_weights_that_do_not_fit_are_refused_in_a_sentence(rng):
    with pytest.raises(MappingError, match="has no poses"):
        optimize(PoseGraph(np.zeros((0, 3)), no_edges(), no_edges()))
    graph, _, _ = street_graph(rng, n=100, closures=4)
    with pytest.raises(MappingError, match="one of 0 to 1 for each of 4 closures"):
        optimize(graph, np.ones(3))
    with pytest.raises(MappingError, match="one of 0 to 1 for each of 4 closures"):
        optimize(graph, np.array([1.0, 1.0, np.nan, 1.0]))


def test_the_quantile_is_that_of_chi2_with_three_degrees_of_freedom():
    np.testing.assert_allclose(chi2_quantile(0.999), chi2_distribution.ppf(0.999, 3))


def test_covariances_that_are_too_small_or_too_large_are_found_out_by_residuals(rng):
    found = []
    for _ in range(20):
        graph, _, _ = street_graph(rng, n=120, closures=80)
        scaled = [Edges(e.i, e.j, e.z, f * e.covariance) for e, f in ((graph.odometry, 4.0), (graph.closures, 0.25))]
        solved = optimize(PoseGraph(graph.poses, *scaled))
        for _ in range(5):  # a factor at a time is exact only where the other is right
            odometry, closures = variance_factors(solved)
            scaled = [Edges(e.i, e.j, e.z, f * e.covariance) for e, f in zip(scaled, (odometry, closures), strict=True)]
            solved = optimize(PoseGraph(solved.poses, *scaled))
        found.append(
            [scaled[0].covariance[0, 0, 0] / COVARIANCE[0, 0], scaled[1].covariance[0, 0, 0] / COVARIANCE[0, 0]]
        )
    np.testing.assert_allclose(np.mean(found, axis=0), 1.0, atol=0.1)


def test_redundancies_of_all_edges_are_as_many_as_there_are_more_numbers_measured_than_sought(rng):
    solved = optimize(street_graph(rng, n=50, closures=30)[0])
    few = variance_factors(solved), variance_factors(solved, 1000.0)
    chi2 = np.array([solved.chi2[:49].sum(), solved.closure_chi2.sum()])
    assert np.sum(chi2 / few[0]) == pytest.approx(3 * len(solved.graph.closures), rel=1e-3)
    np.testing.assert_allclose(few[1], (1000.0 + chi2) / (1000.0 + chi2 / few[0]))


def test_without_closures_nothing_is_said_of_covariances(rng):
    solved = optimize(
        PoseGraph(walk(rng, 20), measured(rng, walk(rng, 20), np.arange(19), np.arange(1, 20)), no_edges())
    )
    assert variance_factors(solved, 1.0) == pytest.approx((1.0, 1.0), abs=1e-6)
