"""Compiled algebra of the small covariances of innovations, 1 to 3 rows, by a Cholesky written out here."""

import math

import numpy as np

from longreach.kernels import kernel


@kernel
def cholesky(S, L):
    for i in range(len(S)):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            elif total > 0.0 and total < np.inf:
                L[i, i] = math.sqrt(total)
            else:
                return False
    return True


@kernel
def solve(L, b, x):
    """L Lᵀ x = b."""
    n = len(b)
    for i in range(n):
        total = b[i]
        for k in range(i):
            total -= L[i, k] * x[k]
        x[i] = total / L[i, i]
    for i in range(n - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, n):
            total -= L[k, i] * x[k]
        x[i] = total / L[i, i]


@kernel
def squared_norm(S, r):
    """rᵀ S⁻¹ r, or 0 where S is not positive definite."""
    L, x = np.empty(S.shape), np.empty(len(r))
    if not cholesky(S, L):
        return 0.0
    solve(L, r, x)
    return np.sum(r * x)
