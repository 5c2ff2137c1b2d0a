"""The convex subproblem (4.22) of one iteration: quadratic cost, linear constraints, a box around the last q.

The equations are eliminated first: d = d₀ + Z z, z being the few directions that they leave free. What is left goes to
daqp where it is one waypoint's, and to piqp where it couples many. Of the many rows of a trajectory few ever bind, so
that a row takes part only once a solution has crossed it. Where the rows contradict each other, `elastic` lets all of
them but the box give way, at the price of the merit function's penalties.
"""

from dataclasses import dataclass, replace

import daqp
import numpy as np
import piqp
import scipy.sparse as sp
from jaxtyping import Bool, Float

_EXACT = 1e-10
_CROSSED = 1e-9  # by which a row must be violated to take part
_BINDS = 1e-7  # a multiplier that is more than rounding
_NEAR = 2e-4  # [m, rad] from a bound: the next step may come to it
_ROUNDS = 30
_FLOOR = 1e-8  # curvature of the elastic problem where it has none


@dataclass(frozen=True, eq=False)
class Difference:
    """A link at the present trajectory: coefficients (k, width), and bounds (k, n) of the change of its value.

    Of a cost, the bounds are empty and curvature is 2 · weight.
    """

    coefficients: Float[np.ndarray, "k width"]
    lower: Float[np.ndarray, "k2 n"]
    upper: Float[np.ndarray, "k2 n"]
    curvature: float = 0.0

    def of(self, x: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "k n"]:
        """Return the difference's value at a trajectory."""
        k = len(self.coefficients)
        return sum(
            (self.coefficients[:, i, None] * x[i : i + k] for i in range(self.coefficients.shape[1])),
            np.zeros((k, x.shape[1])),
        )

    def about(self, x: Float[np.ndarray, "N n"]) -> "Difference":
        """Return it with bounds that count from where the trajectory x is."""
        value = self.of(x)
        return replace(self, lower=self.lower - value, upper=self.upper - value)

    def transposed(self, y: Float[np.ndarray, "k n"], N: int) -> Float[np.ndarray, "N n"]:
        """Return what multipliers of the difference exert on each waypoint."""
        out = np.zeros((N, y.shape[1]))
        k = len(self.coefficients)
        for i in range(self.coefficients.shape[1]):
            out[i : i + k] += self.coefficients[:, i, None] * y
        return out


@dataclass(frozen=True, eq=False)
class Subproblem:
    """min gᵀd + ½ zᵀH z + links' costs, d = d₀ + Z z, lower ≤ G d ≤ upper, and the limits of links.

    All are over N waypoints: g, d0 (N, n), Z (N, n, p), H (N, p, p), G (N, r, n); the last n rows of G are the joints'
    limits. The trust region is |z| ≤ reach.
    """

    g: Float[np.ndarray, "N n"]
    d0: Float[np.ndarray, "N n"]
    Z: Float[np.ndarray, "N n p"]
    H: Float[np.ndarray, "N p p"]
    G: Float[np.ndarray, "N r n"]
    lower: Float[np.ndarray, "N r"]
    upper: Float[np.ndarray, "N r"]
    reach: float
    costs: tuple[Difference, ...] = ()
    limits: tuple[Difference, ...] = ()


@dataclass(frozen=True, eq=False)
class Step:
    """d (N, n) with the multipliers of the rows (N, r), of the links (k, n) each, and of the equations (N, m_e).

    The last are empty where the equations were eliminated.
    """

    d: Float[np.ndarray, "N n"]
    rows: Float[np.ndarray, "N r"]
    links: tuple[Float[np.ndarray, "k n"], ...] = ()
    equations: Float[np.ndarray, "N e"] | None = None


def one_waypoint(
    H: Float[np.ndarray, "p p"], g: Float[np.ndarray, " p"], G: Float[np.ndarray, "r p"],
    lower: Float[np.ndarray, " m"], upper: Float[np.ndarray, " m"],
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " r"]] | None:  # fmt: skip
    """Return z and the rows' multipliers by daqp, or None where the rows contradict each other.

    The first p bounds are those of z itself.
    """
    z, _, flag, info = daqp.solve(H, g, G, upper, lower, primal_tol=_EXACT)
    return (z, info["lam"][len(z) :]) if flag == 1 else None


class Sequence:
    """The subproblems of one trajectory: it remembers which rows took part in the last one."""

    def __init__(self) -> None:
        self.rows: Bool[np.ndarray, "N r"] | None = None
        self.links: list[Bool[np.ndarray, "k n"]] = []

    def solve(self, q: Subproblem) -> Step | None:
        """Return the step by piqp, or None where the rows contradict each other."""
        if self.rows is None:
            self.rows = np.zeros(q.lower.shape, dtype=bool)
            self.links = [np.zeros(link.lower.shape, dtype=bool) for link in q.limits]
        N, n, p = q.Z.shape
        P, c = _curvature(q)
        GZ = q.G @ q.Z
        at_d0 = np.einsum("krj,kj->kr", q.G, q.d0)
        for _ in range(_ROUNDS):
            rows, low, high = self._taking_part(q, GZ, at_d0)
            found = _piqp(P, c, rows, low, high, q.reach)
            if found is None:
                return None
            z, y = found
            d = q.d0 + np.einsum("kjp,kp->kj", q.Z, z.reshape(N, p))
            if not self._add_crossed(q, d):
                v = np.einsum("krj,kj->kr", q.G, d)
                return self._step(d, y, (v < q.lower + _NEAR) | (v > q.upper - _NEAR))
        return None

    def _taking_part(
        self, q: Subproblem, GZ: np.ndarray, at_d0: np.ndarray
    ) -> tuple[sp.csc_matrix, np.ndarray, np.ndarray]:
        N, _, p = q.Z.shape
        assert self.rows is not None
        k, r = np.nonzero(self.rows)
        columns = [(k[:, None] * p + np.arange(p)).ravel()]
        data = [GZ[k, r].ravel()]
        lines = [np.repeat(np.arange(len(k)), p)]
        low, high = [(q.lower - at_d0)[k, r]], [(q.upper - at_d0)[k, r]]
        count = len(k)
        for link, mask in zip(q.limits, self.links, strict=True):
            k, j = np.nonzero(mask)
            offset = link.of(q.d0)[k, j]
            low.append(link.lower[k, j] - offset)
            high.append(link.upper[k, j] - offset)
            for i in range(link.coefficients.shape[1]):
                columns.append(((k + i)[:, None] * p + np.arange(p)).ravel())
                data.append((link.coefficients[k, i, None] * q.Z[k + i, j]).ravel())
                lines.append(np.repeat(count + np.arange(len(k)), p))
            count += len(k)
        matrix = sp.csc_matrix(
            (np.concatenate(data), (np.concatenate(lines), np.concatenate(columns))), shape=(count, N * p)
        )
        return matrix, np.concatenate(low), np.concatenate(high)

    def _add_crossed(self, q: Subproblem, d: np.ndarray) -> bool:
        """Let those rows take part that d crosses; return whether there are such."""
        assert self.rows is not None
        v = np.einsum("krj,kj->kr", q.G, d)
        new = ((v < q.lower - _CROSSED) | (v > q.upper + _CROSSED)) & ~self.rows
        self.rows |= new
        any_new = bool(new.any())
        for link, mask in zip(q.limits, self.links, strict=True):
            v = link.of(d)
            new = ((v < link.lower - _CROSSED) | (v > link.upper + _CROSSED)) & ~mask
            mask |= new
            any_new |= bool(new.any())
        return any_new

    def _step(self, d: np.ndarray, y: np.ndarray, near: np.ndarray) -> Step:
        """Give each row its multiplier, and let only those take part next time that hold the step or are near."""
        assert self.rows is not None
        rows = np.zeros(self.rows.shape)
        start = int(self.rows.sum())
        rows[self.rows] = y[:start]
        links = []
        for mask in self.links:
            value = np.zeros(mask.shape)
            stop = start + int(mask.sum())
            value[mask] = y[start:stop]
            start = stop
            links.append(value)
            mask &= np.abs(value) > _BINDS
        self.rows &= (np.abs(rows) > _BINDS) | near
        return Step(d, rows, tuple(links))


def link_bands(Z: Float[np.ndarray, "N n p"], costs: tuple[Difference, ...]) -> list[np.ndarray]:
    """Return the links' curvature in z: blocks (N - o, p, p) of waypoints k and k + o, for o = 0, 1, ..."""
    N, _, p = Z.shape
    width = max((cost.coefficients.shape[1] for cost in costs), default=1)
    bands = [np.zeros((N - o, p, p)) for o in range(width)]
    for cost in costs:
        k, width = cost.coefficients.shape
        for i in range(width):
            for j in range(i, width):
                weight = cost.curvature * cost.coefficients[:, i] * cost.coefficients[:, j]
                bands[j - i][i : i + k] += weight[:, None, None] * (Z[i : i + k].transpose(0, 2, 1) @ Z[j : j + k])
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
        g = g + cost.curvature * cost.transposed(cost.of(q.d0), N)
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
    P: sp.csc_matrix, c: np.ndarray, G: sp.csc_matrix, low: np.ndarray, high: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray] | None:
    solver = piqp.SparseSolver()
    solver.settings.eps_abs = solver.settings.eps_duality_gap_abs = _EXACT
    solver.settings.eps_rel = solver.settings.eps_duality_gap_rel = 1e-11
    box = np.full(len(c), reach)
    solver.setup(P, c, None, None, *((G, low, high) if G.shape[0] else (None, None, None)), -box, box)
    status = solver.solve()
    result = solver.result
    loose = max(result.info.primal_res, result.info.dual_res) < 1e-7
    if status != piqp.PIQP_SOLVED and not (status in (piqp.PIQP_MAX_ITER_REACHED, piqp.PIQP_NUMERICS) and loose):
        return None
    if G.shape[0] == 0:
        return np.array(result.x), np.empty(0)
    y = result.z_u - result.z_l
    slack = np.minimum(result.s_l, result.s_u)
    return np.array(result.x), np.where(np.abs(y) > slack, y, 0.0)  # an interior point leaves a little everywhere
