"""Problem (4.34) over whole trajectories in casadi, for `sqp.py` and `sqp_scenes.py`."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

import longreach as lr
from longreach.planning.obstacles import Disc, Obstacle

STEP = 0.02  # [m, rad] of thesis_problem
BASE = 0.62  # [m] the circle around the Ridgeback


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
    import casadi as ca  # type: ignore[import-not-found]

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
