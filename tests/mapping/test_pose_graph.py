import numpy as np
import pytest
from jacobians import assert_is_jacobian
from pose_graphs import COVARIANCE, measured, walk

from longreach.errors import MappingError
from longreach.geometry import se2
from longreach.mapping.pose_graph import (
    Edges,
    PoseGraph,
    adjoints,
    dead_reckoned,
    jacobians,
    joined,
    no_edges,
    residuals,
)


@pytest.mark.parametrize("turn", [0.0, 1e-4, 0.019, 0.021, -0.8, 3.1])
def test_the_jacobians_of_an_edge_agree_with_finite_differences(rng, turn):
    poses = rng.normal(size=(2, 3))
    z = se2.compose(se2.between(poses[0], poses[1]), se2.exp(np.array([0.3, -0.2, turn])))
    edges = Edges(np.array([0]), np.array([1]), z[None], COVARIANCE[None])
    A, B = jacobians(poses, edges, residuals(poses, edges))

    def residual_of_i(pose):
        return residuals(np.stack([pose, poses[1]]), edges)[0]

    def residual_of_j(pose):
        return residuals(np.stack([poses[0], pose]), edges)[0]

    assert_is_jacobian(residual_of_i, A[0], poses[0], retract=se2.retract)
    assert_is_jacobian(residual_of_j, B[0], poses[1], retract=se2.retract)


def test_adjoints_are_those_of_each_pose(rng):
    poses = rng.normal(size=(5, 3))
    np.testing.assert_allclose(adjoints(poses), [se2.adjoint(pose) for pose in poses])


def test_edges_without_errors_have_no_residual_and_dead_reckoning_follows_them(rng):
    truth = walk(rng, 30)
    edges = measured(rng, truth, np.arange(29), np.arange(1, 30), 1e-30 * np.eye(3))
    np.testing.assert_allclose(residuals(truth, edges), 0.0, atol=1e-12)
    np.testing.assert_allclose(se2.difference(truth, dead_reckoned(edges, truth[0], 30)), 0.0, atol=1e-12)


def test_a_missing_step_of_dead_reckoning_is_named(rng):
    edges = measured(rng, walk(rng, 5), np.array([0, 1, 3]), np.array([1, 2, 4]))
    with pytest.raises(MappingError, match="No odometry edge joins pose 2 with pose 3"):
        dead_reckoned(edges, np.zeros(3), 5)


def test_no_edges_are_joined_with_others_without_a_trace(rng):
    edges = measured(rng, walk(rng, 5), np.arange(4), np.arange(1, 5))
    assert len(no_edges()) == 0
    np.testing.assert_array_equal(joined(no_edges(), edges, no_edges()).z, edges.z)
    np.testing.assert_array_equal(edges[edges.i > 1].z, edges.z[2:])


def of_one(i=0, j=1, z=(1.0, 0.0, 0.0), covariance=COVARIANCE):
    return Edges(np.array([i]), np.array([j]), np.array([z], dtype=float), np.array([covariance]))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"j": 0}, "Edge 0 joins pose 0 with itself"),
        ({"z": (np.nan, 0.0, 0.0)}, "z of edges must be finite"),
        ({"covariance": np.diag([1.0, 1.0, 0.0])}, "covariance of edge 0, of poses 0 and 1, is not positive definite"),
        ({"covariance": np.diag([1.0, -1.0, -1.0])}, "not positive definite"),
        ({"covariance": np.diag([1.0, 1.0, np.inf])}, "covariance of edges must be finite"),
        ({"covariance": np.eye(3) + 0.1 * np.eye(3, k=1)}, "not positive definite"),
    ],
)
def test_edges_that_cannot_be_used_are_refused_in_a_sentence(change, sentence):
    of_one()
    with pytest.raises(MappingError, match=sentence):
        of_one(**change)


@pytest.mark.parametrize("end", [-1, 2])
def test_an_edge_of_a_pose_that_is_not_there_is_refused(end):
    with pytest.raises(MappingError, match=rf"joins pose {end}, and the graph has poses 0 to 1"):
        PoseGraph(np.zeros((2, 3)), no_edges(), of_one(i=0, j=end))


def test_poses_that_are_not_finite_are_refused():
    with pytest.raises(MappingError, match="poses must be finite"):
        PoseGraph(np.array([[0.0, 0.0, np.nan]]), no_edges(), no_edges())
