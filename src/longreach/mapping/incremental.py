"""A pose graph that grows while a robot drives: keyframe by keyframe, solved when a closure comes.

Between two solutions, new keyframes are dead reckoned: poses and covariances are compounded from the last solved pose
on, which is exact while each keyframe hangs on the one before alone.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from longreach.errors import MappingError
from longreach.geometry import se2
from longreach.mapping import solver
from longreach.mapping.pose_graph import Edges, PoseGraph, adjoints, joined, no_edges
from longreach.mapping.solver import Solved


@dataclass(frozen=True, eq=False)
class State:
    """The last solution, and the keyframes since.

    poses (n, 3): T_map_keyframe of all. tail: an edge each of the keyframes since, from the one before. tail_covariance
    (k, 3, 3): of their poses relative to the last solved one.
    """

    solved: Solved
    poses: Float[np.ndarray, "n 3"]
    tail: tuple[Edges, ...]
    tail_covariance: Float[np.ndarray, "k 3 3"]
    probability: float

    @property
    def graph(self) -> PoseGraph:
        """The graph with all keyframes."""
        before = self.solved.graph
        return PoseGraph(self.poses, joined(before.odometry, *self.tail), before.closures)

    @property
    def weights(self) -> Float[np.ndarray, " mc"]:
        """Of the closures: 1, or 0 where one is withdrawn."""
        return self.solved.weights


def init(graph: PoseGraph | None = None, probability: float = 0.999) -> State:
    """Start with one keyframe in the origin, or with the graph of a map.

    probability: how likely a true closure stays within the bound that withdraws it.
    """
    if graph is None:
        graph = PoseGraph(np.zeros((1, 3)), no_edges(), no_edges())
    return _solved(solver.optimize_robust(graph, probability), probability)


def _solved(solved: Solved, probability: float) -> State:
    return State(solved, solved.poses, (), np.zeros((0, 3, 3)), probability)


def begin(state: State, pose: Float[np.ndarray, "3"]) -> State:
    """Add the first keyframe of another session, which nothing joins with those before until a closure does."""
    graph = state.graph
    more = PoseGraph(np.vstack([graph.poses, pose]), graph.odometry, graph.closures)
    return _solved(solver.optimize(more, state.weights), state.probability)


def moved(state: State, first: int, motion: Float[np.ndarray, "3"]) -> State:
    """Move the keyframes from `first` on by a rigid motion (3,) on the map; nothing joins them with those before."""
    graph, poses = state.graph, state.poses.copy()
    poses[first:] = se2.compose(np.broadcast_to(motion, poses[first:].shape), poses[first:])
    solved = solver.optimize(PoseGraph(poses, graph.odometry, graph.closures), state.weights)
    return _solved(solved, state.probability)


def is_joined(state: State, i: int, j: int) -> bool:
    """Whether edges join two keyframes, as the graph was last solved."""
    part, last = state.solved.factor.part, len(state.solved.poses) - 1
    return bool(part[min(i, last)] == part[min(j, last)])


def step(state: State, odometry: Edges | None = None, closures: Edges | None = None) -> State:
    """Add keyframes with their odometry, and closures.

    odometry: an edge i → j with the next number j makes a keyframe; others join keyframes that are there. closures: all
    are held against each other again, and any can be withdrawn or come back.

    Raises:
        MappingError: an edge joins a keyframe that is not there, or leaves a number out.
    """
    odometry, closures = odometry or no_edges(), closures or no_edges()
    n = len(state.poses)
    poses = _extended(state.poses, odometry)
    if len(odometry) == 1 and not len(closures) and int(odometry.i[0]) == n - 1 and int(odometry.j[0]) == n:
        Ad = adjoints(se2.inverse(odometry.z))
        before = state.tail_covariance[-1] if state.tail else np.zeros((3, 3))
        covariance = np.concatenate([state.tail_covariance, Ad @ before @ Ad.transpose(0, 2, 1) + odometry.covariance])
        return replace(state, poses=poses, tail=(*state.tail, odometry), tail_covariance=covariance)
    if not len(odometry) and not len(closures):
        return state
    before = state.graph
    graph = PoseGraph(poses, joined(before.odometry, odometry), joined(before.closures, closures))
    weights = np.concatenate([state.weights, np.ones(len(closures))])
    solved = solver.optimize(graph, weights)
    within = solved.closure_chi2 <= solver.chi2_quantile(state.probability)
    if not np.array_equal(within, weights == 1):
        solved = solver.optimize_robust(graph, state.probability)
    return _solved(solved, state.probability)


def _extended(poses: np.ndarray, odometry: Edges) -> np.ndarray:
    """Return the poses and those of new keyframes, dead reckoned."""
    for i, j, z in zip(odometry.i.tolist(), odometry.j.tolist(), odometry.z, strict=True):
        if max(i, j) > len(poses) or i == len(poses):
            raise MappingError(
                f"An edge joins keyframes {i} and {j}, and the next new one has the number {len(poses)}."
            )
        if j == len(poses):
            poses = np.vstack([poses, se2.compose(poses[i], z)])
    return poses


def marginals(state: State) -> Float[np.ndarray, "n 3 3"]:
    """Return the covariance of each keyframe's pose; 0 of a first one."""
    last = len(state.solved.poses) - 1
    Ad = adjoints(se2.between(state.poses[last + 1 :], state.poses[last]))
    S = solver.marginals(state.solved)
    return np.concatenate([S, Ad @ S[last] @ Ad.transpose(0, 2, 1) + state.tail_covariance])


def relative_covariances(
    state: State, i: Int[np.ndarray, " k"], j: Int[np.ndarray, " k"]
) -> Float[np.ndarray, "k 3 3"]:
    """Return the covariance of T_i⁻¹ · T_j, in the frame of j, for any pairs of keyframes.

    With s the last solved keyframe, ξ_ij = ξ_sj − Ad(T_j⁻¹ T_i) ξ_si. Noise of the tail that i and j share cancels.
    """
    last = len(state.solved.poses) - 1
    S = np.concatenate([np.zeros((1, 3, 3)), state.tail_covariance])
    tail_i, tail_j = S[np.maximum(i - last, 0)], S[np.maximum(j - last, 0)]
    a, b = np.minimum(i, last), np.minimum(j, last)
    A, to_j = (
        adjoints(se2.between(state.poses[j], state.poses[i])),
        adjoints(se2.between(state.poses[j], state.poses[b])),
    )
    later = (j >= i)[:, None, None]
    own = np.where(later, tail_j - A @ tail_i @ A.transpose(0, 2, 1), A @ tail_i @ A.transpose(0, 2, 1) - tail_j)
    own = np.where(((i > last) & (j > last))[:, None, None], own, tail_j + A @ tail_i @ A.transpose(0, 2, 1))
    solved = solver.relative_covariances(state.solved, a, b)
    joined_parts = np.isfinite(solved[:, 0, 0])[:, None, None]
    return np.where(joined_parts, to_j @ np.where(joined_parts, solved, 0.0) @ to_j.transpose(0, 2, 1) + own, solved)
