"""Compiled inner loops of sequential convex optimisation, over all waypoints at once."""

import math

import numpy as np

from longreach.kernels import kernel
from longreach.planning import _task_kernels
from longreach.robot._kinematics_kernels import forward_jacobian

_DEPENDENT = 1e-10  # a row this much of the first, once those before it are taken out, is no new equation


@kernel
def tool_errors(T_target, T, J, e, A):
    """Fill e (m, 6) with log(T_target⁻¹ T) (4.28) and A (m, 6, n) with its derivative, for m poses (m, 4, 4)."""
    for i in range(len(T)):
        _task_kernels.pose_error_and_jacobian(T_target[i], T[i], J[i], e[i], A[i])


@kernel
def _pulled(A, multipliers, out):
    for j in range(len(out)):
        out[j] = 0.0
    for i in range(len(multipliers)):
        for j in range(len(out)):
            out[j] += multipliers[i] * A[i, j]


@kernel
def tool_curvature(fixed, prismatic, q, T_target, T, J, multipliers, Z, step, out):
    """Fill out (w, n, p) with what steps along Z (w, n, p) change of Aᵀ λ, A as in `tool_errors`, λ (w, 6)."""
    n = q.shape[1]
    e, A, here, there = np.empty(6), np.empty((6, n)), np.empty(n), np.empty(n)
    x, T_moved, J_moved = np.empty(n), np.empty((4, 4)), np.empty((6, n))
    for w in range(len(q)):
        _task_kernels.pose_error_and_jacobian(T_target[w], T[w], J[w], e, A)
        _pulled(A, multipliers[w], here)
        for l in range(Z.shape[2]):
            for j in range(n):
                x[j] = q[w, j] + step * Z[w, j, l]
            forward_jacobian(fixed, prismatic, x, T_moved, J_moved)
            _task_kernels.pose_error_and_jacobian(T_target[w], T_moved, J_moved, e, A)
            _pulled(A, multipliers[w], there)
            for j in range(n):
                out[w, j, l] = (there[j] - here[j]) / step


@kernel
def _householder(W, Q, i):
    """Turn column i of W (n, m) onto its first n - i entries by a reflection, which Q (n, n) takes up."""
    n, m = W.shape
    norm = 0.0
    for k in range(i, n):
        norm += W[k, i] * W[k, i]
    norm = math.sqrt(norm)
    if norm == 0.0:
        return
    alpha = -norm if W[i, i] > 0.0 else norm
    v = np.zeros(n)
    square = 0.0
    for k in range(i, n):
        v[k] = W[k, i] - alpha if k == i else W[k, i]
        square += v[k] * v[k]
    for j in range(i, m):
        total = 0.0
        for k in range(i, n):
            total += v[k] * W[k, j]
        total *= 2.0 / square
        for k in range(i, n):
            W[k, j] -= total * v[k]
    for r in range(n):
        total = 0.0
        for k in range(i, n):
            total += Q[r, k] * v[k]
        total *= 2.0 / square
        for k in range(i, n):
            Q[r, k] -= total * v[k]


@kernel
def eliminate(A, c, Q, R, d, independent):
    """Solve A d = -c for the shortest d (w, n), A (w, m, n); independent (w,): whether there is one, d is 0 where not.

    Q (w, n, n) and R (w, m, m) are the factors of Aᵀ = Q [R; 0] by Householder's reflections: the last n - m columns of
    Q span what the equations leave free. Source: Golub & Van Loan, "Matrix Computations", section 5.2.
    """
    m, n = A.shape[1], A.shape[2]
    if m > n:
        independent[:] = False
        Q[:], R[:], d[:] = 0.0, 0.0, 0.0
        return
    W, y = np.empty((n, m)), np.empty(m)
    for w in range(len(A)):
        for i in range(n):
            for j in range(m):
                W[i, j] = A[w, j, i]
            for j in range(n):
                Q[w, i, j] = 1.0 if i == j else 0.0
        for i in range(m):
            _householder(W, Q[w], i)
        for i in range(m):
            for j in range(m):
                R[w, i, j] = W[i, j] if j >= i else 0.0
        independent[w] = True
        for i in range(m):
            independent[w] &= abs(R[w, i, i]) > _DEPENDENT * abs(R[w, 0, 0])
        for i in range(n):
            d[w, i] = 0.0
        if independent[w]:
            for i in range(m):  # Rᵀ y = -c
                y[i] = -c[w, i]
                for j in range(i):
                    y[i] -= R[w, j, i] * y[j]
                y[i] /= R[w, i, i]
            for i in range(n):
                for j in range(m):
                    d[w, i] += Q[w, i, j] * y[j]


@kernel
def equation_multipliers(Q, R, r, out):
    """Fill out (w, m) with the λ that makes r + Aᵀ λ (w, n) shortest, A = Rᵀ [I 0] Qᵀ as `eliminate` factored it."""
    m = R.shape[1]
    for w in range(len(R)):
        for i in range(m - 1, -1, -1):
            total = 0.0
            for k in range(r.shape[1]):
                total -= Q[w, k, i] * r[w, k]
            for j in range(i + 1, m):
                total -= R[w, i, j] * out[w, j]
            out[w, i] = total / R[w, i, i]


@kernel
def correct(A, r, used, d):
    """Fill d (w, n) with the shortest step with A d = -r, A (w, m, n), r (w, m), over the rows that are used (w, m).

    By Cholesky's factors of A Aᵀ, with so much added that dependent rows do no harm.
    """
    m, n = A.shape[1], A.shape[2]
    L, y, rows = np.empty((m, m)), np.empty(m), np.empty(m, dtype=np.int64)
    for w in range(len(A)):
        k = 0
        for i in range(m):
            if used[w, i]:
                rows[k] = i
                k += 1
        for j in range(n):
            d[w, j] = 0.0
        for i in range(k):
            y[i] = -r[w, rows[i]]
            for j in range(i + 1):
                total = 1e-12 if i == j else 0.0
                for l in range(n):
                    total += A[w, rows[i], l] * A[w, rows[j], l]
                for l in range(j):
                    total -= L[i, l] * L[j, l]
                if i == j:
                    L[i, i] = math.sqrt(max(total, 1e-12))
                else:
                    L[i, j] = total / L[j, j]
                    y[i] -= L[i, j] * y[j]
            y[i] /= L[i, i]
        for i in range(k - 1, -1, -1):
            for j in range(i + 1, k):
                y[i] -= L[j, i] * y[j]
            y[i] /= L[i, i]
            for l in range(n):
                d[w, l] += A[w, rows[i], l] * y[i]
