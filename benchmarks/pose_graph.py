"""Pose graphs: time and result of the solver beside gtsam, and time by the number of keyframes.

    OMP_NUM_THREADS=1 python benchmarks/pose_graph.py [--figure FILE]

The peer is not installed with longreach. Make an environment for this benchmark and put both in it:
`pip install . gtsam`. Without gtsam our own times are printed alone.

Bars: 10 ms an iteration and 50 ms for all marginals of 1000 poses and 2000 edges; poses and covariances equal to 1e-6
(covariances relative to the largest). gtsam's Pose2 takes another error than the logarithm for an edge, so its time is
measured with Pose2, and its result with Pose3, whose error is the logarithm, on the same graph in space. Times are the
processor's, medians, so that a busy machine disturbs them little.
"""

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from longreach.geometry import se2
from longreach.mapping import incremental
from longreach.mapping.pose_graph import PoseGraph
from longreach.mapping.solver import marginals, optimize, optimize_robust, relative_covariances

sys.path.append(str(Path(__file__).parents[1] / "tests"))

from pose_graphs import street_graph  # type: ignore[import-not-found]

ROUNDS = 20
PLANAR = [2, 3, 4]  # of Pose3's [ω; v]: θ, x, y
SIZES = (250, 500, 1000, 2000, 4000, 8000)


def milliseconds(function: Callable[[], Any], rounds: int = ROUNDS) -> tuple[float, Any]:
    """Return the median time of a call [ms], after one to warm up, and its result."""
    result, times = function(), []
    for _ in range(rounds):
        began = time.process_time()
        result = function()
        times.append(1e3 * (time.process_time() - began))
    return statistics.median(times), result


def planar_gtsam(graph: PoseGraph) -> tuple[Any, Any]:
    """Return the graph and its poses as gtsam's, with Pose2."""
    import gtsam  # type: ignore[import-not-found]

    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(graph.poses):
        values.insert(k, gtsam.Pose2(*pose))
    factors.add(gtsam.NonlinearEqualityPose2(0, gtsam.Pose2(*graph.poses[0])))
    edges = graph.edges
    for i, j, z, P in zip(edges.i.tolist(), edges.j.tolist(), edges.z, edges.covariance, strict=True):
        factors.add(gtsam.BetweenFactorPose2(i, j, gtsam.Pose2(*z), gtsam.noiseModel.Gaussian.Covariance(P)))
    return factors, values


def spatial_gtsam(graph: PoseGraph) -> tuple[Any, Any]:
    """Return the same graph with Pose3: in the plane, with the logarithm as its error."""
    import gtsam  # type: ignore[import-not-found]

    def pose3(pose: np.ndarray) -> Any:
        return gtsam.Pose3(gtsam.Rot3.Rz(pose[2]), np.array([pose[0], pose[1], 0.0]))

    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, pose in enumerate(graph.poses):
        values.insert(k, pose3(pose))
    factors.add(gtsam.NonlinearEqualityPose3(0, pose3(graph.poses[0])))
    edges = graph.edges
    for i, j, z, P in zip(edges.i.tolist(), edges.j.tolist(), edges.z, edges.covariance, strict=True):
        covariance = 1e-4 * np.eye(6)
        covariance[np.ix_(PLANAR, PLANAR)] = P[np.ix_([2, 0, 1], [2, 0, 1])]
        factors.add(gtsam.BetweenFactorPose3(i, j, pose3(z), gtsam.noiseModel.Gaussian.Covariance(covariance)))
    return factors, values


def solved_by_gtsam(factors: Any, values: Any, iterations: int = 50) -> Any:
    import gtsam  # type: ignore[import-not-found]

    parameters = gtsam.GaussNewtonParams()
    parameters.setMaxIterations(iterations)
    parameters.setRelativeErrorTol(0.0 if iterations > 10 else -1.0)
    parameters.setAbsoluteErrorTol(0.0 if iterations > 10 else -1.0)
    return gtsam.GaussNewtonOptimizer(factors, values, parameters).optimize()


def compare_with_gtsam(graph: PoseGraph) -> None:
    """Print how far our result is from gtsam's, and gtsam's times."""
    import gtsam  # type: ignore[import-not-found]

    solved = optimize(graph)
    factors, values = spatial_gtsam(graph)
    theirs = solved_by_gtsam(factors, values)
    in_space = [theirs.atPose3(k) for k in range(len(graph.poses))]
    poses = np.array([[*pose.translation()[:2], pose.rotation().yaw()] for pose in in_space])
    print(f"poses differ from gtsam's by at most {np.abs(se2.difference(poses, solved.poses)).max():.1e}, bar 1e-6")
    information = gtsam.Marginals(factors, theirs)
    order = np.ix_([PLANAR[1], PLANAR[2], PLANAR[0]], [PLANAR[1], PLANAR[2], PLANAR[0]])
    P = np.array([information.marginalCovariance(k)[order] for k in range(1, len(graph.poses))])
    worst = np.abs(marginals(solved)[1:] - P).max() / np.abs(P).max()
    print(f"marginals differ by at most {worst:.1e} of the largest entry, bar 1e-6")
    factors, values = planar_gtsam(graph)
    one, _ = milliseconds(lambda: solved_by_gtsam(factors, values, 1))
    six, theirs = milliseconds(lambda: solved_by_gtsam(factors, values, 6))

    def all_marginals() -> None:
        information = gtsam.Marginals(factors, theirs)
        for k in range(len(graph.poses)):
            information.marginalCovariance(k)

    every, _ = milliseconds(all_marginals, 3)
    print(f"gtsam, Pose2: {(six - one) / 5:.2f} ms an iteration, all marginals {every:.0f} ms")


def times_of(graph: PoseGraph, rounds: int = ROUNDS) -> tuple[float, float, float, float]:
    """Return times [ms]: an iteration, all marginals, covariances from one keyframe to all others, a solve."""
    one, _ = milliseconds(lambda: optimize(graph, iterations=1), rounds)
    four, _ = milliseconds(lambda: optimize(graph, iterations=4), rounds)
    whole, solved = milliseconds(lambda: optimize(graph), rounds)
    n = len(graph.poses)

    def all_marginals() -> np.ndarray:
        solved.factor.__dict__.pop("marginals", None)  # as if for the first time
        return marginals(solved)

    every, _ = milliseconds(all_marginals, rounds)
    column, _ = milliseconds(lambda: relative_covariances(solved, np.arange(n - 1), np.full(n - 1, n - 1)), rounds)
    return (four - one) / 3, every, column, whole


def a_drive(graph: PoseGraph) -> float:
    """Return the time a keyframe [ms] of a fold with covariances to all others each time."""
    latest = np.maximum(graph.closures.i, graph.closures.j)
    state = incremental.init()
    began = time.process_time()
    for k in range(1, len(graph.poses)):
        state = incremental.step(state, odometry=graph.odometry[k - 1 : k])
        incremental.relative_covariances(state, np.arange(k), np.full(k, k))
        closures = np.flatnonzero(latest == k)
        if len(closures):
            state = incremental.step(state, closures=graph.closures[closures])
    return 1e3 * (time.process_time() - began) / len(graph.poses)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figure", type=Path, help="where to draw the times by the number of keyframes")
    figure = parser.parse_args().figure
    graph, _, _ = street_graph(np.random.default_rng(1), n=1000, closures=1001)
    print(f"{len(graph.poses)} poses, {len(graph.edges)} edges")
    iteration, every, column, whole = times_of(graph)
    print(f"{iteration:.2f} ms an iteration, bar 10; all marginals {every:.2f} ms, bar 50; a solve {whole:.1f} ms")
    print(f"covariances from one keyframe to all others {column:.2f} ms")
    if find_spec("gtsam") is not None:
        compare_with_gtsam(graph)
    else:
        print("gtsam is not installed here (pip install gtsam), so there is nothing to compare with")
    for wrong in (0.0, 0.5):
        mixed, _, bad = street_graph(np.random.default_rng(2), n=1000, closures=1001, wrong=wrong)
        took, solved = milliseconds(lambda graph=mixed: optimize_robust(graph), 3)
        kept, lost = int(np.sum(solved.weights[bad])), int(np.sum(solved.weights[~bad] == 0))
        print(f"robust, {bad.sum()} of {len(bad)} wrong: {took:.0f} ms, {kept} wrong kept, {lost} true withdrawn")
    print("poses  edges  iteration  marginals  to all  a solve [ms]")
    rows = []
    for n in SIZES:
        graph, _, _ = street_graph(np.random.default_rng(3), n=n, closures=n, width=max(6, round((n / 25) ** 0.5)))
        rows.append((n, len(graph.edges), *times_of(graph, 3)))
        print("{:5d} {:6d} {:10.2f} {:10.2f} {:7.2f} {:8.1f}".format(*rows[-1]), flush=True)
    graph, _, _ = street_graph(np.random.default_rng(4), n=1000, closures=200)
    print(f"driving, 1000 keyframes with 200 closures: {a_drive(graph):.2f} ms a keyframe")
    if figure:
        draw(figure, np.array(rows))


def draw(path: Path, rows: np.ndarray) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 4), layout="constrained")
    axes = figure.subplots()
    for k, name in enumerate(("an iteration", "all marginals", "covariances from one to all", "a solve"), 2):
        axes.loglog(rows[:, 0], rows[:, k], "o-", label=name)
    axes.set(xlabel="keyframes, with as many closures", ylabel="time [ms]")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
