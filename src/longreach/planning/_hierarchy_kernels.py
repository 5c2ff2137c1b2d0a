"""Compiled steps of a hierarchy of tasks, each in the null space of all those before it.

The rows of the tasks' Jacobians, one after the other, become J = L V with orthonormal rows of V and L lower triangular.
Then V[:rank] spans all that the tasks so far can feel, I - VᵀV is the projector of the augmented Jacobian of (4.17) in
factors, and V's newest rows hold the whole projected Jacobian B̃ of (4.16b). A level costs no singular values unless its
inverse asks for them or it is nearly singular.
"""

import math

import numpy as np

from longreach.kernels import kernel
from longreach.planning import _pseudoinverse_kernels as inverses

_FUSED = {"contract", "reassoc"}
_WELL = 1e4  # ‖L‖‖L⁻¹‖ below which equations of L Lᵀ keep eight digits


@kernel(fastmath=_FUSED)
def _remove(V, first, last, a, parts):
    """Take from a (n,) what lies along V[:last], add its parts along V[first:last] to `parts`; return what is left."""
    n = len(a)
    before = 0.0
    for k in range(n):
        before += a[k] * a[k]
    after = before
    for _ in range(2):  # twice is enough (Kahan; Parlett 1980, section 6-9)
        for j in range(last):
            along = 0.0
            for k in range(n):
                along += V[j, k] * a[k]
            for k in range(n):
                a[k] -= along * V[j, k]
            if j >= first:
                parts[j - first] += along
        after = 0.0
        for k in range(n):
            after += a[k] * a[k]
        if after > 0.25 * before:
            break
        before = after
    return math.sqrt(after)


@kernel(fastmath=_FUSED)
def factor(A, rows, m, tolerance, V, rank, L):
    """A[rows[:m]] = (what V[:rank] spans) + L V[rank:new]; L is (m, new - rank) of its (m, n). Return new.

    What is left of a row counts as nothing below `tolerance` times the row: so much is what a lower task may disturb.
    """
    n, new = A.shape[1], rank
    for i in range(m):
        row, a = A[rows[i]], V[min(new, n - 1)]
        for j in range(n):
            L[i, j] = 0.0
        if new == n:  # nothing is free any more: only the parts are wanted
            for j in range(rank, n):
                for k in range(n):
                    L[i, j - rank] += V[j, k] * row[k]
            continue
        size = 0.0
        for k in range(n):
            a[k] = row[k]
            size += row[k] * row[k]
        left = _remove(V, rank, new, a, L[i])
        if left > tolerance * math.sqrt(size):
            L[i, new - rank] = left
            for k in range(n):
                a[k] /= left
            new += 1
    return new


@kernel(fastmath=_FUSED)
def _bound_on_condition(L, m, inverse):
    """‖L‖‖L⁻¹‖ (Frobenius) of a square L; `inverse` is filled."""
    size, other = 0.0, 0.0
    for j in range(m):
        for i in range(j, m):
            total = 1.0 if i == j else 0.0
            for k in range(j, i):
                total -= L[i, k] * inverse[k, j]
            inverse[i, j] = total / L[i, i]
            other += inverse[i, j] * inverse[i, j]
            size += L[i, j] * L[i, j]
    return math.sqrt(size * other)


@kernel(fastmath=_FUSED)
def _damped_parts(L, m, damping, b, M, y):
    """y = Lᵀ (L Lᵀ + λ I)⁻¹ b by Cholesky's factors; M (m, m) is room, b is used up."""
    for i in range(m):
        for j in range(i + 1):
            total = damping if i == j else 0.0
            for k in range(j + 1):
                total += L[i, k] * L[j, k]
            for k in range(j):
                total -= M[i, k] * M[j, k]
            M[i, j] = math.sqrt(total) if i == j else total / M[j, j]
    for i in range(m):
        for k in range(i):
            b[i] -= M[i, k] * b[k]
        b[i] /= M[i, i]
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            b[i] -= M[k, i] * b[k]
        b[i] /= M[i, i]
    for j in range(m):
        y[j] = 0.0
        for i in range(j, m):
            y[j] += L[i, j] * b[i]


@kernel(fastmath=_FUSED)
def _carried(V, rank, count, y, x):
    """x = Vᵀ y over the `count` rows from `rank` on."""
    for k in range(len(x)):
        x[k] = 0.0
    for j in range(count):
        for k in range(len(x)):
            x[k] += y[j] * V[rank + j, k]


@kernel
def _by_singular_values(L, m, V, rank, new, inverse, b, x):
    """x (n,) = B̃# b for any inverse, B̃ = L V[rank:new]."""
    method, damping, tolerance, sigma0, v, bound, longest = inverse
    n, count = V.shape[1], new - rank
    B, A, s, reach, e = np.zeros((m, n)), np.empty((m, n + m)), np.empty(m), np.empty(n), np.empty(m)
    for i in range(m):
        for j in range(count):
            for k in range(n):
                B[i, k] += L[i, j] * V[rank + j, k]
        e[i] = b[i]
    inverses.decompose(B, tolerance, A, s)
    if sigma0 > 0.0:
        inverses.filter_values(s, v, sigma0)
    if method == inverses.SELECTIVE:
        inverses.clamp_blocks(b[:m], longest, e)
    inverses.step(B, A, s, e, method, damping, bound, reach, x)


@kernel
def level_step(L, m, V, rank, new, inverse, b, work, x):
    """x (n,) = B̃# b, B̃ = L V[rank:new]: triangular where that is good to eight digits, else by singular values."""
    method, damping, sigma0 = inverse[0], inverse[1], inverse[3]
    M, y = work
    square = new - rank == m
    if method == inverses.SELECTIVE or sigma0 > 0.0:
        _by_singular_values(L, m, V, rank, new, inverse, b, x)
    elif square and _bound_on_condition(L, m, M) < _WELL:
        if method == inverses.UNDAMPED or damping == 0.0:
            for i in range(m):
                y[i] = 0.0
                for k in range(i + 1):
                    y[i] += M[i, k] * b[k]
        else:
            _damped_parts(L, m, damping, b, M, y)
        _carried(V, rank, m, y, x)
    else:
        _by_singular_values(L, m, V, rank, new, inverse, b, x)
