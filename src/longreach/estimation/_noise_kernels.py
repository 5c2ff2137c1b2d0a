"""Compiled noise of sources: how likely an innovation makes factors on it, and what of a match's noise is its own.

The noise of a source is a row (7,): the logarithms of two factors, the information about each, and the deviations of
x, y and θ (see `noise.Noise`).
"""

import math

import numpy as np

from longreach.estimation._cholesky_kernels import cholesky, solve
from longreach.geometry._eigen_kernels import symmetric_eigen
from longreach.geometry._kernels import se2_adjoint, se2_between
from longreach.kernels import kernel

INFORMATION, DEVIATIONS = 2, 4
HIGHEST = math.log(25.0)  # what a stated variance may be too small by
_LOWEST = math.log(0.25)  # and too large by, of wheels
_OUTLIER = 4.0  # an innovation counts at most this many times what it should be on average


@kernel
def add_parts(R, blocks, parts):
    """Add to parts (2, k, k) the derivatives of D R D over the logarithms of two factors, which `blocks` (k,) names."""
    k = len(R)
    for block in range(2):
        for i in range(k):
            for j in range(k):
                parts[block, i, j] += 0.5 * ((blocks[i] == block) + (blocks[j] == block)) * R[i, j]


@kernel
def step_noise(covariance, noise, pose, Q, A, parts):
    """Fill Q (3, 3), the covariance of a wheels' step with the factors on it, Ad(pose⁻¹), and add Q's parts."""
    x, y, t = se2_between(pose[0], pose[1], pose[2], 0.0, 0.0, 0.0)
    se2_adjoint(x, y, t, A)
    for i in range(3):
        for j in range(3):
            Q[i, j] = covariance[i, j] * (noise[DEVIATIONS + i] * noise[DEVIATIONS + j])
    blocks = np.zeros(3, dtype=np.int64)
    blocks[2] = 1
    add_parts(Q, blocks, parts)


@kernel
def learn(S, r, H, R, blocks, coupled, added, memory, is_wheels, noises):
    """Move the logarithms of noises (m, 7) by the score over the information, both gathered, where S is definite.

    R (k, k): the part of S that is the first noise's, of wheels or not. added (m - 1, 2, 3, 3): parts of the others,
    which are of the wheels' steps, in the pose as far as it is coupled (3,). An innovation with a NIS above _OUTLIER k
    counts as one at it.
    Source: the score and Fisher information of a normal distribution's covariance, Magnus & Neudecker 1988, 15.3.
    """
    k, m = len(r), len(noises)
    parts, inverse_parts = np.zeros((2 * m, k, k)), np.empty((2 * m, k, k))
    L, x, column = np.empty((k, k)), np.empty(k), np.empty(k)
    if not cholesky(S, L):
        return
    add_parts(R, blocks, parts)
    for n in range(m - 1):
        for block in range(2):
            for i in range(k):
                for j in range(k):
                    for a in range(3):
                        for b in range(3):
                            seen = H[i, a] * coupled[a], H[j, b] * coupled[b]
                            parts[2 + 2 * n + block, i, j] += seen[0] * added[n, block, a, b] * seen[1]
    solve(L, r, x)
    nis = np.sum(r * x)
    counted = min(1.0, _OUTLIER * k / nis) if nis > 0.0 else 1.0
    for p in range(2 * m):
        for j in range(k):
            solve(L, parts[p, :, j].copy(), column)
            for i in range(k):
                inverse_parts[p, i, j] = column[i]
    for p in range(2 * m):
        score, information, noise, block = 0.0, 0.0, noises[p // 2], p % 2
        for i in range(k):
            score -= inverse_parts[p, i, i]
            for j in range(k):
                score += counted * x[i] * parts[p, i, j] * x[j]
        for other in range(2 * m):
            shared = 0.0
            for i in range(k):
                for j in range(k):
                    shared += inverse_parts[p, i, j] * inverse_parts[other, j, i]
            information += 0.5 * abs(shared)
        gathered = min(noise[INFORMATION + block] + information, memory)
        lowest = _LOWEST if p > 1 or is_wheels else 0.0
        noise[block] = max(lowest, min(HIGHEST, noise[block] + 0.5 * score / gathered))
        noise[INFORMATION + block] = gathered
        for axis in range(2 * block, 2 + block):  # x, y or θ
            noise[DEVIATIONS + axis] = math.exp(0.5 * noise[block])


@kernel
def own_part(C, pose, shared, least, out):
    """Fill out (3, 3) with C - Ad(pose⁻¹) shared Ad(pose⁻¹)ᵀ, but in every direction at least the part `least` of C.

    In the basis where C is the identity both are diagonal: the generalised eigenvalues w of what is taken off become
    max(1 - w, least). Returns False where C is not positive definite or the pose not finite.
    """
    A, L, V = np.empty((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    if not (cholesky(C, L) and math.isfinite(pose[0] + pose[1] + pose[2])):
        return False
    x, y, t = se2_between(pose[0], pose[1], pose[2], 0.0, 0.0, 0.0)
    se2_adjoint(x, y, t, A)
    for j in range(3):  # A := L⁻¹ A
        for i in range(3):
            for k in range(i):
                A[i, j] -= L[i, k] * A[k, j]
            A[i, j] /= L[i, i]
    W = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for l in range(3):
                    W[i, j] += A[i, k] * shared[k, l] * A[j, l]
    symmetric_eigen(W, V)
    out[:] = 0.0
    for k in range(3):
        part = max(1.0 - W[k, k], least)
        for i in range(3):
            for j in range(3):
                a = b = 0.0
                for l in range(3):
                    a += L[i, l] * V[l, k]
                    b += L[j, l] * V[l, k]
                out[i, j] += part * a * b
    return True
