"""Problem (4.34) at one waypoint and over whole trajectories, beside SLSQP, and casadi with IPOPT and fatrop.

    OMP_NUM_THREADS=1 python benchmarks/sqp.py --bench FOLDER [--scenes 50] [--slsqp 10] [--ipopt-scenes 10]

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
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize

import longreach as lr
from longreach.planning.obstacles import Box, Capsule, Disc, Obstacle, link_capsules
from longreach.planning.problem import evaluate
from longreach.planning.terms import Waypoints
from longreach.planning.terms_clearance import (
    Keeping,
    SelfClearance,
    arm_clearance,
    base_clearance,
    least_clearance,
)
from longreach.robot.manipulability import manipulability

STEP = 0.02  # [m, rad] of thesis_problem
BASE = 0.62  # [m] the circle around the Ridgeback
THING = lr.load_robot("thing").with_tool("flange")
HOME = np.zeros(9)


def timed(call: Callable[[], Any], runs: int = 5) -> tuple[Any, float]:
    """Return the last result and the median time [s], after one call to warm up."""
    call()
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


def symbolic_terms(ca: Any) -> Any:
    """Return casadi's function q (9,) → flange pose (3, 4), -log M, by Table B.1."""
    q = ca.SX.sym("q", 9)
    c, s = ca.cos(q[2]), ca.sin(q[2])
    T = ca.vertcat(ca.horzcat(c, -s, 0, q[0]), ca.horzcat(s, c, 0, q[1]), ca.DM([[0, 0, 1, 0], [0, 0, 0, 1]]))
    T = T @ ca.DM([[0, -1, 0, 0.27], [1, 0, 0, 0.01], [0, 0, 1, 0.653], [0, 0, 0, 1]])
    d = (0.1273, 0, 0, 0.163941, 0.1157, 0.0922)
    a, alpha = (0, -0.612, -0.5723, 0, 0, 0), (1, 0, 0, 1, -1, 0)
    axes = [ca.DM([0, 0, 1])]
    for i in range(6):
        axes.append(T[:3, 2])
        c, s = ca.cos(q[3 + i]), ca.sin(q[3 + i])
        ca_, sa = (0, alpha[i]) if alpha[i] else (1, 0)
        T = T @ ca.vertcat(
            ca.horzcat(c, -s * ca_, s * sa, a[i] * c),
            ca.horzcat(s, c * ca_, -c * sa, a[i] * s),
            ca.horzcat(0, sa, ca_, d[i]),
            ca.DM([[0, 0, 0, 1]]),
        )
    J = ca.vertcat(ca.jacobian(T[:3, 3], q), ca.horzcat(ca.SX(3, 2), *axes))
    L = ca.chol(J @ J.T)
    return ca.Function("terms", [q], [T[:3, :], -ca.sum1(ca.log(ca.diag(L)))])


def casadi_trajectory(
    ref: lr.Reference, start: np.ndarray, solver: str, weight: float,
    room: tuple[float, float, float] = (0.01, 0.1, STEP), discs: Sequence[Obstacle] = (),
) -> tuple[np.ndarray, float]:  # fmt: skip
    """Return the answer for all waypoints with -log M, and the solver's time [s]; states q and controls Δq.

    room: the base's radius, its heading's band, and the largest step; discs: obstacles that are round seen from above.
    """
    radius, band, step = room
    import casadi as ca

    assert ref.base is not None
    assert ref.tool is not None
    terms, N = symbolic_terms(ca), len(ref)
    Q = [ca.SX.sym(f"q{k}", 9) for k in range(N)]
    U = [ca.SX.sym(f"u{k}", 9) for k in range(N - 1)]
    x, g, low, high, equality, cost = [], [], [], [], [], 0

    def add(value: Any, least: list[float], most: list[float]) -> None:
        g.append(value)
        low.extend(least)
        high.extend(most)
        equality.extend(a == b for a, b in zip(least, most, strict=True))

    for k in range(N):
        x.append(Q[k])
        pose, value = terms(Q[k])
        cost = cost + value
        if k < N - 1:
            x.append(U[k])
            cost = cost + weight * ca.sumsqr(U[k])
            add(Q[k + 1] - Q[k] - U[k], [0.0] * 9, [0.0] * 9)
        R = ca.DM(ref.tool[k, :3, :3]).T @ pose[:, :3]
        skew = 0.5 * ca.vertcat(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
        add(ca.vertcat(pose[:, 3] - ca.DM(ref.tool[k, :3, 3]), skew), [0.0] * 6, [0.0] * 6)
        add(ca.sumsqr(Q[k][:2] - ca.DM(ref.base[k, :2])) / (2.0 * radius), [-1e9], [0.5 * radius])
        add(Q[k][2] - ref.base[k, 2], [-band], [band])
        for disc in discs:
            centre = disc.centre if isinstance(disc, Disc) else disc.a[:2]  # type: ignore[union-attr]
            distance = ca.sqrt(ca.sumsqr(Q[k][:2] - ca.DM(centre)) + 1e-12)
            add(distance - BASE - disc.radius, [0.0], [1e9])  # type: ignore[union-attr]
        if k < N - 1:
            add(U[k], [-step] * 9, [step] * 9)
    options: dict[str, Any] = {"expand": True, "print_time": False}
    if solver == "ipopt":
        options["ipopt"] = {"print_level": 0, "sb": "yes", "tol": 1e-7}
    else:
        options |= {"structure_detection": "auto", "equality": equality, "fatrop": {"print_level": 0, "tol": 1e-7}}
    solve = ca.nlpsol("solve", solver, {"x": ca.vertcat(*x), "f": cost, "g": ca.vertcat(*g)}, options)
    both = np.hstack([start, np.vstack([np.diff(start, axis=0), np.zeros(9)])]).ravel()[:-9]
    began = time.perf_counter()
    found = solve(x0=both, lbg=low, ubg=high)
    seconds = time.perf_counter() - began
    q = np.append(np.asarray(found["x"]).ravel(), np.zeros(9)).reshape(N, 18)[:, :9]
    return q, seconds


def scene(rng: np.random.Generator, base: np.ndarray) -> tuple[Obstacle, ...]:
    """Return one to three obstacles on one side of the base's path, 2 to 20 cm too near."""
    out: list[Obstacle] = []
    side = rng.choice([-1.0, 1.0])
    for _ in range(rng.integers(1, 4)):
        k = int(rng.integers(len(base) // 8, 7 * len(base) // 8))
        along = base[k + 1, :2] - base[k - 1, :2]
        normal = side * np.array([-along[1], along[0]]) / np.linalg.norm(along)
        radius = rng.uniform(0.05, 0.3)
        middle = base[k, :2] + normal * (BASE + radius - rng.uniform(0.02, 0.2))
        kind, turn = rng.integers(3), rng.uniform(0.0, np.pi)
        if kind == 0:
            out.append(Disc(middle, radius))
        elif kind == 1:
            T = np.eye(4)
            T[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
            T[:3, 3] = [*middle, 0.4]
            out.append(Box(T, np.array([1.4 * radius, 1.4 * radius, 0.8])))
        else:
            out.append(Capsule(np.append(middle, 0.0), np.append(middle, 1.0), radius))
    return tuple(out)


def base_scene(rng: np.random.Generator, ref: lr.Reference, _: np.ndarray) -> tuple[Keeping, ...]:
    """Return what keeps the base clear of a random scene."""
    assert ref.base is not None
    return (base_clearance(BASE, scene(rng, ref.base)),)


def arm_scene(rng: np.random.Generator, ref: lr.Reference, q: np.ndarray) -> tuple[Keeping, ...]:
    """Return what keeps the arm clear of balls and beams beside and above its elbow's way along q.

    And what keeps forearm, wrists and gripper 1 to 4 cm farther from the base's body than they come along q.
    """
    elbow = THING.chain.ending("forearm_link").forward_and_jacobian_batch(q)[0][:, :3, 3]
    out: list[Obstacle] = []
    for _ in range(rng.integers(1, 3)):
        k, turn, radius = int(rng.integers(len(q) // 8, 7 * len(q) // 8)), rng.uniform(0.0, 0.5 * np.pi), 0.1
        away = np.array([0.0, np.cos(turn), np.sin(turn)])  # beside it or above: it must pass
        middle = elbow[k] + away * (0.14 + radius - rng.uniform(0.01, 0.06))
        half = rng.choice([0.0, 0.2]) * np.array([1.0, 0.0, 0.0])
        out.append(Capsule(middle - half, middle + half, radius))
    far = tuple(c for c in link_capsules(THING) if c.frame not in ("shoulder_link", "upper_arm_link"))
    T_base_body = np.eye(4)
    T_base_body[2, 3] = 0.168
    own = SelfClearance(far, (Box(T_base_body, np.array([0.96, 0.793, 0.296])),))
    margin = least_clearance(THING, q, own)[0] + rng.uniform(0.01, 0.04)
    return arm_clearance(THING, tuple(out)), replace(own, margin=max(margin, 0.0))


def scenes(name: str, make: Callable[..., tuple[Keeping, ...]], ref: lr.Reference, count: int) -> None:
    """Print how many random scenes are passed without touching, between the waypoints too."""
    passed, solved, times, least, q0 = 0, 0, [], np.inf, start_of(ref)
    for seed in range(count):
        terms = make(np.random.default_rng(seed), ref, q0)
        began = time.perf_counter()
        trajectory = plan(ref, problem=lr.thesis_problem(0.3, 0.5).adding(*terms))
        times.append(time.perf_counter() - began)
        clear = min(least_clearance(THING, trajectory.q, term, finer=50)[0] - term.margin for term in terms)
        good = not trajectory.solution.violated and clear >= 0.0
        passed, solved = passed + good, solved + trajectory.solution.converged
        least = min(least, clear) if good else least
    print(
        f"{count} scenes for the {name}, {len(ref)} waypoints: {passed} without touching, {solved} solved to 5e-7, "
        f"median {np.median(times):.2f} s, longest {np.max(times):.2f} s, least clearance {1e3 * least:.3f} mm"
    )


def scenes_beside_ipopt(ref: lr.Reference, count: int) -> None:
    """Print the same for scenes of round obstacles and -log M, beside IPOPT from the same start."""
    assert ref.base is not None
    q0 = start_of(ref)
    steps = np.diff(q0, axis=0)
    weight, step = 6.6e-4 / float(np.sum(steps**2, axis=1).mean()), max(STEP, 1.5 * np.abs(steps).max())
    times, passed, seed = np.zeros((2, count)), np.zeros((2, 2), dtype=int), 0
    for i in range(count):
        while any(isinstance(o, Box) for o in scene(np.random.default_rng(seed), ref.base)):
            seed += 1
        obstacles = scene(np.random.default_rng(seed), ref.base)
        seed += 1
        term = base_clearance(BASE, obstacles)
        began = time.perf_counter()
        ours = plan(ref, problem=lr.thesis_problem(0.3, 0.5, objective="neg_log_m").adding(term)).q
        times[0, i] = time.perf_counter() - began
        theirs, times[1, i] = casadi_trajectory(ref, q0, "ipopt", weight, (0.3, 0.5, step), obstacles)
        for j, q in enumerate((ours, theirs)):
            held = np.abs(THING.forward(q) - ref.tool).max() <= 1e-6
            for finer, least in ((1, -1e-6), (50, 0.0)):
                passed[j, int(finer > 1)] += held and least_clearance(THING, q, term, finer=finer)[0] >= least
    for name, number, row in zip(("longreach", "casadi ipopt"), passed, times, strict=True):
        print(
            f"{count} scenes of round obstacles, {name}: {number[0]} without touching at waypoints, "
            f"{number[1]} between them too, median {np.median(row):.2f} s"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bench", type=Path, required=True)
    parser.add_argument("--scenes", type=int, default=50)
    parser.add_argument("--slsqp", type=int, default=10, help="how many waypoints SLSQP gets")
    parser.add_argument("--ipopt-scenes", type=int, default=10)
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
    half = lr.Reference(ref.stamps[::2], dual["T"][::2], dual["B"][::2])
    if find_spec("casadi"):
        scenes_beside_ipopt(half, options.ipopt_scenes)
    if options.scenes:
        scenes("base", base_scene, half, options.scenes)
        scenes("arm", arm_scene, half, options.scenes)


if __name__ == "__main__":
    main()
