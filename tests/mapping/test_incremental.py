import numpy as np
import pytest
from pose_graphs import COVARIANCE, measured, street_graph, walk

from longreach.errors import MappingError
from longreach.geometry import se2
from longreach.mapping import incremental, solver
from longreach.mapping.pose_graph import Edges, PoseGraph


def driven(graph, until=None):
    """A graph's fold: keyframe by keyframe, each closure when its later keyframe is there."""
    state = incremental.init()
    for k in range(1, until or len(graph.poses)):
        state = incremental.step(state, odometry=graph.odometry[graph.odometry.j == k])
        now = np.maximum(graph.closures.i, graph.closures.j) == k
        state = incremental.step(state, closures=graph.closures[now])
    return state


def edge(rng, k):
    """From keyframe k - 1 to k, anywhere."""
    return Edges(np.array([k - 1]), np.array([k]), rng.normal(size=(1, 3)), COVARIANCE[None])


def test_a_file_is_a_fold_of_its_keyframes(rng):
    graph, _, wrong = street_graph(rng, n=120, closures=40, wrong=0.2)
    state, batch = driven(graph), solver.optimize_robust(graph)
    order = np.argsort(np.maximum(graph.closures.i, graph.closures.j), kind="stable")
    np.testing.assert_array_equal(state.weights, batch.weights[order])
    assert np.all(batch.weights[wrong] == 0)
    np.testing.assert_allclose(se2.difference(batch.poses, state.poses), 0.0, atol=1e-7)
    np.testing.assert_allclose(incremental.marginals(state), solver.marginals(batch), rtol=1e-5, atol=1e-12)


def test_covariances_of_keyframes_since_the_last_solution_are_those_of_a_new_one(rng):
    graph, _, _ = street_graph(rng, n=100, closures=30)
    last = int(np.max([graph.closures.i, graph.closures.j]))
    state = driven(graph, until=last + 1)
    n = last + 13
    for k in range(last + 1, n):
        state = incremental.step(state, odometry=edge(rng, k))
    fresh = solver.optimize(state.graph, state.weights)
    np.testing.assert_allclose(se2.difference(fresh.poses, state.poses), 0.0, atol=1e-7)
    np.testing.assert_allclose(incremental.marginals(state), solver.marginals(fresh), rtol=1e-6, atol=1e-12)
    i, j = (
        pairs.ravel() for pairs in np.meshgrid([2, last - 1, last, last + 1, n - 5, n - 1], [0, last, n - 7, n - 1])
    )
    np.testing.assert_allclose(
        incremental.relative_covariances(state, i, j), solver.relative_covariances(fresh, i, j), rtol=1e-6, atol=1e-10
    )


def test_dead_reckoning_solves_nothing_and_a_closure_does(rng):
    truth = walk(rng, 30)
    state = incremental.init()
    first = state.solved
    for k in range(1, 30):
        state = incremental.step(state, odometry=measured(rng, truth, np.array([k - 1]), np.array([k])))
    assert state.solved is first
    state = incremental.step(state, closures=measured(rng, truth, np.array([2]), np.array([29])))
    assert len(state.solved.poses) == 30
    assert state.tail == ()


def test_a_second_session_is_joined_by_its_first_closure(rng):
    truth = walk(rng, 20)
    odometry = measured(rng, truth, np.arange(19), np.arange(1, 20))
    state = incremental.init(PoseGraph(truth, odometry, measured(rng, truth, np.array([0]), np.array([19]))))
    state = incremental.begin(state, np.array([50.0, 0.0, 0.0]))
    state = incremental.step(state, odometry=Edges(np.array([20]), np.array([21]), odometry.z[:1], COVARIANCE[None]))
    pair = np.array([3]), np.array([21])
    assert np.isinf(incremental.relative_covariances(state, *pair)[0, 0, 0])
    assert np.all(np.isfinite(incremental.relative_covariances(state, np.array([20]), np.array([21]))))
    z = np.array([[0.0, 1.0, 0.5]])
    state = incremental.step(state, closures=Edges(*pair, z, COVARIANCE[None]))
    np.testing.assert_allclose(se2.difference(se2.compose(state.poses[3], z[0]), state.poses[21]), 0.0, atol=1e-8)
    assert np.all(np.isfinite(incremental.relative_covariances(state, *pair)))


def test_nothing_new_changes_nothing():
    state = incremental.init()
    assert incremental.step(state) is state


@pytest.mark.parametrize("ends", [(0, 2), (1, 0), (2, 1)])
def test_an_edge_that_leaves_a_keyframe_out_is_refused(ends):
    i, j = np.array(ends).reshape(2, 1)
    with pytest.raises(MappingError, match="the next new one has the number 1"):
        incremental.step(incremental.init(), odometry=Edges(i, j, np.zeros((1, 3)), COVARIANCE[None]))
