"""Compiled likelihood of an innovation's covariance, and how it changes with factors on parts of it."""

import math

import numpy as np

from longreach.estimation._cholesky_kernels import cholesky, solve
from longreach.kernels import kernel


@kernel
def score(S, r, parts, most, slope, information):
    """Fill slope (m,) and information (m,) of log N(r; 0, S) over logarithms of factors on the parts (m, k, k) of S.

    An innovation with a NIS above `most` counts as one at it. Returns whether S is positive definite.
    Source: the score and Fisher information of a normal distribution's covariance, Magnus & Neudecker 1988, 15.3.
    """
    k, m = len(r), len(parts)
    L, x, column = np.empty((k, k)), np.empty(k), np.empty(k)
    if not cholesky(S, L):
        return False
    solve(L, r, x)
    nis = np.sum(r * x)
    counted = min(1.0, most / nis) if nis > 0.0 else 1.0
    inverse_parts = np.empty((m, k, k))
    for p in range(m):
        for j in range(k):
            solve(L, parts[p, :, j].copy(), column)
            for i in range(k):
                inverse_parts[p, i, j] = column[i]
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


@kernel
def parts_of(R, blocks, parts):
    """Fill parts (2, k, k), the derivatives of D R D over the logarithms of two factors; blocks (k,): whose each is."""
    k = len(R)
    for block in range(2):
        for i in range(k):
            for j in range(k):
                parts[block, i, j] = 0.5 * ((blocks[i] == block) + (blocks[j] == block)) * R[i, j]


@kernel
def learn(S, r, own, seen, added, most, memory, lowest, highest, log, information, deviations):
    """Move log (m, 2) by the score over the information, both gathered; fill deviations (m, 3).

    own (2, k, k): parts of S of the first of m noises; added (m - 1, 2, 3, 3): of the others, of which r sees `seen`
    (k, 3). lowest (m,), highest: bounds of log. Returns whether S is positive definite, else nothing is done.
    """
    k, m = len(r), len(log)
    parts, slope, new = np.zeros((2 * m, k, k)), np.empty(2 * m), np.empty(2 * m)
    for block in range(2):
        for i in range(k):
            for j in range(k):
                parts[block, i, j] = own[block, i, j]
    for n in range(m - 1):
        for block in range(2):
            for i in range(k):
                for j in range(k):
                    for a in range(3):
                        for b in range(3):
                            parts[2 + 2 * n + block, i, j] += seen[i, a] * added[n, block, a, b] * seen[j, b]
    if not score(S, r, parts, most, slope, new):
        return False
    for n in range(m):
        for block in range(2):
            gathered = min(information[n, block] + new[2 * n + block], memory)
            moved = log[n, block] + slope[2 * n + block] / gathered
            log[n, block], information[n, block] = max(lowest[n], min(highest, moved)), gathered
        deviations[n, 0] = deviations[n, 1] = math.exp(0.5 * log[n, 0])
        deviations[n, 2] = math.exp(0.5 * log[n, 1])
    return True
