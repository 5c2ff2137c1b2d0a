"""Solve a pose graph: Levenberg and Marquardt's method on SE(2), sparse, with covariances and robust closures.

An edge's error is ξ = log(z⁻¹ · T_i⁻¹ · T_j), its cost ξᵀ Σ⁻¹ ξ, and poses move by T · exp(δ). H = Σ Jᵀ Σ⁻¹ J is
factorised as L D Lᵀ over 3 × 3 blocks in an order of minimum degree, and covariances come from the factor.
Source: Grisetti et al. 2010, "A tutorial on graph-based SLAM"; Kaess & Dellaert 2009 for covariances from the factor.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from longreach.errors import MappingError
from longreach.geometry import se2
from longreach.mapping import _sparse_kernels as kernels
from longreach.mapping.pose_graph import Edges, PoseGraph, adjoints, information, innovation_chi2, jacobians, residuals

_STEP = 1e-9  # [m, rad] a step below this is not taken: the poses given back are then their own solution, bit for bit
_ITERATIONS = 50
_ROUNDING = 1e-10  # of the cost: where it should fall by less and does not, that is rounding
_GNC_FACTOR = 1.4  # Yang et al. 2020, remark 5
_STEPS_EACH = 2  # for each μ: the next one moves the poses again


class Order(NamedTuple):
    """In which order poses are eliminated, and where the factor then has blocks; edges of weight 0 count, too."""

    row: np.ndarray  # (n,) the row of each pose
    parent: np.ndarray  # (n,) the elimination tree
    start: np.ndarray  # (n + 1,) of the columns of L
    rows: np.ndarray  # (nnz,)
    place: np.ndarray  # (m,) the block of each edge
    scatter: Any  # (n + nnz, 3 m) sparse: adds up what edges give the diagonal at i, at j, and the block between


@dataclass(frozen=True, eq=False)
class Factor:
    """H = L D Lᵀ at a solution. part (n,): the number of the connected part that each pose is in."""

    order: Order
    fixed: Bool[np.ndarray, " n"]
    part: Int[np.ndarray, " n"]
    inverses: Float[np.ndarray, "n 3 3"]
    blocks: Float[np.ndarray, "nnz 3 3"]

    @cached_property
    def covariances(self) -> tuple[Float[np.ndarray, "n 3 3"], Float[np.ndarray, "nnz 3 3"]]:
        """Covariance of each pose, in the order of the poses, and those of two poses where the factor has a block."""
        S, off, place = self.inverses.copy(), np.zeros_like(self.blocks), np.full(len(self.inverses), -1)
        kernels.marginals(self.order.start, self.order.rows, self.blocks, S, off, place)
        S = S[self.order.row]
        S[self.fixed] = 0.0
        return S, off

    @property
    def marginals(self) -> Float[np.ndarray, "n 3 3"]:
        """Covariance of each pose, in the order of the poses."""
        return self.covariances[0]


@dataclass(frozen=True, eq=False)
class Solved:
    """A pose graph at the poses that fit its edges best.

    weights (mc,): of the closures, 0 where one is withdrawn. chi2 (m,): ξᵀ Σ⁻¹ ξ of every edge without its weight,
    odometry first. status: a sentence that says how it went. factor: for `marginals` and `relative_covariances`.
    """

    graph: PoseGraph
    weights: Float[np.ndarray, " mc"]
    chi2: Float[np.ndarray, " m"]
    iterations: int
    converged: bool
    status: str
    factor: Factor

    @property
    def poses(self) -> Float[np.ndarray, "n 3"]:
        """Poses T_map_keyframe [m, m, rad]."""
        return self.graph.poses

    @property
    def closure_chi2(self) -> Float[np.ndarray, " mc"]:
        """ξᵀ Σ⁻¹ ξ of every closure, withdrawn ones too."""
        return self.chi2[len(self.graph.odometry) :]

    def truncated_cost(self, c2: float) -> float:
        """Return Σ ξᵀ Σ⁻¹ ξ over odometry plus Σ min(ξᵀ Σ⁻¹ ξ, c²) over closures."""
        return float(np.sum(self.chi2) - np.sum(np.maximum(self.closure_chi2 - c2, 0.0)))


def optimize(
    graph: PoseGraph, weights: Float[np.ndarray, " mc"] | None = None, iterations: int = _ITERATIONS
) -> Solved:
    """Move the poses to the least sum of weighted ξᵀ Σ⁻¹ ξ.

    weights (mc,): of the closures, 0 to 1 (default: 1 each). The first pose of each connected part stays.

    Raises:
        MappingError: there is no pose, the weights are not one of 0 to 1 for each closure, or covariances differ by too
            many orders of magnitude.
    """
    mc = len(graph.closures)
    weights = np.ones(mc) if weights is None else np.array(weights, dtype=float)
    if weights.shape != (mc,) or not np.all((weights >= 0) & (weights <= 1)):
        raise MappingError(f"Weights have shape {weights.shape}; give one of 0 to 1 for each of {mc} closures.")
    problem = _Problem(graph)
    return problem.solved(problem.descend(graph.poses, weights, iterations), weights)


def optimize_robust(graph: PoseGraph, probability: float = 0.999) -> Solved:
    """Solve, and withdraw the closures that the others contradict: truncated least squares.

    A closure has the weight 1 while ξᵀ Σ⁻¹ ξ ≤ c², the χ² quantile of `probability` with 3 degrees of freedom, and 0
    otherwise: the cost is Σ min(ξᵀ Σ⁻¹ ξ, c²) over closures. Graduated non-convexity finds the weights, from 1 each, so
    that closures withdrawn before can come back: μ takes the cost from nearly quadratic to truncated. Then those are
    taken back one by one that make the cost smaller by the covariance of the graph.
    Source: Yang, Antonante, Tzoumas & Carlone 2020, "Graduated non-convexity for robust spatial perception", (12)-(14).
    """
    problem, c2 = _Problem(graph), chi2_quantile(probability)
    weights = np.ones(len(graph.closures))
    way = problem.descend(graph.poses, weights, _ITERATIONS)
    r2 = problem.closure_chi2(way)
    mu = 1 / max(2 * np.max(r2, initial=0.0) / c2 - 1, 1e-9)
    while mu < 1e6 and np.any(r2 > c2):
        weights = _truncated_weights(r2, c2, mu)
        way = problem.descend(way.poses, weights, _STEPS_EACH, way.iterations)
        r2, mu = problem.closure_chi2(way), _GNC_FACTOR * mu
        if np.all((weights == 0) | (weights == 1)):
            break
    return _readmitted(problem, *_truncated(problem, way, weights, c2), c2)


def _truncated(problem: "_Problem", way: "_Way", weights: np.ndarray, c2: float) -> tuple["_Way", np.ndarray]:
    """Return a minimum of truncated least squares near by: there, just the closures within c² have weight."""
    for _ in range(_ITERATIONS):
        kept = np.where(problem.closure_chi2(way) <= c2, 1.0, 0.0)
        if np.array_equal(kept, weights) and way.converged:
            break
        weights = kept
        way = problem.descend(way.poses, weights, _ITERATIONS, way.iterations)
    return way, weights


def _readmitted(problem: "_Problem", way: "_Way", weights: np.ndarray, c2: float) -> Solved:
    """Take withdrawn closures back that cost less than c² when the poses give way to them, best first."""
    solved = problem.solved(way, weights)
    tried = weights > 0
    while not np.all(tried):
        waiting = np.flatnonzero(~tried)
        edges = problem.graph.closures[waiting]
        price = innovation_chi2(solved.poses, edges, relative_covariances(solved, edges.i, edges.j))
        if not np.min(price) <= c2:
            break
        k = waiting[np.argmin(price)]
        tried[k] = True
        more = np.where(np.arange(len(weights)) == k, 1.0, solved.weights)
        way = problem.descend(solved.poses, more, _ITERATIONS, solved.iterations)
        other = problem.solved(*_truncated(problem, way, more, c2))
        if other.truncated_cost(c2) < solved.truncated_cost(c2):
            solved = other
    return solved


def _truncated_weights(r2: np.ndarray, c2: float, mu: float) -> np.ndarray:
    """Return (14) of Yang et al. 2020."""
    between = np.sqrt(c2 * mu * (mu + 1) / np.maximum(r2, 1e-300)) - mu
    return np.where(r2 <= mu / (mu + 1) * c2, 1.0, np.where(r2 >= (mu + 1) / mu * c2, 0.0, between))


def chi2_quantile(probability: float) -> float:
    """Return the quantile of χ² with 3 degrees of freedom: 16.27 for 0.999."""
    from scipy.special import gammaincinv  # scipy.stats takes long to import

    return float(2 * gammaincinv(1.5, probability))


class _Way(NamedTuple):
    """Poses on the way to a solution, the residuals there, and how it went."""

    poses: np.ndarray
    e: np.ndarray
    iterations: int
    converged: bool


class _Problem:
    """What is the same for all weights: edges, their information, and the order of elimination."""

    def __init__(self, graph: PoseGraph) -> None:
        if len(graph.poses) == 0:
            raise MappingError("The pose graph has no poses; there is nothing to solve.")
        self.graph, self.edges, self.order = graph, graph.edges, order_of(graph)
        self.information = information(self.edges.covariance)

    def closure_chi2(self, way: _Way) -> np.ndarray:
        closures = slice(len(self.graph.odometry), None)
        return np.einsum("mi,mij,mj->m", way.e[closures], self.information[closures], way.e[closures])

    def descend(self, poses: np.ndarray, weights: np.ndarray, iterations: int, before: int = 0) -> _Way:
        """Levenberg and Marquardt's method, without damping while the cost falls; before: iterations to count, too."""
        system = _System(self, weights)
        e, cost = system.cost(poses)
        damping, taken = 0.0, 0
        while True:
            step, gain = system.step(poses, e, damping)
            if step is not None and damping == 0 and np.max(np.abs(step)) <= _STEP:
                return _Way(poses, e, before + taken, True)
            if taken == iterations or damping > 1e8:
                return _Way(poses, e, before + taken, False)
            if step is not None:
                moved = se2.retract(poses, step)
                e_moved, cost_moved = system.cost(moved)
                if cost_moved < cost:
                    poses, e, cost, taken = moved, e_moved, cost_moved, taken + 1
                    damping = damping / 10 if damping > 1e-6 else 0.0
                    continue
                if damping == 0 and gain <= _ROUNDING * cost:
                    return _Way(poses, e, before + taken, True)
            damping = max(10 * damping, 1e-4)

    def solved(self, way: _Way, weights: np.ndarray) -> Solved:
        system = _System(self, weights)
        if not system.factorize(way.poses, way.e, 0.0):
            raise MappingError("The pose graph cannot be solved: covariances of its edges differ by too many orders.")
        G_inverse = np.linalg.inv(np.tril(system.diagonal))
        column = np.repeat(np.arange(len(G_inverse)), np.diff(self.order.start))
        inverses, blocks = G_inverse.transpose(0, 2, 1) @ G_inverse, system.blocks @ G_inverse[column]
        factor = Factor(self.order, system.fixed[self.order.row], system.part, inverses, blocks)
        chi2 = np.einsum("mi,mij,mj->m", way.e, self.information, way.e)
        graph = PoseGraph(way.poses, self.graph.odometry, self.graph.closures)
        status = f"{'converged' if way.converged else 'not converged'} after {way.iterations} iterations"
        return Solved(graph, weights, chi2, way.iterations, way.converged, status, factor)


class _System:
    """The normal equations with weighted closures. Rows of its arrays are in the order of elimination."""

    def __init__(self, problem: _Problem, weights: np.ndarray) -> None:
        self.edges, self.order = problem.edges, problem.order
        every = np.concatenate([np.ones(len(problem.graph.odometry)), weights])
        self.information = problem.information * every[:, None, None]
        n, row = len(problem.graph.poses), self.order.row
        self.part, fixed = _parts(n, self.edges, every > 0)
        self.fixed = np.empty_like(fixed)
        self.fixed[row] = fixed
        self.ends = row[self.edges.i], row[self.edges.j]
        self.room = np.empty((3, n), dtype=np.int64)

    def cost(self, poses: np.ndarray) -> tuple[np.ndarray, float]:
        e = residuals(poses, self.edges)
        return e, float(np.sum(e * np.einsum("mij,mj->mi", self.information, e)))

    def step(self, poses: np.ndarray, e: np.ndarray, damping: float) -> tuple[np.ndarray | None, float]:
        """Return the step (n, 3) and by how much the linearised cost falls; None where H has no factor."""
        if not self.factorize(poses, e, damping):
            return None, 0.0
        step = -self.gradient
        kernels.solve(self.order.start, self.order.rows, self.diagonal, self.blocks, step)
        return step[self.order.row], float(-np.sum(self.gradient * step))

    def factorize(self, poses: np.ndarray, e: np.ndarray, damping: float) -> bool:
        A, B = jacobians(poses, self.edges, e)
        i, j = self.ends
        A[self.fixed[i]], B[self.fixed[j]] = 0.0, 0.0
        WA, WB, We = self.information @ A, self.information @ B, self.information @ e[:, :, None]
        A, B = A.transpose(0, 2, 1), B.transpose(0, 2, 1)
        off = A @ WB
        off[j > i] = off[j > i].transpose(0, 2, 1)  # L is lower triangular
        terms = np.zeros((3, len(e), 12))  # of the diagonal at i and at j with the gradient, and of the block between
        for k, (block, gradient) in enumerate(((A @ WA, A @ We), (B @ WB, B @ We), (off, 0.0 * We))):
            terms[k, :, :9], terms[k, :, 9:] = block.reshape(-1, 9), gradient[:, :, 0]
        n = len(self.fixed)
        total = self.order.scatter @ terms.reshape(-1, 12)
        H = np.ascontiguousarray(total[:, :9]).reshape(-1, 3, 3)
        self.diagonal, self.blocks, self.gradient = H[:n], H[n:], np.ascontiguousarray(total[:n, 9:])
        self.diagonal[self.fixed] = np.eye(3)  # 1 · δ = 0
        if damping:
            self.diagonal[:, range(3), range(3)] *= 1 + damping
        waiting = np.full(len(self.fixed), -1)
        return kernels.factorize(self.order.start, self.order.rows, self.diagonal, self.blocks, waiting, *self.room)


def order_of(graph: PoseGraph) -> Order:
    """Return an order of elimination of minimum degree, by SuperLU's, and the pattern of the factor."""
    from scipy.sparse import coo_matrix, csr_matrix  # here, for it takes long to import
    from scipy.sparse.linalg import splu

    n, edges = len(graph.poses), graph.edges
    ends = np.concatenate([edges.i, edges.j]), np.concatenate([edges.j, edges.i])
    A = coo_matrix((np.full(len(ends[0]), -1.0), ends), shape=(n, n)).tocsc()
    A.setdiag(1.0 - np.asarray(A.sum(axis=0)).ravel())
    row = splu(A, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).perm_c
    row = row.astype(np.int64)
    low, high = np.minimum(row[edges.i], row[edges.j]), np.maximum(row[edges.i], row[edges.j])
    below = csr_matrix((np.ones(len(low)), (high, low)), shape=(n, n))
    below = below.indptr.astype(np.int64), below.indices.astype(np.int64)
    parent, ancestor, mark, start = np.full(n, -1), np.full(n, -1), np.full(n, -1), np.zeros(n + 1, dtype=np.int64)
    kernels.tree(*below, parent, ancestor, mark, start)
    rows = np.empty(start[-1], dtype=np.int64)
    kernels.pattern(*below, parent, np.full(n, -1), start.copy(), rows)
    column = np.repeat(np.arange(n), np.diff(start))
    place = np.searchsorted(column * n + rows, low * n + high)
    to = np.concatenate([row[edges.i], row[edges.j], n + place])
    scatter = csr_matrix((np.ones(len(to)), (to, np.arange(len(to)))), shape=(n + len(rows), len(to)))
    return Order(row, parent, start, rows, place, scatter)


def _parts(n: int, edges: Edges, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the connected part of each pose, by the edges that count, and which poses are the first of theirs."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    i, j = edges.i[counts], edges.j[counts]
    part = connected_components(coo_matrix((np.ones(len(i)), (i, j)), shape=(n, n)), directed=False)[1]
    fixed = np.zeros(n, dtype=bool)
    fixed[np.unique(part, return_index=True)[1]] = True
    return part.astype(np.int64), fixed


def marginals(solved: Solved) -> Float[np.ndarray, "n 3 3"]:
    """Return the covariance of each pose's ξ = log(mean⁻¹ · truth); 0 of a pose that is fixed."""
    return solved.factor.marginals


def relative_covariances(
    solved: Solved, i: Int[np.ndarray, " k"], j: Int[np.ndarray, " k"]
) -> Float[np.ndarray, "k 3 3"]:
    """Return the covariance of T_i⁻¹ · T_j, in the frame of j, for any pairs of poses, from the factor.

    With A = Ad(T_j⁻¹ T_i): ξ_ij = ξ_j − A ξ_i. What nothing joins has infinite variances.
    Cheapest for many pairs with few different j.
    """
    f, order = solved.factor, solved.factor.order
    cross = np.zeros((len(i), 3, 3))
    for column in np.unique(j).tolist():
        pairs = np.flatnonzero(j == column)
        wanted, row = order.row[i[pairs]], int(order.row[column])
        X, Y = np.zeros_like(f.inverses), np.zeros_like(f.inverses)
        X[row] = np.eye(3)
        needed = np.zeros(len(X), dtype=bool)
        kernels.inverse_column(
            order.parent, order.start, order.rows, f.inverses, f.blocks, row, wanted, needed, X, Y
        )  # fmt: skip
        cross[pairs] = -Y[wanted]
    return _relative(solved, i, j, cross)


def _relative(solved: Solved, i: np.ndarray, j: np.ndarray, cross: np.ndarray) -> np.ndarray:
    """Return the covariances of T_i⁻¹ · T_j from those of ξ_i with ξ_j (k, 3, 3)."""
    f = solved.factor
    S, cross = f.marginals, np.where((f.fixed[i] | f.fixed[j])[:, None, None], 0.0, cross)
    A = adjoints(se2.between(solved.poses[j], solved.poses[i]))
    A_cross = A @ cross
    covariance = S[j] + A @ S[i] @ A.transpose(0, 2, 1) - A_cross - A_cross.transpose(0, 2, 1)
    covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    covariance[f.part[i] != f.part[j]] = np.diag([np.inf] * 3)
    return covariance


def variance_factors(solved: Solved, known: float = 0.0) -> tuple[float, float]:
    """Return by which factors the covariances of odometry and of closures are too small, as their residuals say.

    A group's factor is its Σ ξᵀ Σ⁻¹ ξ over its redundancy Σ (3 - tr Σ⁻¹ P), P the covariance of T_i⁻¹ · T_j after the
    solution: how much of the edges follows from the others. Withdrawn closures do not count.
    known: as much redundancy says that the factor is 1.
    Source: Förstner 1979, "Ein Verfahren zur Schätzung von Varianz- und Kovarianzkomponenten".
    """
    edges, f, m = solved.graph.edges, solved.factor, len(solved.graph.odometry)
    block, row = f.covariances[1][f.order.place], f.order.row
    cross = np.where((row[edges.i] > row[edges.j])[:, None, None], block, block.transpose(0, 2, 1))
    counts = np.concatenate([np.ones(m, dtype=bool), solved.weights > 0.5])
    P = _relative(solved, edges.i, edges.j, cross)
    P[~counts] = 0.0
    redundancy = counts * (3.0 - np.einsum("mij,mji->m", information(edges.covariance), P))
    chi2 = counts * solved.chi2
    odometry, closures = (
        float((known + np.sum(chi2[part])) / max(known + np.sum(redundancy[part]), 1e-9))
        for part in (slice(m), slice(m, None))
    )
    return odometry, closures
