"""Problem (4.34) at one waypoint and over whole trajectories, beside SLSQP, and casadi with IPOPT and fatrop.

    OMP_NUM_THREADS=1 python benchmarks/sqp.py --bench FOLDER [--slsqp 10]

FOLDER holds dual.npz with the tool's poses T (n, 4, 4), the base's B (n, 3) and the start `home`; the tool is the
flange. casadi is not installed with longreach: make an environment for this benchmark, `pip install . casadi`; without
it the peers of whole trajectories are left out. scipy's SLSQP gets our derivatives and starts where we do.

Each number is the median of several runs, kernels warm. What is said of an answer is measured from it. casadi gets the
same problem by a symbolic Table B.1, with M as its objective's -log (it has no singular values for κ), expanded, and
the same start; the time is the solver's alone, without building the graph.

Bars: one waypoint 1.0 ms at f ≤ 1.7941; 200 waypoints 0.10 s at f ≤ 1.7952, and with -log M at M up by 1.75 %, no
step above 0.025 rad; 2000 waypoints at most 12 times that.
"""

import argparse
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize
from sqp_casadi import casadi_trajectory

import longreach as lr
from longreach.planning.problem import evaluate
from longreach.planning.terms import Waypoints
from longreach.robot.manipulability import manipulability

THING = lr.load_robot("thing").with_tool("flange")
HOME = np.zeros(9)


def timed(call: Callable[[], Any], runs: int = 5) -> tuple[Any, float]:
    """Return the last result and the median time [s], after one call to warm up."""
    result = call()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        result = call()
        times.append(time.perf_counter() - start)
    return result, float(np.median(times))


def judge(name: str, seconds: float, q: np.ndarray, ref: lr.Reference, q0: np.ndarray, note: str = "") -> None:
    """Print what an answer is worth, from its configurations alone."""
    assert ref.base is not None
    assert ref.tool is not None
    f = manipulability(THING, q, "sqrt_kappa_over_m")[0].mean()
    M, M0 = (manipulability(THING, x)[0].mean() for x in (q, q0))
    disc = np.linalg.norm(q[:, :2] - ref.base[:, :2], axis=1).max() - 0.01
    turn = np.abs(q[:, 2] - ref.base[:, 2]).max() - 0.1
    tool = np.abs(THING.forward(q) - ref.tool).max()
    step = np.abs(np.diff(q, axis=0)).max(initial=0.0)
    print(
        f"{name:28s} {1e3 * seconds:9.2f} ms  f {f:.5f}  M {100 * (M / M0 - 1):+.3f} %  step {step:.4f}  "
        f"tool {tool:.0e}  disc {max(disc, 0):.0e}  heading {max(turn, 0):.0e}  {note}"
    )


def start_of(ref: lr.Reference) -> np.ndarray:
    slow = lr.Reference(1e4 * np.arange(len(ref)), ref.tool, ref.base)
    return lr.plan(THING, slow, HOME).q


def plan(ref: lr.Reference, **options: Any) -> Any:
    return lr.plan(THING, ref, HOME, method="sqp", **options)


def slsqp(ref: lr.Reference, start: np.ndarray, k: int) -> np.ndarray:
    """Return SLSQP's answer at one waypoint: the better one from both ends of the heading's band."""
    problem, index = lr.thesis_problem(), np.array([k])

    def terms(q: np.ndarray) -> Any:
        return evaluate(problem, Waypoints(THING, ref, index, q[None]))

    constraints = [
        {"type": "eq", "fun": lambda q: terms(q).c[0, :6], "jac": lambda q: terms(q).A[0, :6]},
        {"type": "ineq", "fun": lambda q: 0.005 - terms(q).c[0, 6], "jac": lambda q: -terms(q).A[0, 6]},
        {"type": "ineq", "fun": lambda q: 0.1 - terms(q).c[0, -1], "jac": lambda q: -terms(q).A[0, -1]},
        {"type": "ineq", "fun": lambda q: 0.1 + terms(q).c[0, -1], "jac": lambda q: terms(q).A[0, -1]},
    ]
    answers = []
    for turn in (0.05, -0.05):
        found = minimize(
            lambda q: terms(q).f[0], start[k] + turn * (np.arange(9) == 2), jac=lambda q: terms(q).g[0],
            method="SLSQP", constraints=constraints, options={"ftol": 1e-10, "maxiter": 200},
        )  # fmt: skip
        answers.append((found.fun if found.success else np.inf, found.x))
    return min(answers, key=lambda answer: answer[0])[1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", type=Path, required=True)
    parser.add_argument("--slsqp", type=int, default=10, help="how many waypoints SLSQP gets")
    options = parser.parse_args()
    dual = np.load(options.bench / "dual.npz")
    HOME[:] = dual["home"]
    n = len(dual["T"])
    ref = lr.Reference(0.1 * np.arange(n), dual["T"], dual["B"])
    q0 = start_of(ref)
    print(f"One waypoint, {n} of them:")
    apart, seconds = timed(lambda: plan(ref, coupled=False))
    judge("longreach", seconds / n, apart.q, ref, q0, apart.solution.status)
    some = np.linspace(0, n - 1, options.slsqp).astype(int)
    began = time.perf_counter()
    found = np.array([slsqp(ref, q0, k) for k in some])
    seconds = (time.perf_counter() - began) / len(some)
    few = lr.Reference(ref.stamps[some], dual["T"][some], dual["B"][some])
    judge(f"SLSQP, {len(some)} of them", seconds, found, few, q0[some])
    judge("longreach, the same", 0.0, apart.q[some], few, q0[some])
    print(f"All {n} waypoints:")
    shorter = 0.0
    for objective in ("sqrt_kappa_over_m", "neg_log_m"):
        whole, seconds = timed(lambda o=objective: plan(ref, problem=lr.thesis_problem(objective=o)))
        shorter = shorter or seconds
        judge(f"longreach, {objective}", seconds, whole.q, ref, q0, whole.solution.status)
    if find_spec("casadi"):
        square = float(np.sum(np.diff(q0, axis=0) ** 2, axis=1).mean())
        for solver in ("ipopt", "fatrop"):
            q, seconds = casadi_trajectory(ref, q0, solver, 6.6e-4 / square)
            judge(f"casadi {solver}, neg_log_m", seconds, q, ref, q0)
    u = np.linspace(0.0, 1.0, 10 * n)
    T = np.repeat(dual["T"][:1], 10 * n, axis=0)
    T[:, :3, 3] += u[:, None] * (dual["T"][-1] - dual["T"][0])[:3, 3]
    long = lr.Reference(0.01 * np.arange(10 * n), T, CubicSpline(np.linspace(0, 1, n), dual["B"])(u))
    whole, seconds = timed(lambda: plan(long), runs=3)
    judge(f"longreach, {10 * n} waypoints", seconds, whole.q, long, start_of(long), f"{seconds / shorter:.1f} times")


if __name__ == "__main__":
    main()
