"""Compiled inner loops of sequential convex optimisation, over all waypoints at once."""

import math

import numpy as np

from longreach.kernels import kernel
from longreach.planning import _task_kernels

_DEPENDENT = 1e-10  # a row this much of the first, once those before it are taken out, is no new equation


@kernel
def tool_errors(T_target, T, J, e, A):
    """Fill e (m, 6) with log(T_target⁻¹ T) (4.28) and A (m, 6, n) with its derivative, for m poses (m, 4, 4)."""
    for i in range(len(T)):
        _task_kernels.pose_error_and_jacobian(T_target[i], T[i], J[i], e[i], A[i])


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


@kernel
def _factor_row(B, L, i):
    """Fill row i of the banded Cholesky factor L of the banded lower matrix B; return whether there is one.

    B[i, w - 1 - o] and L[i, w - 1 - o] are the entries (i, i - o), w the width of the band.
    """
    w = B.shape[1]
    for o in range(min(i, w - 1), -1, -1):
        j = i - o
        total = B[i, w - 1 - o]
        for l in range(max(0, i - w + 1, j - w + 1), j):
            total -= L[i, w - 1 - i + l] * L[j, w - 1 - j + l]
        if o == 0:
            if total <= 0.0:
                return False
            L[i, w - 1] = math.sqrt(total)
        else:
            L[i, w - 1 - o] = total / L[j, w - 1]
    return True


@kernel
def mend(H, convex, band, floor):
    """Put blocks of `convex` (N, p, p) for those of H (N, p, p) until H + links' curvature is convex.

    band (N p, width): the links' curvature, banded as `_factor_row` has it. Where factoring fails, the last waypoint
    that can give way does. No eigenvalue is below the floor then; return whether it came out.
    """
    N, p, _ = H.shape
    w = band.shape[1]
    B, L = band.copy(), np.zeros(band.shape)
    mended = np.zeros(N, dtype=np.bool_)
    for k in range(N):
        for a in range(p):
            for b in range(a + 1):
                B[k * p + a, w - 1 - a + b] += H[k, a, b] - (floor if a == b else 0.0)
    k = 0
    while k < N:
        fine = True
        for a in range(p):
            fine = fine and _factor_row(B, L, k * p + a)
        if fine:
            k += 1
            continue
        while k >= 0 and mended[k]:
            k -= 1
        if k < 0:
            return False
        mended[k] = True
        for a in range(p):
            for b in range(p):
                if b <= a:
                    B[k * p + a, w - 1 - a + b] += convex[k, a, b] - H[k, a, b]
                H[k, a, b] = convex[k, a, b]
    return True
