"""Sequential convex optimisation, Algorithm 2 as corrected: ℓ1 merit, trust region, penalties that rise where needed.

Many problems of the same terms go in step: each waypoint a problem of its own, or one problem of all waypoints. Every
round convexifies them (4.20), (4.21), solves the subproblems (4.22) and takes those steps by which the exact merit
f + Σ μ · violation, (4.23) corrected, improves by at least a part c of what its model said; elsewhere the trust region
shrinks.
"""

import time

import numpy as np
from jaxtyping import Float, Int

from longreach.planning import sqp_merit as merit
from longreach.planning.program import Program
from longreach.planning.sqp_model import convexify, minimise
from longreach.planning.sqp_rounds import attempt
from longreach.planning.sqp_run import Run, SqpConfig, start

_TRIAL = 2  # rounds before rivals are compared
_CLEARLY = 1e-3  # of the merit: what is behind by that much will not win


def solve(
    program: Program,
    x0: Float[np.ndarray, "B N n"],
    config: SqpConfig,
    rivals: Int[np.ndarray, " B"] | None = None,
) -> Run:
    """Go on until all problems are done, or the iterations or the time run out.

    rivals (B,): problems of the same number compete: those clearly behind after some rounds are given up.
    """
    began = time.perf_counter()
    run = start(program, x0, config)
    merit.remember(run, np.arange(len(run.x)))
    for i in range(config.iterations):
        todo = np.flatnonzero(~run.done)
        model = convexify(run, todo)
        steps = minimise(run, todo, model)
        attempt(run, todo, model, steps)
        run.history.append(merit.state(run))
        if rivals is not None and i + 1 >= _TRIAL:
            run.done |= merit.behind(run, rivals, _CLEARLY if i < 2 * _TRIAL else 0.0)
        if run.done.all():
            break
        if time.perf_counter() - began > config.budget:
            run.late = True
            break
    merit.recall(run)
    return run
