"""The first half of a round of Algorithm 2: convexify and minimise."""

from dataclasses import dataclass

import numpy as np

from longreach.planning import _band_kernels as bands
from longreach.planning import _sqp_kernels as kernels
from longreach.planning.elastic import elastic
from longreach.planning.sequence import add_costs
from longreach.planning.sqp_run import Run
from longreach.planning.subproblem import Difference, Step, Subproblem, one_waypoint

HOLDS = 1e-6  # a multiplier that is more than rounding
_HELD, _HELD_NEAR = 10.0, 100.0  # curvature across inequalities that hold, in the Lagrangian's own; near a solution
_NEAR = 1e-3  # a KKT residual from where on those that hold will go on holding
_SURELY = 1e-4  # curvature of a subproblem at the least, where it is convex only all in all


@dataclass(frozen=True, eq=False)
class Model:
    """The convex model of the problems `todo`: arrays (b, N, ...), see `Subproblem`."""

    g: np.ndarray
    d0: np.ndarray
    Z: np.ndarray
    G: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    independent: np.ndarray


@dataclass(eq=False)
class Steps:
    """What the subproblems answered: d (b, N, n), multipliers of rows (b, N, r), of equations (b, N, e), of links.

    gave_way (b,): whether rows contradicted each other, so that they had to; found (b,): whether there is an answer.
    """

    d: np.ndarray
    rows: np.ndarray
    equations: np.ndarray
    gave_way: np.ndarray
    found: np.ndarray
    links: tuple[np.ndarray, ...] | None = None

    def put(self, i: int, step: Step | None) -> None:
        """Enter the answer for one problem."""
        if step is not None:
            self.d[i], self.rows[i], self.links, self.found[i] = step.d, step.rows, step.links, True
            if step.equations is not None:
                self.equations[i] = step.equations


def factors(A: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return Q, R, the shortest d with A d = -c, and whether there is one, for A (b, N, e, n)."""
    b, N, e, n = A.shape
    w = b * N
    Q, R, d, independent = np.empty((w, n, n)), np.empty((w, e, e)), np.empty((w, n)), np.empty(w, dtype=bool)
    kernels.eliminate(
        np.ascontiguousarray(A).reshape(w, e, n), np.ascontiguousarray(c).reshape(w, e), Q, R, d, independent
    )
    return Q, R, d.reshape(b, N, n), np.all(independent.reshape(b, N), axis=1)


def gradient(run: Run, todo: np.ndarray) -> np.ndarray:
    """Return the gradient (b, N, n) of the costs, those of links too."""
    g = run.g[todo]
    for cost in run.program.costs:
        g = g + cost.pull(run.x[0])
    return g


def convexify(run: Run, todo: np.ndarray) -> Model:
    """Return the model (4.20), (4.21) at the present point, with the curvature of the Lagrangian made convex."""
    program, equation = run.program, run.program.layout.equation
    b, N, n = len(todo), *run.x.shape[1:]
    A, c = run.A[todo], run.c[todo]
    goal, upper = program.bounds(todo, N)
    Q, _, d0, independent = factors(A[:, :, equation], (c - goal)[:, :, equation])
    Z = np.ascontiguousarray(Q[:, :, equation.sum() :]).reshape(b, N, n, -1)
    renew = run.fresh[todo]
    if renew.any():
        H = _curvature(run, todo[renew], Z[renew])
        convex = _convex(H, run.config.curvature_floor)
        run.held = _held_links(run)
        run.H[todo[renew]] = _together(H, convex, Z, (*program.costs, *run.held)) if N > 1 else convex
        run.fresh[todo] = False
    low, high = program.lower - run.x[todo], program.upper - run.x[todo]
    G = np.concatenate([A[:, :, ~equation], np.broadcast_to(np.eye(n), (b, N, n, n))], axis=2)
    return Model(
        gradient(run, todo), d0, Z, G,
        np.concatenate([(goal - c)[:, :, ~equation], low], axis=2),
        np.concatenate([(upper - c)[:, :, ~equation], high], axis=2),
        independent,
    )  # fmt: skip


def _curvature(run: Run, todo: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Return Zᵀ ∇²L Z (b, N, p, p), with what `_held` adds."""
    b, N, _, p = Z.shape
    if p == 0:
        return np.empty((b, N, 0, 0))
    bent = run.program.curvature(run.x[todo], todo, run.lam[todo], Z)
    H = np.swapaxes(Z, 2, 3) @ bent
    H = 0.5 * (H + np.swapaxes(H, 2, 3))
    return H + _held(run, todo, Z, np.abs(H).max(axis=(2, 3), initial=1.0))


def _held(run: Run, todo: np.ndarray, Z: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return curvature (b, N, p, p) across the inequalities that hold, which their holding makes of no account.

    Where the Lagrangian is concave across them and convex along, as at most optima, the sum is convex.
    """
    equation = run.program.layout.equation
    a = run.A[todo][:, :, ~equation] @ Z
    square = np.sum(a**2, axis=3)
    holds = (np.abs(run.lam[todo][:, :, ~equation]) > HOLDS) & (square > 1e-12)
    stiff = np.where(run.kkt[todo] < _NEAR, _HELD_NEAR, _HELD)[:, None, None]
    weight = np.where(holds, stiff * scale[:, :, None] / np.maximum(square, 1e-12), 0.0)
    return np.swapaxes(a, 2, 3) @ (weight[..., None] * a)


def _held_links(run: Run) -> tuple[Difference, ...]:
    """Return the same across limits of links that hold, as costs of the step."""
    none = np.empty((0, run.x.shape[2]))
    pairs = zip(run.program.limits, run.lam_links, strict=True)
    stiff = _HELD_NEAR if run.kkt[0] < _NEAR else _HELD
    return tuple(Difference(limit.coefficients, none, none, stiff * (np.abs(y) > HOLDS)) for limit, y in pairs)


def _convex(H: np.ndarray, floor: float) -> np.ndarray:
    """Return H (..., p, p) with its eigenvalues lifted to the floor."""
    s, V = np.linalg.eigh(H)
    return (V * np.maximum(s, floor)[..., None, :]) @ np.swapaxes(V, -1, -2)


def _together(H: np.ndarray, convex: np.ndarray, Z: np.ndarray, costs: tuple[Difference, ...]) -> np.ndarray:
    """Return curvature (1, N, p, p) that is convex with the links' all in all: a waypoint's own where need be."""
    mixed = H[0].copy()
    _, N, p, _ = H.shape
    links = np.zeros((N * p, p * max((cost.coefficients.shape[1] for cost in costs), default=1)))
    add_costs(Z[0], costs, links)
    fine = bands.mend(mixed, convex[0], links, _SURELY)
    return mixed[None] if fine else convex


def minimise(run: Run, todo: np.ndarray, model: Model) -> Steps:
    """Return the subproblems' solutions (4.22)."""
    layout = run.program.layout
    b, N, r = model.lower.shape
    y, d = np.zeros((b, N, r)), np.zeros_like(model.d0)
    steps = Steps(d, y, np.zeros((b, N, int(layout.equation.sum()))), np.zeros(b, dtype=bool), np.zeros(b, dtype=bool))
    if N == 1:
        gz = np.einsum("bjp,bj->bp", model.Z[:, 0], model.g[:, 0])
        GZ = model.G[:, 0] @ model.Z[:, 0]
        at = (model.G[:, 0] @ model.d0[:, 0, :, None])[:, :, 0]
        delta = np.repeat(run.trust[todo, None], gz.shape[1], axis=1)
        low = np.hstack([-delta, model.lower[:, 0] - at])
        high = np.hstack([delta, model.upper[:, 0] - at])
        z = np.zeros_like(gz)
        for i in np.flatnonzero(model.independent):
            found = one_waypoint(run.H[todo[i], 0], gz[i], GZ[i], low[i], high[i])
            if found is not None:
                z[i], y[i, 0] = found
                steps.found[i] = True
        d[:] = model.d0 + (model.Z @ z[:, None, :, None])[..., 0]
    elif model.independent[0]:
        steps.put(0, run.sequence.solve(_subproblem(run, int(todo[0]), 0, model)))
    for i in np.flatnonzero(~steps.found).tolist():
        steps.gave_way[i] = True
        run.H[todo[i]] = run.config.curvature_floor * np.eye(model.Z.shape[3])  # the Lagrangian's is of a solution
        steps.put(i, _give_way(run, int(todo[i]), i, model))
    return steps


def _subproblem(run: Run, b: int, i: int, model: Model) -> Subproblem:
    exact = (
        float(np.clip(1e-4 * run.kkt[b], 1e-9, 1e-7)) if run.history else 1e-5
    )  # far from a solution there is no use in digits
    limits = tuple(limit.about(run.x[b]) for limit in run.program.limits)
    parts = (model.g[i], model.d0[i], model.Z[i], run.H[b], model.G[i], model.lower[i], model.upper[i])
    return Subproblem(*parts, run.trust[b], exact, (*run.program.costs, *run.held), limits)


def _give_way(run: Run, b: int, i: int, model: Model) -> Step | None:
    equation = run.program.layout.equation
    goal, _ = run.program.bounds(np.array([b]), run.c.shape[1])
    c = (run.c[b] - goal[0])[:, equation]
    penalties = (run.mu[b, equation], run.mu[b, ~equation], run.mu_links)
    return elastic(_subproblem(run, b, i, model), run.A[b][:, equation], c, penalties)
