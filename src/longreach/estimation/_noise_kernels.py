"""Compiled likelihood of an innovation's covariance, and how it changes with factors on parts of it."""

import numpy as np

from longreach.estimation._kernels import _cholesky, _solve
from longreach.kernels import kernel


@kernel
def score(S, r, parts, most, slope, information):
    """Fill slope (m,) and information (m,) of log N(r; 0, S) over logarithms of factors on the parts (m, k, k) of S.

    An innovation with a NIS above `most` counts as one at it. Returns whether S is positive definite.
    Source: the score and Fisher information of a normal distribution's covariance, Magnus & Neudecker 1988, 15.3.
    """
    k, m = len(r), len(parts)
    L, x, column = np.empty((k, k)), np.empty(k), np.empty(k)
    if not _cholesky(S, L):
        return False
    _solve(L, r, x)
    nis = np.sum(r * x)
    counted = min(1.0, most / nis) if nis > 0.0 else 1.0
    inverse_parts = np.empty((m, k, k))
    for p in range(m):
        for j in range(k):
            _solve(L, parts[p, :, j].copy(), column)
            inverse_parts[p, :, j] = column
    for p in range(m):
        total = 0.0
        for i in range(k):
            total -= inverse_parts[p, i, i]
            for j in range(k):
                total += counted * x[i] * parts[p, i, j] * x[j]
        slope[p] = 0.5 * total
        information[p] = 0.0
        for other in range(m):
            shared = 0.0
            for i in range(k):
                for j in range(k):
                    shared += inverse_parts[p, i, j] * inverse_parts[other, j, i]
            information[p] += 0.5 * abs(shared)
    return True
