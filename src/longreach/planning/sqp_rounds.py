"""The second half of a round of Algorithm 2: try the step, look at the optimality conditions."""

import numpy as np

from longreach.planning import _sqp_kernels as kernels
from longreach.planning.sqp_merit import merit, remember, worst_violation
from longreach.planning.sqp_model import HOLDS, Model, Steps, factors, gradient
from longreach.planning.sqp_run import Run

_ROUNDING = 1e-11  # of the merit: an improvement less than that cannot be seen
_NEAR = 1e-6  # a KKT residual below which the curvature changes no more
_STILL = 1e-11  # [rad, m], a step that is none
_ABOVE = 1.5  # by which penalties are above multipliers
_AT = 1e-9  # [rad, m] from a limit that counts as on it


def attempt(run: Run, todo: np.ndarray, model: Model, steps: Steps) -> None:
    """Take the steps that improve the merit as their model said; elsewhere shrink the trust region."""
    b, N, n = len(todo), *run.x.shape[1:]
    _raise_above_multipliers(run, todo, steps)
    x = np.clip(run.x[todo] + steps.d, run.program.lower, run.program.upper)
    before = merit(run, todo, run.x[todo], run.f[todo], run.c[todo])
    promised = before - _modelled_merit(run, todo, model.Z, x)
    x = _corrected(run, todo, x, steps)
    d = x - run.x[todo]
    e = run.program.evaluate(x, todo)
    f, c = e.f.reshape(b, N), e.c.reshape(b, N, -1)
    true = before - merit(run, todo, x, f, c)
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
    f[:, 0] += sum(link.energy(d[0]) for link in run.held)
    return merit(run, todo, x, f, run.c[todo] + np.einsum("bkmj,bkj->bkm", run.A[todo], d))


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
    holding = np.abs(y) > HOLDS
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
    """Find the KKT residuals where the problems are now, with the newest multipliers, and what follows from them.

    Solved is what satisfies the conditions; where nothing moves and something is violated, penalties rise.
    """
    for estimate, mask in ((True, ~gave_way), (False, gave_way)):
        if mask.any():
            run.kkt[todo[mask]] = _residual(run, todo[mask], estimate)
    run.fresh[todo] = ~good | (run.kkt[todo] > _NEAR)
    worst = worst_violation(run.program, run.x[todo], run.c[todo], todo)
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
    r = gradient(run, todo) + run.lam_limits[todo]
    for limit, y in zip(run.program.limits, run.lam_links, strict=True):
        r = r + limit.transposed(y, N)
    r = r + np.einsum("bkmj,bkm->bkj", A[:, :, ~equation], lam[:, :, ~equation])
    if estimate and equation.any():
        Q, R, _, _ = factors(A[:, :, equation], np.zeros((b, N, int(equation.sum()))))
        out = np.empty((b * N, int(equation.sum())))
        kernels.equation_multipliers(Q, R, r.reshape(b * N, n), out)
        lam[:, :, equation] = out.reshape(b, N, -1)
        run.lam[todo] = lam
    r = r + np.einsum("bkmj,bkm->bkj", A[:, :, equation], lam[:, :, equation])
    lower, upper = run.program.bounds(todo, N)
    slack = np.where(lam > 0, upper - run.c[todo], run.c[todo] - lower)
    idle = np.abs(np.where(lam == 0, 0.0, lam) * np.where(lam == 0, 0.0, np.maximum(slack, 0.0)))
    return np.maximum(np.abs(r).max(axis=(1, 2), initial=0.0), idle.max(axis=(1, 2), initial=0.0))
