"""The subproblems of a whole trajectory, by piqp.

Of the many rows few ever bind, so that a row takes part only once a solution has been near it.
"""

from typing import Any

import numpy as np
import piqp
import scipy.sparse as sp
from jaxtyping import Float

from longreach.planning.subproblem import Difference, Step, Subproblem

_CROSSED = 1e-9  # by which a row must be violated to take part
_BINDS = 1e-9  # a multiplier that is more than rounding
_NEAR = 2e-4  # [m, rad] from a bound: the next step may come to it
_ROUNDS = 30

Rows = tuple[sp.csr_matrix, np.ndarray, np.ndarray]


class Sequence:
    """The subproblems of one trajectory: it remembers which rows were near the last one's solution."""

    def __init__(self) -> None:
        self.part = np.zeros(0, dtype=bool)
        self.pull = np.zeros(0)

    def solve(self, q: Subproblem) -> Step | None:
        """Return the step, or None where the rows contradict each other."""
        P, c = _curvature(q)
        G, low, high = _rows(q)
        if len(self.part) != len(low):
            self.part, self.pull = np.zeros(len(low), dtype=bool), np.zeros(len(low))
        for _ in range(_ROUNDS):
            found = _piqp(P, c, (G[self.part], low[self.part], high[self.part]), q.reach, q.exact)
            if found is None:
                return None
            v = G @ found[0]
            new = ((v < low - _CROSSED) | (v > high + _CROSSED)) & ~self.part
            if not new.any():
                self.pull[:] = 0.0
                self.pull[self.part] = found[1]
                self.part = (np.abs(self.pull) > _BINDS) | (v < low + _NEAR) | (v > high - _NEAR)
                return self._step(q, found[0])
            self.part |= new
        return None

    def _step(self, q: Subproblem, z: np.ndarray) -> Step:
        """Return the step with each row's multiplier."""
        N, _, p = q.Z.shape
        shapes = [q.lower.shape, *(link.lower.shape for link in q.limits)]
        parts = np.split(self.pull, np.cumsum([a * b for a, b in shapes])[:-1])
        rows, *links = (part.reshape(shape).copy() for part, shape in zip(parts, shapes, strict=True))
        return Step(q.d0 + np.einsum("kjp,kp->kj", q.Z, z.reshape(N, p)), rows, tuple(links))


def _rows(q: Subproblem) -> Rows:
    """Return all rows in z, the waypoints' and then the links', with their bounds."""
    N, _, p = q.Z.shape
    GZ = q.G @ q.Z
    r = GZ.shape[1]
    at = np.einsum("krj,kj->kr", q.G, q.d0)
    data, low, high = [GZ.ravel()], [(q.lower - at).ravel()], [(q.upper - at).ravel()]
    columns = [(np.arange(N)[:, None, None] * p + np.zeros((r, 1), dtype=int) + np.arange(p)).ravel()]
    counts = [np.full(N * r, p)]
    for link in q.limits:
        k, n = link.lower.shape
        width = link.coefficients.shape[1]
        terms = [link.coefficients[:, i, None, None] * q.Z[i : i + k] for i in range(width)]
        data.append(np.stack(terms, axis=2).ravel())  # (k, n, width, p)
        columns.append((np.arange(k)[:, None, None] * p + np.zeros((n, 1), dtype=int) + np.arange(width * p)).ravel())
        counts.append(np.full(k * n, width * p))
        at = link.of(q.d0)
        low.append((link.lower - at).ravel())
        high.append((link.upper - at).ravel())
    starts = np.concatenate([[0], np.cumsum(np.concatenate(counts))])
    G = sp.csr_matrix((np.concatenate(data), np.concatenate(columns), starts), shape=(len(starts) - 1, N * p))
    return G, np.concatenate(low), np.concatenate(high)


def link_bands(Z: Float[np.ndarray, "N n p"], costs: tuple[Difference, ...]) -> list[np.ndarray]:
    """Return the links' curvature in z: blocks (N - o, p, p) of waypoints k and k + o, for o = 0, 1, ..."""
    N, _, p = Z.shape
    width = max((cost.coefficients.shape[1] for cost in costs), default=1)
    bands = [np.zeros((N - o, p, p)) for o in range(width)]
    for cost in costs:
        k, width = cost.coefficients.shape
        for i in range(width):
            for j in range(i, width):
                weight = (
                    np.broadcast_to(cost.curvature, (k, Z.shape[1]))
                    * (cost.coefficients[:, i] * cost.coefficients[:, j])[:, None]
                )
                bands[j - i][i : i + k] += (Z[i : i + k] * weight[:, :, None]).transpose(0, 2, 1) @ Z[j : j + k]
    return bands


def banded(bands: list[np.ndarray]) -> np.ndarray:
    """Return the symmetric matrix of blocks, see `link_bands`, by its lower band (N p, width), see `mend`."""
    N, p, _ = bands[0].shape
    width = p * len(bands)
    out = np.zeros((N * p, width))
    a, b = np.meshgrid(np.arange(p), np.arange(p), indexing="ij")
    for o, band in enumerate(bands):
        i = (np.arange(o, N)[:, None] * p + b.ravel()).ravel()
        j = (np.arange(N - o)[:, None] * p + a.ravel()).ravel()
        keep = i >= j
        out[i[keep], (width - 1 - i + j)[keep]] = band.ravel()[keep]
    return out


def _curvature(q: Subproblem) -> tuple[sp.csc_matrix, np.ndarray]:
    """Return the upper triangle of the quadratic cost in z, and its gradient at z = 0."""
    N, _, p = q.Z.shape
    bands = link_bands(q.Z, q.costs)
    bands[0] += q.H
    g = q.g
    for cost in q.costs:
        g = g + cost.pull(q.d0)
    a, b = np.meshgrid(np.arange(p), np.arange(p), indexing="ij")
    rows, columns, data = [], [], []
    for o, band in enumerate(bands):
        keep = a <= b if o == 0 else np.ones((p, p), dtype=bool)
        start = np.arange(N - o)[:, None] * p
        rows.append((start + a[keep]).ravel())
        columns.append((start + o * p + b[keep]).ravel())
        data.append(band[:, keep].ravel())
    place = (np.concatenate(rows), np.concatenate(columns))
    P = sp.csc_matrix((np.concatenate(data), place), shape=(N * p, N * p))
    return P, np.einsum("kjp,kj->kp", q.Z, g).ravel()


def _piqp(
    P: sp.csc_matrix, c: np.ndarray, rows: Rows, reach: float, exact: float
) -> tuple[np.ndarray, np.ndarray] | None:
    solver: Any = piqp.SparseSolver()
    solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = exact
    solver.settings.eps_rel = solver.settings.eps_duality_gap_rel = 0.1 * exact
    solver.settings.preconditioner_iter = 2  # a waypoint's numbers are of like size
    box = np.full(len(c), reach)
    G, low, high = rows
    some = len(low) > 0
    solver.setup(P, c, None, None, *((G.tocsc(), low, high) if some else (None, None, None)), -box, box)
    status, result = solver.solve(), solver.result
    nearly = status in (piqp.PIQP_MAX_ITER_REACHED, piqp.PIQP_NUMERICS)
    if status != piqp.PIQP_SOLVED and not (nearly and max(result.info.primal_res, result.info.dual_res) < 1e-7):
        return None
    if not some:
        return np.array(result.x), np.empty(0)
    y = result.z_u - result.z_l
    slack = np.minimum(result.s_l, result.s_u)
    return np.array(result.x), np.where(np.abs(y) > slack, y, 0.0)  # an interior point leaves a little everywhere
