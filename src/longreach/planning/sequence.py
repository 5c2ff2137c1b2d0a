"""The subproblems of a whole trajectory: our own solver, which knows that only neighbours are coupled, else piqp."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import piqp
import scipy.sparse as sp
from jaxtyping import Float

from longreach.planning import _band_kernels as bands
from longreach.planning import _sequence_kernels as kernels
from longreach.planning.subproblem import Difference, Step, Subproblem

_NEAR = 0.1  # part of the trust region: what is so near a bound takes part at first
_FIRST, _LATER = 30.0, 1e3  # stiffness of rows in the curvature's measure, without multipliers to start from and with
_TIGHT = 1e-2  # violations of rows per slope that is left: many small ones add up in the merit
_NEXT = 2.0  # steps farther than the last one, a bound takes no part at first


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows a z in z (N p,): a is data[i, :count[i]] from first[i] on. Bounds low and high of them, and last of z."""

    data: Float[np.ndarray, "m w"]
    first: np.ndarray
    count: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @property
    def parts(self) -> tuple[np.ndarray, ...]:
        """All arrays, in this order."""
        return self.data, self.first, self.count, self.low, self.high


class Sequence:
    """The subproblems of one trajectory: it remembers what the last one's rows pulled, and how far it went."""

    def __init__(self) -> None:
        self.pulls = np.zeros(0)
        self.far = 0.0

    def solve(self, q: Subproblem) -> Step | None:
        """Return the step, or None where the rows contradict each other."""
        N, _, p = q.Z.shape
        box = np.full((N, p), q.reach)
        rows = rows_of(q, q.Z, q.G, (q.lower, q.upper), (-box, box))
        z, y = np.zeros(N * p), np.zeros(len(rows.low))
        if p == 0:
            return _step(q, z, y) if np.all((rows.low <= q.exact) & (rows.high >= -q.exact)) else None
        B = band_of(q, q.Z, q.H)
        c = np.einsum("kjp,kj->kp", q.Z, sum((cost.pull(q.d0) for cost in q.costs), q.g)).ravel()
        stiff, near = _FIRST, _NEAR * q.reach
        if len(self.pulls) == len(y):
            y[:], stiff, near = self.pulls, _LATER, _NEXT * self.far
        stiff *= float(np.median(B[:, -1]))
        prices = np.full(len(y), np.inf)
        if not kernels.solve(B, c, *rows.parts, prices, stiff, near, q.exact, _TIGHT * q.exact, z, y):
            found = _piqp(B, c, rows, q.exact)
            if found is None:
                return None
            z, y = found
        self.pulls, self.far = y, float(np.abs(z).max())
        return _step(q, z, y)


def _step(q: Subproblem, z: np.ndarray, y: np.ndarray) -> Step:
    """Return the step with each row's multiplier."""
    N, _, p = q.Z.shape
    shapes = [q.lower.shape, *(link.lower.shape for link in q.limits)]
    parts = np.split(y, np.cumsum([a * b for a, b in shapes]))
    rows, *links = (part.reshape(shape).copy() for part, shape in zip(parts, shapes, strict=False))
    return Step(q.d0 + np.einsum("kjp,kp->kj", q.Z, z.reshape(N, p)), rows, tuple(links))


def rows_of(
    q: Subproblem, Z: Float[np.ndarray, "N n p"], G: Float[np.ndarray, "N r n"],
    bounds: tuple[np.ndarray, np.ndarray], box: tuple[np.ndarray, np.ndarray],
) -> Rows:  # fmt: skip
    """Return the rows G, then the links', in z of d = d₀ + Z z, with their bounds and the box's on z."""
    N, n, p = Z.shape
    r = G.shape[1]
    stops = np.cumsum([N * r, *(link.lower.size for link in q.limits)])
    data = np.zeros((stops[-1], p * _width(q)))
    at = np.zeros(stops[-1] + N * p)
    kernels.waypoint_rows(G, Z, q.d0, data, at)
    first, count = [np.repeat(np.arange(N) * p, r)], [np.full(N * r, p)]
    for link, start, stop in zip(q.limits, stops[:-1], stops[1:], strict=True):
        k, width = link.coefficients.shape
        kernels.link_rows(link.coefficients, Z, q.d0, data[start:stop], at[start:stop])
        first.append(np.repeat(np.arange(k) * p, n))
        count.append(np.full(k * n, width * p))
    low = np.concatenate([bounds[0].ravel(), *(link.lower.ravel() for link in q.limits), box[0].ravel()])
    high = np.concatenate([bounds[1].ravel(), *(link.upper.ravel() for link in q.limits), box[1].ravel()])
    return Rows(data, np.concatenate(first), np.concatenate(count), low - at, high - at)


def _width(q: Subproblem) -> int:
    """Return how many neighbours are coupled at once."""
    return max((link.coefficients.shape[1] for link in (*q.costs, *q.limits)), default=1)


def add_costs(Z: Float[np.ndarray, "N n p"], costs: tuple[Difference, ...], B: Float[np.ndarray, "Np w"]) -> None:
    """Add the links' curvature in z to the band B."""
    for cost in costs:
        shape = (len(cost.coefficients), Z.shape[1])
        curvature = np.ascontiguousarray(np.broadcast_to(np.asarray(cost.curvature, dtype=float), shape))
        bands.add_links(Z, cost.coefficients, curvature, B)


def band_of(q: Subproblem, Z: Float[np.ndarray, "N n p"], H: Float[np.ndarray, "N p p"]) -> Float[np.ndarray, "Np w"]:
    """Return the band of the quadratic cost in z."""
    N, _, p = Z.shape
    B = np.zeros((N * p, p * _width(q)))
    bands.add_blocks(H, B)
    add_costs(Z, q.costs, B)
    return B


def _piqp(B: np.ndarray, c: np.ndarray, rows: Rows, exact: float) -> tuple[np.ndarray, np.ndarray] | None:
    """Return z and all multipliers by piqp, or None where the rows contradict each other."""
    n, w = B.shape
    m = len(rows.data)
    inside = np.arange(w)[None] >= w - 1 - np.arange(n)[:, None]
    above = (np.arange(n)[:, None] - (w - 1) + np.arange(w))[inside]
    P = sp.csc_matrix((B[inside], (above, np.repeat(np.arange(n), inside.sum(axis=1)))), shape=(n, n))
    used = np.arange(w)[None] < rows.count[:, None]
    columns = (rows.first[:, None] + np.arange(w))[used]
    G = sp.csr_matrix((rows.data[used], columns, np.append(0, np.cumsum(rows.count))), shape=(m, n))
    solver: Any = piqp.SparseSolver()
    solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = exact
    solver.settings.eps_rel = solver.settings.eps_duality_gap_rel = 0.1 * exact
    solver.settings.preconditioner_iter = 2  # a waypoint's numbers are of like size
    some = (G.tocsc(), rows.low[:m], rows.high[:m]) if m else (None, None, None)
    solver.setup(P, c, None, None, *some, rows.low[m:], rows.high[m:])
    status, result = solver.solve(), solver.result
    nearly = status in (piqp.PIQP_MAX_ITER_REACHED, piqp.PIQP_NUMERICS)
    if status != piqp.PIQP_SOLVED and not (nearly and max(result.info.primal_res, result.info.dual_res) < 1e-7):
        return None
    y = result.z_u - result.z_l if m else np.empty(0)
    slack = np.minimum(result.s_l, result.s_u) if m else np.empty(0)
    y = np.where(np.abs(y) > slack, y, 0.0)  # an interior point leaves a little everywhere
    return np.array(result.x), np.append(y, result.z_bu - result.z_bl)
