"""Pose graphs as g2o text: `VERTEX_SE2 id x y θ`, `EDGE_SE2 i j x y θ` and the information's upper triangle."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from longreach.errors import MappingError
from longreach.io.text_lines import numbers, text_lines
from longreach.io.whole_files import write_text
from longreach.mapping.pose_graph import Edges, PoseGraph, information, positive_definite

_UPPER = ([0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2])


def write_g2o(path: Path, graph: PoseGraph, weights: Float[np.ndarray, " mc"] | None = None) -> None:
    """Write a pose graph, without the closures whose weight is 0; the first pose is fixed."""
    lines = [f"VERTEX_SE2 {k} {x!r} {y!r} {t!r}" for k, (x, y, t) in enumerate(graph.poses.tolist())]
    lines.append("FIX 0")
    kept = graph.closures if weights is None else graph.closures[weights > 0]
    for edges in (graph.odometry, kept):
        upper = information(edges.covariance)[:, *_UPPER]
        rows = np.column_stack([edges.z, upper]).tolist()
        for i, j, row in zip(edges.i.tolist(), edges.j.tolist(), rows, strict=True):
            lines.append(f"EDGE_SE2 {i} {j} {' '.join(map(repr, row))}")
    write_text(path, "\n".join(lines) + "\n")


def read_g2o(path: Path) -> PoseGraph:
    """Read the vertices and edges on SE(2), vertices in the order of their ids; other lines are left out.

    Edges from each vertex to the next one are taken as odometry, all others as closures. g2o's error of an edge and the
    logarithm agree to first order.

    Raises:
        LongreachError: the file cannot be read, has no vertex, or a line with too few numbers; an edge joins a vertex
            that is not there, or its information is not positive definite.
    """
    vertices, edges = {}, []
    for line, text in text_lines(path):
        tag, *words = text.split()
        if tag not in ("VERTEX_SE2", "EDGE_SE2"):
            continue
        row = numbers(path, line, words)
        if len(row) != (4 if tag == "VERTEX_SE2" else 11) or not np.all(np.isfinite(row)):
            raise MappingError(f"{path}, line {line}: {tag} has 4 or 11 finite numbers, VERTEX_SE2 or EDGE_SE2.")
        if tag == "VERTEX_SE2":
            vertices[int(row[0])] = row[1:]
        else:
            edges.append(row)
    if not vertices:
        raise MappingError(f"{path} has no VERTEX_SE2; it is no pose graph in the plane.")
    place = {vertex: k for k, vertex in enumerate(sorted(vertices))}
    table = np.array(edges).reshape(-1, 11)
    for end in table[:, :2].ravel().astype(int).tolist():
        if end not in place:
            raise MappingError(f"{path}: an edge joins vertex {end}, which is not there.")
    W = np.empty((len(table), 3, 3))
    W[:, *_UPPER] = table[:, 5:]
    W[:, *_UPPER[::-1]] = table[:, 5:]
    for e in np.flatnonzero(~positive_definite(W)).tolist():
        raise MappingError(f"{path}: the information of edge {e}, of those on SE(2), is not positive definite.")
    i, j = (np.array([place[int(v)] for v in table[:, k]], dtype=np.int64) for k in (0, 1))
    every = Edges(i, j, table[:, 2:5], information(W))
    poses = np.array([vertices[vertex] for vertex in sorted(vertices)])
    steps = every.j == every.i + 1
    return PoseGraph(poses, every[steps], every[~steps])
