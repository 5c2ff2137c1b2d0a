"""One round of Algorithm 2: convexify, minimise, try the step, look at the optimality conditions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from longreach.planning import _sqp_kernels as kernels
from longreach.planning.elastic import elastic
from longreach.planning.problem import bending
from longreach.planning.program import Program
from longreach.planning.sequence import banded, link_bands
from longreach.planning.subproblem import Difference, Step, Subproblem, one_waypoint

if TYPE_CHECKING:
    from longreach.planning.sqp import Run

_DIFFERENCE = 1e-6  # [rad, m] between the gradients whose difference is the curvature
_ROUNDING = 1e-11  # of the merit: an improvement less than that cannot be seen
_NEAR = 1e-3  # a KKT residual below which the curvature changes no more
_STILL = 1e-11  # [rad, m], a step that is none
_HOLDS = 1e-6  # a multiplier that is more than rounding
_HELD = 10.0  # curvature across inequalities that hold, in the Lagrangian's own
_SURELY = 1e-4  # curvature of a subproblem at the least, where it is convex only all in all
_ABOVE = 1.5  # by which penalties are above multipliers
_AT = 1e-9  # [rad, m] from a limit that counts as on it


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


def _factors(A: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return Q, R, the shortest d with A d = -c, and whether there is one, for A (b, N, e, n)."""
    b, N, e, n = A.shape
    w = b * N
    Q, R, d, independent = np.empty((w, n, n)), np.empty((w, e, e)), np.empty((w, n)), np.empty(w, dtype=bool)
    kernels.eliminate(
        np.ascontiguousarray(A).reshape(w, e, n), np.ascontiguousarray(c).reshape(w, e), Q, R, d, independent
    )
    return Q, R, d.reshape(b, N, n), independent.reshape(b, N).all(axis=1)


def _gradient(run: Run, todo: np.ndarray) -> np.ndarray:
    """Return the gradient (b, N, n) of the costs, those of links too."""
    g = run.g[todo]
    for cost in run.program.costs:
        g = g + cost.curvature * cost.transposed(cost.of(run.x[0]), g.shape[1])
    return g


def convexify(run: Run, todo: np.ndarray) -> Model:
    """Return the model (4.20), (4.21) at the present point, with the curvature of the Lagrangian made convex."""
    program, equation = run.program, run.program.layout.equation
    b, N, n = len(todo), *run.x.shape[1:]
    A, c = run.A[todo], run.c[todo]
    goal, upper = program.bounds(todo, N)
    Q, _, d0, independent = _factors(A[:, :, equation], (c - goal)[:, :, equation])
    Z = np.ascontiguousarray(Q[:, :, equation.sum() :]).reshape(b, N, n, -1)
    renew = run.fresh[todo]
    if renew.any():
        H = _curvature(run, todo[renew], Z[renew])
        convex = _convex(H, run.config.curvature_floor)
        run.H[todo[renew]] = _together(H, convex, Z, program.costs) if N > 1 else convex
        run.fresh[todo] = False
    low, high = program.lower - run.x[todo], program.upper - run.x[todo]
    G = np.concatenate([A[:, :, ~equation], np.broadcast_to(np.eye(n), (b, N, n, n))], axis=2)
    return Model(
        _gradient(run, todo), d0, Z, G,
        np.concatenate([(goal - c)[:, :, ~equation], low], axis=2),
        np.concatenate([(upper - c)[:, :, ~equation], high], axis=2),
        independent,
    )  # fmt: skip


def _curvature(run: Run, todo: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Return Zᵀ ∇²L Z (b, N, p, p) with its eigenvalues lifted to the floor; gradients are differenced along Z."""
    program = run.program
    b, N, n, p = Z.shape
    if p == 0:
        return np.empty((b, N, 0, 0))
    lam = bending(program.problem, program.layout, run.lam[todo].reshape(b * N, -1)).reshape(b, N, -1)
    x = run.x[todo, None] + _DIFFERENCE * np.moveaxis(Z, 3, 1)  # (b, p, N, n)
    e = program.evaluate(x.reshape(b * p, N, n), np.repeat(todo, p))
    pull = np.swapaxes(e.A.reshape(b, p, N, -1, n), 3, 4) @ lam[:, None, :, :, None]
    moved = e.g.reshape(b, p, N, n) + pull[..., 0]
    here = run.g[todo] + (np.swapaxes(run.A[todo], 2, 3) @ lam[..., None])[..., 0]
    H = np.einsum("bkja,bckj->bkac", Z, moved - here[:, None]) / _DIFFERENCE
    H = 0.5 * (H + np.swapaxes(H, 2, 3))
    return H + _held(run, todo, Z, np.abs(H).max(axis=(2, 3), initial=1.0))


def _held(run: Run, todo: np.ndarray, Z: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Return curvature (b, N, p, p) across the inequalities that hold, which their holding makes of no account.

    Where the Lagrangian is concave across them and convex along, as at most optima, the sum is convex.
    """
    equation = run.program.layout.equation
    a = run.A[todo][:, :, ~equation] @ Z
    square = np.sum(a**2, axis=3)
    holds = (np.abs(run.lam[todo][:, :, ~equation]) > _HOLDS) & (square > 1e-12)
    weight = np.where(holds, _HELD * scale[:, :, None] / np.maximum(square, 1e-12), 0.0)
    return np.swapaxes(a, 2, 3) @ (weight[..., None] * a)


def _convex(H: np.ndarray, floor: float) -> np.ndarray:
    """Return H (..., p, p) with its eigenvalues lifted to the floor."""
    s, V = np.linalg.eigh(H)
    return (V * np.maximum(s, floor)[..., None, :]) @ np.swapaxes(V, -1, -2)


def _together(H: np.ndarray, convex: np.ndarray, Z: np.ndarray, costs: tuple[Difference, ...]) -> np.ndarray:
    """Return curvature (1, N, p, p) that is convex with the links' all in all: a waypoint's own where need be."""
    mixed = H[0].copy()
    fine = kernels.mend(mixed, convex[0], banded(link_bands(Z[0], costs)), _SURELY)
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
    limits = tuple(limit.about(run.x[b]) for limit in run.program.limits)
    parts = (model.g[i], model.d0[i], model.Z[i], run.H[b], model.G[i], model.lower[i], model.upper[i])
    return Subproblem(*parts, run.trust[b], run.program.costs, limits)


def _give_way(run: Run, b: int, i: int, model: Model) -> Step | None:
    equation = run.program.layout.equation
    goal, _ = run.program.bounds(np.array([b]), run.c.shape[1])
    c = (run.c[b] - goal[0])[:, equation]
    penalties = (run.mu[b, equation], run.mu[b, ~equation], tuple(run.mu_links))
    return elastic(_subproblem(run, b, i, model), run.A[b][:, equation], c, penalties)


def _merit(run: Run, b: np.ndarray, x: np.ndarray, f: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return f + Σ μ · violation (b,), (4.23) corrected."""
    rows, links = run.program.violations(x, c, b)
    total = run.program.objective(x, f) + np.einsum("bkm,bm->b", rows, run.mu[b])
    return total + sum(mu * np.sum(link) for mu, link in zip(run.mu_links, links, strict=True))


def _worst(program: Program, x: np.ndarray, c: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the largest violation (b,)."""
    rows, links = program.violations(x, c, b)
    worst = rows.max(axis=(1, 2), initial=0.0)
    return np.maximum(worst, max((link.max(initial=0.0) for link in links), default=0.0))


def attempt(run: Run, todo: np.ndarray, model: Model, steps: Steps) -> None:
    """Take the steps that improve the merit as their model said; elsewhere shrink the trust region."""
    b, N, n = len(todo), *run.x.shape[1:]
    _raise_above_multipliers(run, todo, steps)
    x = np.clip(run.x[todo] + steps.d, run.program.lower, run.program.upper)
    before = _merit(run, todo, run.x[todo], run.f[todo], run.c[todo])
    promised = before - _modelled_merit(run, todo, model.Z, x)
    x = _corrected(run, todo, x, steps)
    d = x - run.x[todo]
    e = run.program.evaluate(x, todo)
    f, c = e.f.reshape(b, N), e.c.reshape(b, N, -1)
    true = before - _merit(run, todo, x, f, c)
    unseen = _ROUNDING * (1.0 + np.abs(before))
    good = (true >= run.config.accept * promised - unseen) & steps.found
    larger = np.minimum(run.config.expand * run.trust[todo], run.config.most_trust)
    run.trust[todo] = np.where(good, larger, run.config.shrink * np.abs(steps.d).max(axis=(1, 2)))
    taken = todo[good]
    run.x[taken], run.f[taken], run.c[taken] = x[good], f[good], c[good]
    run.g[taken] = e.g.reshape(b, N, n)[good]
    run.A[taken] = e.A.reshape(b, N, -1, n)[good]
    _take_multipliers(run, todo, steps)
    remember(run, taken)
    stalled = steps.gave_way & (promised <= run.config.stalled * np.abs(before))
    _certify(run, todo, good, stalled | (np.abs(d).max(axis=(1, 2)) <= _STILL), steps.gave_way)


def _modelled_merit(run: Run, todo: np.ndarray, Z: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return what the convex model takes the merit at x for."""
    d = x - run.x[todo]
    free = np.einsum("bkjp,bkj->bkp", Z, d)
    f = run.f[todo] + np.einsum("bkj,bkj->bk", run.g[todo], d)
    f += 0.5 * np.einsum("bkp,bkpq,bkq->bk", free, run.H[todo], free)
    return _merit(run, todo, x, f, run.c[todo] + np.einsum("bkmj,bkj->bkm", run.A[todo], d))


def _corrected(run: Run, todo: np.ndarray, x: np.ndarray, steps: Steps) -> np.ndarray:
    """Return x moved by the shortest step that takes away, to first order, what its constraints are violated by.

    Constraints that hold the step stay where they are; of one that is violated in some of its values, only these count.
    So the curvature of constraints does not make the merit refuse good steps (Maratos' effect). Source: Nocedal &
    Wright, "Numerical Optimization", section 18.3.
    """
    c = run.program.values(x, todo)
    lower, upper = run.program.bounds(todo, x.shape[1])
    off = np.where(c > upper, c - upper, np.where(c < lower, c - lower, 0.0))
    layout = run.program.layout
    b, N, n = x.shape
    used = (off != 0.0) | layout.equation
    y = np.zeros(c.shape)
    y[:, :, ~layout.equation] = steps.rows[:, :, : int((~layout.equation).sum())]
    holding = np.abs(y) > _HOLDS
    for i in range(len(layout.names)):
        mine = layout.owner == i
        used[:, :, mine] |= holding[:, :, mine] & ~used[:, :, mine].any(axis=2, keepdims=True)
    off = np.where(holding & (off == 0.0), np.where(y > 0, c - upper, c - lower), off)
    d = np.empty((b * N, n))
    kernels.correct(run.A[todo].reshape(b * N, -1, n), off.reshape(b * N, -1), used.reshape(b * N, -1), d)
    d = d.reshape(x.shape)
    small = np.abs(d).max(axis=(1, 2)) <= 0.5 * np.abs(x - run.x[todo]).max(axis=(1, 2))
    small &= ~steps.gave_way  # there is no point nearby where all hold
    return np.clip(x + np.where(small[:, None, None], d, 0.0), run.program.lower, run.program.upper)


def _raise_above_multipliers(run: Run, todo: np.ndarray, steps: Steps) -> None:
    """Keep the penalties above the multipliers, without which the merit's minimum is not the problem's."""
    equation = run.program.layout.equation
    largest = np.empty((len(todo), len(equation)))
    largest[:, equation] = np.abs(run.lam[todo][:, :, equation]).max(axis=1)
    largest[:, ~equation] = np.abs(steps.rows[:, :, : int((~equation).sum())]).max(axis=1)
    largest[steps.gave_way] = 0.0
    run.mu[todo] = np.maximum(run.mu[todo], _ABOVE * largest)
    if not steps.gave_way.any():
        for i, link in enumerate(steps.links or ()):
            run.mu_links[i] = max(run.mu_links[i], _ABOVE * np.abs(link).max(initial=0.0))


def _take_multipliers(run: Run, todo: np.ndarray, steps: Steps) -> None:
    """Keep the multipliers; the box's are those of the limits where a limit holds, and the trust region's elsewhere."""
    todo, equation = todo[steps.found], run.program.layout.equation
    m = int((~equation).sum())
    lam = run.lam[todo]
    lam[:, :, ~equation] = steps.rows[steps.found][:, :, :m]
    gave_way = steps.gave_way[steps.found]
    lam[np.ix_(gave_way, np.ones(lam.shape[1], dtype=bool), equation)] = steps.equations[steps.found][gave_way]
    run.lam[todo] = lam
    x = run.x[todo]
    at_limit = (x <= run.program.lower + _AT) | (x >= run.program.upper - _AT)
    run.lam_limits[todo] = np.where(at_limit, steps.rows[steps.found][:, :, m:], 0.0)
    if steps.links is not None:
        run.lam_links = list(steps.links)


def _certify(run: Run, todo: np.ndarray, good: np.ndarray, tiny: np.ndarray, gave_way: np.ndarray) -> None:
    """Find the KKT residuals of the steps taken; call solved what is, and raise penalties where nothing moves."""
    for estimate, mask in ((True, good & ~gave_way), (False, good & gave_way)):
        if mask.any():
            run.kkt[todo[mask]] = _residual(run, todo[mask], estimate)
    run.fresh[todo] = ~good | (run.kkt[todo] > _NEAR)
    worst = _worst(run.program, run.x[todo], run.c[todo], todo)
    feasible, flat = worst <= run.config.feasible, run.kkt[todo] <= run.config.stationary
    run.solved[todo] = feasible & flat
    still = (good & tiny) | (run.trust[todo] < run.config.least_trust) | flat
    run.done[todo] = feasible & still
    for i in np.flatnonzero(still & ~feasible):
        _raise_penalties(run, int(todo[i]))


def _raise_penalties(run: Run, b: int) -> None:
    """Raise the penalty of each constraint that is violated, or give up."""
    one = np.array([b])
    rows, links = run.program.violations(run.x[one], run.c[one], one)
    run.raised[b] += 1
    run.done[b] = run.raised[b] > run.config.raises
    violated = (rows[0] > run.config.feasible).any(axis=0)
    same = np.isin(run.program.layout.owner, run.program.layout.owner[violated])
    run.mu[b, same] *= run.config.raise_by
    for l, link in enumerate(links):
        if link.max(initial=0.0) > run.config.feasible:
            run.mu_links[l] *= run.config.raise_by
    run.trust[b], run.kkt[b] = run.config.trust, np.inf


def _residual(run: Run, todo: np.ndarray, estimate: bool) -> np.ndarray:
    """Return the largest of |∇L| and |λ · slack| (b,); where asked, estimate the equations' multipliers first."""
    equation = run.program.layout.equation
    b, N, n = len(todo), *run.x.shape[1:]
    A, lam = run.A[todo], run.lam[todo]
    r = _gradient(run, todo) + run.lam_limits[todo]
    for limit, y in zip(run.program.limits, run.lam_links, strict=True):
        r = r + limit.transposed(y, N)
    r = r + np.einsum("bkmj,bkm->bkj", A[:, :, ~equation], lam[:, :, ~equation])
    if estimate and equation.any():
        Q, R, _, _ = _factors(A[:, :, equation], np.zeros((b, N, int(equation.sum()))))
        out = np.empty((b * N, int(equation.sum())))
        kernels.equation_multipliers(Q, R, r.reshape(b * N, n), out)
        lam[:, :, equation] = out.reshape(b, N, -1)
        run.lam[todo] = lam
    r = r + np.einsum("bkmj,bkm->bkj", A[:, :, equation], lam[:, :, equation])
    lower, upper = run.program.bounds(todo, N)
    slack = np.where(lam > 0, upper - run.c[todo], run.c[todo] - lower)
    idle = np.abs(np.where(lam == 0, 0.0, lam) * np.where(lam == 0, 0.0, np.maximum(slack, 0.0)))
    return np.maximum(np.abs(r).max(axis=(1, 2), initial=0.0), idle.max(axis=(1, 2), initial=0.0))


def remember(run: Run, b: np.ndarray) -> None:
    """Keep the best feasible point of each problem."""
    if len(b) == 0:
        return
    f = run.program.objective(run.x[b], run.f[b])
    better = (_worst(run.program, run.x[b], run.c[b], b) <= run.config.feasible) & (f < run.best[b])
    run.best[b[better]], run.best_x[b[better]] = f[better], run.x[b[better]]


def recall(run: Run) -> None:
    """Go back to the best feasible point where the last one is neither solved nor feasible."""
    b = np.arange(len(run.x))
    behind = np.flatnonzero(
        ~run.solved & np.isfinite(run.best) & (_worst(run.program, run.x, run.c, b) > run.config.feasible)
    )
    if len(behind):
        run.x[behind] = run.best_x[behind]
        e = run.program.evaluate(run.x[behind], behind)
        run.f[behind], run.c[behind] = e.f.reshape(len(behind), -1), e.c.reshape(run.c[behind].shape)
        run.g[behind], run.A[behind] = e.g.reshape(run.g[behind].shape), e.A.reshape(run.A[behind].shape)


def state(run: Run) -> dict[str, float]:
    """Return merit, violation, trust region and penalty of all problems, as the figure of convergence shows them."""
    b = np.arange(len(run.x))
    return {
        "merit": float(_merit(run, b, run.x, run.f, run.c).sum()),
        "violation": float(_worst(run.program, run.x, run.c, b).max()),
        "trust": float(np.median(run.trust)),
        "penalty": float(max(run.mu.max(initial=0.0), run.mu_links.max(initial=0.0))),
    }


def behind(run: Run, rivals: np.ndarray, margin: float) -> np.ndarray:
    """Return which problems (B,) another one of the same number is ahead of, by a part of its merit."""
    merit = merits(run)
    best = np.full(rivals.max() + 1, np.inf)
    np.minimum.at(best, rivals, merit)
    return merit > best[rivals] + margin * (1.0 + np.abs(best[rivals]))


def merits(run: Run) -> np.ndarray:
    """Return the merit of each problem (B,)."""
    return _merit(run, np.arange(len(run.x)), run.x, run.f, run.c)


def objectives(run: Run) -> np.ndarray:
    """Return the cost of each problem (B,)."""
    return run.program.objective(run.x, run.f)
