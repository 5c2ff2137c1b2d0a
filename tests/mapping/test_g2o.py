import numpy as np
import pytest
from pose_graphs import street_graph

from longreach.errors import LongreachError
from longreach.geometry import se2
from longreach.mapping.g2o import read_g2o, write_g2o
from longreach.mapping.solver import optimize


def test_a_pose_graph_is_read_as_it_was_written_and_solved_alike(rng, tmp_path):
    graph, _, _ = street_graph(rng, n=80, closures=20)
    write_g2o(tmp_path / "graph.g2o", graph)
    again = read_g2o(tmp_path / "graph.g2o")
    np.testing.assert_array_equal(again.poses, graph.poses)
    for one, other in ((again.odometry, graph.odometry), (again.closures, graph.closures)):
        np.testing.assert_array_equal(one.i, other.i)
        np.testing.assert_array_equal(one.j, other.j)
        np.testing.assert_array_equal(one.z, other.z)
        np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-9, atol=1e-16)
    np.testing.assert_allclose(se2.difference(optimize(again).poses, optimize(graph).poses), 0.0, atol=1e-7)


def test_withdrawn_closures_are_left_out(rng, tmp_path):
    graph, _, _ = street_graph(rng, n=80, closures=20)
    weights = (np.arange(20) % 3 > 0).astype(float)
    write_g2o(tmp_path / "graph.g2o", graph, weights)
    np.testing.assert_array_equal(read_g2o(tmp_path / "graph.g2o").closures.z, graph.closures.z[weights > 0])


def test_lines_are_as_g2o_has_them(tmp_path):
    text = (
        "# made by hand\nVERTEX_SE2 7 1 2 0.5\nVERTEX_SE2 3 0 0 0\nVERTEX_XY 9 1 1\nFIX 3\n"
        "EDGE_SE2 3 7 1.0 2.0 0.5 100 1 2 200 3 300\n"
    )
    (tmp_path / "hand.g2o").write_text(text)
    graph = read_g2o(tmp_path / "hand.g2o")
    assert graph.poses.tolist() == [[0.0, 0.0, 0.0], [1.0, 2.0, 0.5]]
    assert (graph.odometry.i.tolist(), graph.odometry.j.tolist()) == ([0], [1])
    information = np.array([[100.0, 1, 2], [1, 200, 3], [2, 3, 300]])
    np.testing.assert_allclose(np.linalg.inv(graph.odometry.covariance[0]), information, atol=1e-9)
    write_g2o(tmp_path / "ours.g2o", graph)
    first, second, fixed, edge = (tmp_path / "ours.g2o").read_text().splitlines()
    assert (first, second, fixed) == ("VERTEX_SE2 0 0.0 0.0 0.0", "VERTEX_SE2 1 1.0 2.0 0.5", "FIX 0")
    assert edge.split()[:3] == ["EDGE_SE2", "0", "1"]
    np.testing.assert_allclose([float(v) for v in edge.split()[3:]], [1, 2, 0.5, 100, 1, 2, 200, 3, 300])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "has no VERTEX_SE2"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n", "has no VERTEX_SE2"),
        ("VERTEX_SE2 0 0 0\n", "line 1: VERTEX_SE2 has 4 or 11 finite numbers"),
        ("VERTEX_SE2 0 0 0 nan\n", "line 1"),
        ("VERTEX_SE2 0 0 0 x\n", "line 1: 'x' is not a number"),
        ("VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 4 1 0 0 1 0 0 1 0 1\n", "an edge joins vertex 4, which is not there"),
        ("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0 0 0\nEDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\n", "is not positive definite"),
    ],
)
def test_a_file_that_is_no_pose_graph_says_why(tmp_path, text, sentence):
    (tmp_path / "x.g2o").write_text(text)
    with pytest.raises(LongreachError, match=sentence):
        read_g2o(tmp_path / "x.g2o")
