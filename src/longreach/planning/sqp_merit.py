"""The merit function of Algorithm 2, and what is read from it: which points are best, and how it all goes on."""

import numpy as np

from longreach.planning.program import Program
from longreach.planning.sqp_run import Run


def merit(run: Run, b: np.ndarray, x: np.ndarray, f: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return f + Σ μ · violation (b,), (4.23) corrected."""
    rows, links = run.program.violations(x, c, b)
    total = run.program.objective(x, f) + np.einsum("bkm,bm->b", rows, run.mu[b])
    return total + sum(mu * np.sum(link) for mu, link in zip(run.mu_links, links, strict=True))


def worst_violation(program: Program, x: np.ndarray, c: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the largest violation (b,)."""
    rows, links = program.violations(x, c, b)
    worst = rows.max(axis=(1, 2), initial=0.0)
    return np.maximum(worst, max((link.max(initial=0.0) for link in links), default=0.0))


def remember(run: Run, b: np.ndarray) -> None:
    """Keep the best feasible point of each problem."""
    if len(b) == 0:
        return
    f = run.program.objective(run.x[b], run.f[b])
    better = (worst_violation(run.program, run.x[b], run.c[b], b) <= run.config.met) & (f < run.best[b])
    run.best[b[better]], run.best_x[b[better]] = f[better], run.x[b[better]]


def recall(run: Run) -> None:
    """Go back to the best feasible point where the last one is neither solved nor feasible."""
    b = np.arange(len(run.x))
    behind = np.flatnonzero(
        ~run.solved & np.isfinite(run.best) & (worst_violation(run.program, run.x, run.c, b) > run.config.met)
    )
    if len(behind):
        run.kkt[behind] = np.inf
        run.x[behind] = run.best_x[behind]
        e = run.program.evaluate(run.x[behind], behind)
        run.f[behind], run.c[behind] = e.f.reshape(len(behind), -1), e.c.reshape(run.c[behind].shape)
        run.g[behind], run.A[behind] = e.g.reshape(run.g[behind].shape), e.A.reshape(run.A[behind].shape)


def state(run: Run) -> dict[str, float]:
    """Return merit, violation, trust region and penalty of all problems, as the figure of convergence shows them."""
    b = np.arange(len(run.x))
    return {
        "merit": float(merit(run, b, run.x, run.f, run.c).sum()),
        "violation": float(worst_violation(run.program, run.x, run.c, b).max()),
        "trust": float(np.median(run.trust)),
        "penalty": float(max(run.mu.max(initial=0.0), run.mu_links.max(initial=0.0))),
    }


def behind(run: Run, rivals: np.ndarray, margin: float) -> np.ndarray:
    """Return which problems (B,) another one of the same number is ahead of, by a part of its merit."""
    total = merits(run)
    best = np.full(rivals.max() + 1, np.inf)
    np.minimum.at(best, rivals, total)
    return total > best[rivals] + margin * (1.0 + np.abs(best[rivals]))


def merits(run: Run) -> np.ndarray:
    """Return the merit of each problem (B,)."""
    return merit(run, np.arange(len(run.x)), run.x, run.f, run.c)


def objectives(run: Run) -> np.ndarray:
    """Return the cost of each problem (B,)."""
    return run.program.objective(run.x, run.f)
