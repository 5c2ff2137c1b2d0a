"""Compiled step of a hierarchy of tasks that do not get in each other's way: one Cholesky factorisation for all levels.

With J = L V as in `_hierarchy_kernels`, J Jᵀ = L Lᵀ: Cholesky's factor is the same L. The block L_ij is what level i
feels of level j's orthonormal directions, so that (4.16), any number of levels, is substitution block by block:

    (L_ii L_iiᵀ + λ_i I) c_i = a_i - Σ_j<i L_ij y_j,    y_i = L_iiᵀ c_i,    dq = Jᵀ L⁻ᵀ y.

It squares the condition number: rows that lie nearer than `_NEAR` to those above them are refused.
"""

import math

import numpy as np

from longreach.kernels import kernel
from longreach.planning import _pseudoinverse_kernels as inverses

_FUSED = {"contract", "reassoc"}
_ZERO = np.int64(0)  # as in _priority_kernels
_NEAR = 1e-4  # squared sine of the angle between a row and those before it; L then has 12 digits


@kernel(fastmath=_FUSED)
def _factor(A, rows, m, L):
    """L Lᵀ = J Jᵀ of the rows; False where one of them lies too near to those before it."""
    n = A.shape[1]
    for i in range(m):
        a = A[rows[i]]
        for j in range(i + 1):
            b = A[rows[j]]
            total = 0.0
            for k in range(n):
                total += a[k] * b[k]
            square = total
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > _NEAR * square:
                    return False
                L[i, i] = math.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@kernel(fastmath=_FUSED)
def _damped(L, first, last, damping, M, b):
    """b[first:last] = L_iiᵀ (L_ii L_iiᵀ + λ I)⁻¹ b."""
    for i in range(first, last):
        for j in range(first, i + 1):
            total = damping if i == j else 0.0
            for k in range(first, j + 1):
                total += L[i, k] * L[j, k]
            for k in range(first, j):
                total -= M[i, k] * M[j, k]
            M[i, j] = math.sqrt(total) if i == j else total / M[j, j]
    for i in range(first, last):
        for k in range(first, i):
            b[i] -= M[i, k] * b[k]
        b[i] /= M[i, i]
    for i in range(last - 1, first - 1, -1):
        for k in range(i + 1, last):
            b[i] -= M[k, i] * b[k]
        b[i] /= M[i, i]
    for j in range(first, last):  # row j of Lᵀ needs only what comes after it
        b[j] *= L[j, j]
        for i in range(j + 1, last):
            b[j] += L[i, j] * b[i]


@kernel(fastmath=_FUSED)
def quick_step(A, a, starts, ranged, setting, rows, L, M, b, parts, dq):
    """dq (n,) and how far each level's part of it goes.

    False where the levels get in each other's way or their inverses need singular values.
    """
    m, n = _ZERO, len(dq)
    for level in range(len(starts) - 1):
        first = m
        for r in range(starts[level], starts[level + 1]):
            if not ranged[r]:
                if m == n:
                    return False
                rows[m], b[m] = r, a[r]
                m += 1
        if m > first and (setting[level, 0] == inverses.SELECTIVE or setting[level, 3] > 0.0):
            return False
    if not _factor(A, rows, m, L):
        return False
    last = _ZERO
    for level in range(len(starts) - 1):
        first = last
        while last < m and rows[last] < starts[level + 1]:
            last += 1
        for i in range(first, last):
            for k in range(first):
                b[i] -= L[i, k] * b[k]
        damping = setting[level, 1]
        if setting[level, 0] == inverses.DAMPED and damping > 0.0:
            _damped(L, first, last, damping, M, b)
        else:
            for i in range(first, last):
                for k in range(first, i):
                    b[i] -= L[i, k] * b[k]
                b[i] /= L[i, i]
        square = 0.0
        for i in range(first, last):
            square += b[i] * b[i]
        parts[level] = math.sqrt(square)
    for k in range(n):
        dq[k] = 0.0
    for i in range(m - 1, -1, -1):
        for k in range(i + 1, m):
            b[i] -= L[k, i] * b[k]
        b[i] /= L[i, i]
        for k in range(n):
            dq[k] += b[i] * A[rows[i], k]
    return True
