"""The subproblem where its rows contradict each other: all but the box give way, at the merit function's price.

By the same solver as `sequence`, whose rows then have that price; by piqp, with slacks, where it fails.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import piqp
import scipy.sparse as sp
from jaxtyping import Float

from longreach.planning import _sequence_kernels as kernels
from longreach.planning.sequence import Rows, band_of, rows_of
from longreach.planning.subproblem import EXACT, Step, Subproblem

_FLOOR = 1e-8  # curvature where the problem has none
_STIFF = (1e4, 1e2, 1e1)  # of rows that give way only at their price: the first that leads to a solution


def elastic(
    q: Subproblem, A: Float[np.ndarray, "N e n"], c: Float[np.ndarray, "N e"],
    penalties: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> Step | None:  # fmt: skip
    """Return the step that minimises the ℓ1 merit's model within the box; the equations A d = -c give way, too.

    penalties: of the equations (e,), of the rows before the box (r,), and one a link. The answer is None only where
    the solvers fail.
    """
    N, n, _ = q.Z.shape
    e, r = A.shape[1], q.G.shape[1] - n
    whole = replace(q, d0=np.zeros((N, n)))
    Z = np.tile(np.eye(n), (N, 1, 1))
    H = q.Z @ q.H @ q.Z.transpose(0, 2, 1) + _FLOOR * np.eye(n)
    box = np.maximum(q.lower[:, r:], -q.reach), np.minimum(q.upper[:, r:], q.reach)
    bounds = np.hstack([-c, q.lower[:, :r]]), np.hstack([-c, q.upper[:, :r]])
    rows = rows_of(whole, Z, np.concatenate([A, q.G[:, :r]], axis=1), bounds, box)
    on_links = [np.full(link.lower.size, mu) for link, mu in zip(q.limits, penalties[2], strict=True)]
    price = np.concatenate([np.tile(np.hstack(penalties[:2]), N), *on_links, np.full(N * n, np.inf)])
    d, y = _solved(band_of(whole, Z, H), q.g.ravel(), rows, price)
    if len(d) == 0:
        return _by_piqp(q, A, c, penalties)
    stops = np.cumsum([N * (e + r), *(len(on_link) for on_link in on_links)])
    mine, *links, sides = np.split(y, stops)
    mine = mine.reshape(N, e + r)
    multipliers = np.hstack([mine[:, e:], sides.reshape(N, n)])
    return Step(d.reshape(N, n), multipliers, tuple(link.reshape(-1, n) for link in links), mine[:, :e].copy())


def _solved(B: np.ndarray, g: np.ndarray, rows: Rows, price: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the step and all multipliers; empty arrays where no stiffness of the rows leads there."""
    for stiff in _STIFF:
        d, y = np.zeros(len(g)), np.zeros(len(price))
        if kernels.solve(B, g, *rows.parts, price, stiff, np.inf, 100 * EXACT, 100 * EXACT, d, y):
            return d, y
    return np.empty(0), np.empty(0)


def _by_piqp(
    q: Subproblem, A: np.ndarray, c: np.ndarray, penalties: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> Step | None:
    N, n, _ = q.Z.shape
    r = q.G.shape[1] - n
    on_links = [
        (sp.kron(_matrix(link.coefficients, N), sp.eye(n)), link.lower.ravel(), link.upper.ravel(), float(mu))
        for link, mu in zip(q.limits, penalties[2], strict=True)
    ]
    e = A.shape[1]
    rows = sp.vstack([_blocks(A), _blocks(q.G[:, :r]), *(link[0] for link in on_links)])
    low = np.concatenate([q.lower[:, :r].ravel(), *(link[1] for link in on_links)])
    high = np.concatenate([q.upper[:, :r].ravel(), *(link[2] for link in on_links)])
    price = np.concatenate(
        [np.tile(penalties[0], N), np.tile(penalties[1], N), *(np.full(len(link[1]), link[3]) for link in on_links)]
    )
    m = len(price)
    G = sp.hstack([rows, sp.eye(m), -sp.eye(m)]).tocsr()  # low ≤ rows d + s⁺ - s⁻ ≤ high
    P = _cost(q)
    P = sp.block_diag([P, _FLOOR * sp.eye(2 * m)])
    lower = np.concatenate([np.maximum(q.lower[:, r:], -q.reach).ravel(), np.zeros(2 * m)])
    upper = np.concatenate([np.minimum(q.upper[:, r:], q.reach).ravel(), np.full(2 * m, np.inf)])
    solver: Any = piqp.SparseSolver()
    solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = 100 * EXACT
    equations, others = G[: N * e].tocsc(), G[N * e :].tocsc()
    solver.setup(
        sp.triu(P).tocsc(), np.concatenate([q.g.ravel(), price, price]), equations, -c.ravel(), others, low, high,
        lower, upper,
    )  # fmt: skip
    status = solver.solve()
    if status not in (piqp.PIQP_SOLVED, piqp.PIQP_MAX_ITER_REACHED, piqp.PIQP_NUMERICS):
        return None
    x, y = solver.result.x, np.concatenate([solver.result.y, solver.result.z_u - solver.result.z_l])
    box = (solver.result.z_bu - solver.result.z_bl)[: N * n].reshape(N, n)
    stops = np.cumsum([N * e, N * r, *(len(link[1]) for link in on_links)])
    parts = np.split(y, stops[:-1])
    return Step(
        x[: N * n].reshape(N, n).copy(),
        np.hstack([parts[1].reshape(N, r), box]),
        tuple(part.reshape(-1, n) for part in parts[2:]),
        parts[0].reshape(N, e),
    )


def _cost(q: Subproblem) -> sp.csc_matrix:
    N, n, _ = q.Z.shape
    P = _blocks(q.Z @ q.H @ q.Z.transpose(0, 2, 1)) + _FLOOR * sp.eye(N * n)
    for cost in q.costs:
        D = sp.kron(_matrix(cost.coefficients, N), sp.eye(n))
        P = P + D.T @ sp.diags(np.broadcast_to(cost.curvature, (len(cost.coefficients), n)).ravel()) @ D
    return P


def _blocks(A: np.ndarray) -> sp.csc_matrix:
    """Return blocks (N, r, n) down the diagonal."""
    N, r, n = A.shape
    k, i, j = np.meshgrid(np.arange(N), np.arange(r), np.arange(n), indexing="ij")
    return sp.csc_matrix((A.ravel(), ((k * r + i).ravel(), (k * n + j).ravel())), shape=(N * r, N * n))


def _matrix(coefficients: np.ndarray, N: int) -> sp.csc_matrix:
    k, width = coefficients.shape
    rows = np.repeat(np.arange(k), width)
    columns = (np.arange(k)[:, None] + np.arange(width)).ravel()
    return sp.csc_matrix((coefficients.ravel(), (rows, columns)), shape=(k, N))
