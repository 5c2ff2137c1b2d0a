"""What sequential convex optimisation answers with: configurations and the certificate that goes with them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from longreach.configuration import ConfigurationTrajectory
from longreach.planning.problem import LIMITS
from longreach.planning.sqp_run import Run

_MATTERS = 1e-3  # of the largest multiplier: one that is less holds nothing


@dataclass(frozen=True, eq=False)
class SqpSolution:
    """Configurations q (N, n) with their certificate; not converging is a value, too.

    objective (N,): each waypoint's cost, without smoothness. solved (N,): whether each is called solved. kkt (N,): the
    largest of |∇L| and |λ · slack|, one number for all where they were solved together. off: by how much each value of
    each constraint (N, m), and of each limited link (k, n), is outside its bounds. multipliers: λ of each constraint
    (N, m), of "joint limits" (N, n) and of links (k, n), above 0 at an upper and below at a lower bound. status: a
    sentence; violated: the names of those that are not met. history: merit, violation, trust region and penalty after
    each iteration.
    """

    q: Float[np.ndarray, "N n"]
    status: str
    converged: bool
    iterations: int
    residuals: Mapping[str, float]
    violated: tuple[str, ...]
    objective: Float[np.ndarray, " N"]
    off: Mapping[str, np.ndarray]
    kkt: Float[np.ndarray, " N"]
    solved: Bool[np.ndarray, " N"]
    multipliers: Mapping[str, np.ndarray]
    history: Sequence[Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class OptimisedTrajectory(ConfigurationTrajectory):
    """A trajectory with the solution that it was made from."""

    solution: SqpSolution = None  # type: ignore[assignment]


def solution_of(run: Run, chosen: np.ndarray) -> SqpSolution:
    """Return the solution that a run has come to, of the problems chosen."""
    program = run.program
    N, n = run.x.shape[1:]
    q, c, lam = (part[chosen].reshape(len(chosen) * N, -1 if part.size else 0) for part in (run.x, run.c, run.lam))
    rows, links = program.violations(run.x[chosen], run.c[chosen], chosen)
    rows = rows.reshape(c.shape)
    owner, names = program.layout.owner, program.layout.names
    link_names = [link.name for link in program.problem.link_limits] if program.limits else []
    off = {name: rows[:, owner == i] for i, name in enumerate(names)} | dict(zip(link_names, links, strict=True))
    violations = {name: float(part.max(initial=0.0)) for name, part in off.items()}
    multipliers = {name: lam[:, owner == i] for i, name in enumerate(names)}
    multipliers |= {LIMITS: run.lam_limits[chosen].reshape(-1, n)}
    multipliers |= dict(zip(link_names, run.lam_links, strict=True))
    kkt, solved = (np.repeat(part[chosen], N) for part in (run.kkt, run.solved))
    violated = tuple(name for name, size in violations.items() if size > run.config.met)
    worst = {name: int(np.argmax(off[name].max(axis=1))) for name in violated}
    status = _status(run, solved, violations, violated, worst, multipliers)
    return SqpSolution(
        q, status, bool(solved.all()), len(run.history), {"kkt": float(kkt.max()), **violations}, violated,
        run.f[chosen].ravel(), off, kkt, solved, multipliers, tuple(run.history),
    )  # fmt: skip


def _status(
    run: Run, solved: np.ndarray, violations: Mapping[str, float], violated: Sequence[str],
    worst: Mapping[str, int], multipliers: Mapping[str, np.ndarray],
) -> str:  # fmt: skip
    if solved.all():
        return f"Solved, with a KKT residual of {run.kkt.max():.1g}." if len(run.kkt) == 1 else "Solved everywhere."
    ended = (
        "The time ran out" if run.late else "The iterations ran out" if not run.done.all() else "Nothing better near"
    )
    if not violated:
        return f"{ended}: all constraints are met, but the cost may not be least at {int((~solved).sum())} waypoints."
    parts = []
    for name in violated:
        against = _against(name, worst[name], multipliers)
        parts.append(f"{name} is not met at waypoint {worst[name]}: it is off by {violations[name]:.3g}{against}")
    return f"{ended}: {'; '.join(parts)}."


def _against(name: str, k: int, multipliers: Mapping[str, np.ndarray]) -> str:
    """Return which other constraints push against one that is violated."""
    sizes = {
        other: float(np.abs(lam[min(k, len(lam) - 1)]).max(initial=0.0)) if len(lam) else 0.0
        for other, lam in multipliers.items()
    }
    most = max(sizes.values(), default=0.0)
    others = [other for other, size in sizes.items() if other != name and size > _MATTERS * most]
    return f", against {' and '.join(others)}" if others else ""
