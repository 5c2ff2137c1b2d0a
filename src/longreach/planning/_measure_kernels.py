"""Compiled measures of manipulability along a trajectory: a log M + b log κ with gradients and curvature.

As in `robot.manipulability`, but in one pass and by what is known already. Where κ takes no part, no singular values
are needed: Gram and Schmidt's rows of the Jacobian do. Where it does, the left singular vectors of a waypoint are where
the search for its neighbour's begins, and those at q where one sweep finds them close by.
"""

import math

import numpy as np

from longreach.kernels import kernel
from longreach.robot._kinematics_kernels import forward_jacobian
from longreach.robot._manipulability_kernels import contract, log_measures, turn

_SWEEPS = 30
_SINGULAR = 1e-6  # part of a row's length: with less of it left, singular values tell more


@kernel
def _upright(J, first, scale, B):
    """Fill B (6, m + 6) with L⁻¹ [A | 1], A Aᵀ = L Lᵀ, see `singular_values` for A; return log M, NaN if singular."""
    m = J.shape[1] - first
    total = 0.0
    for p in range(6):
        whole = 0.0
        for i in range(m):
            B[p, i] = J[p, first + i] / scale if p < 3 else J[p, first + i]
            whole += B[p, i] * B[p, i]
        for i in range(6):
            B[p, m + i] = 1.0 if i == p else 0.0
        for r in range(p):
            c = 0.0
            for i in range(m):
                c += B[p, i] * B[r, i]
            for i in range(m + r + 1):
                B[p, i] -= c * B[r, i]
        left = 0.0
        for i in range(m):
            left += B[p, i] * B[p, i]
        if not left > _SINGULAR * _SINGULAR * whole:
            return np.nan
        total += 0.5 * math.log(left)
        left = 1.0 / math.sqrt(left)
        for i in range(m + p + 1):
            B[p, i] *= left
    return total


@kernel
def _turned(J, first, scale, sweeps, B, sigma):
    """Turn B (6, m + 6) = [· | Uᵀ] into [ΣVᵀ | Uᵀ] of this Jacobian, from the U that it holds, by so many sweeps."""
    m = J.shape[1] - first
    for p in range(6):
        for i in range(m):
            total = 0.0
            for r in range(6):
                x = B[p, m + r] * J[r, first + i]
                total += x / scale if r < 3 else x
            B[p, i] = total
    for _ in range(sweeps):
        done = True
        for p in range(5):
            for r in range(p + 1, 6):
                done &= turn(B, p, r, m)
        if done:
            break
    for p in range(6):
        total = 0.0
        for i in range(m):
            total += B[p, i] * B[p, i]
        sigma[p] = math.sqrt(total)


@kernel
def _by_singular_values(J, first, scale, a, b, sweeps, B, c, room, gradient):
    """Return a log M + b log κ and fill its gradient (n,); NaN if singular."""
    sigma = room[0]
    _turned(J, first, scale, sweeps, B, sigma)
    high, low, total = 0, 0, 0.0
    for p in range(6):
        high = p if sigma[p] > sigma[high] else high
        low = p if sigma[p] < sigma[low] else low
    if not sigma[low] > _SINGULAR * sigma[high]:
        return np.nan
    for p in range(6):
        total += math.log(sigma[p])
        c[p] = (a + (b if p == high else 0.0) - (b if p == low else 0.0)) / (sigma[p] * sigma[p])
    total = a * total + b * math.log(sigma[high] / sigma[low])
    contract(J, first, scale, B, c, room[1:], gradient)
    return total


@kernel
def _value(J, first, scale, a, b, sweeps, B, c, room, gradient):
    """Return the same by the cheapest way, or in singular postures by the one that always gives numbers."""
    m = J.shape[1] - first
    if b == 0.0:
        value = a * _upright(J, first, scale, B)
        if value == value:
            for p in range(6):
                c[p] = a
            contract(J, first, scale, B, c, room[1:], gradient)
            return value
    else:
        value = _by_singular_values(J, first, scale, a, b, sweeps, B, c, room, gradient)
        if value == value:
            return value
    values, gradients = np.empty(2), np.empty((2, J.shape[1]))
    log_measures(J, first, scale, values, gradients)
    for j in range(len(gradient)):
        gradient[j] = a * gradients[0, j] + b * gradients[1, j]
    for p in range(6):
        for i in range(6):
            B[p, m + i] = 1.0 if i == p else 0.0
    return a * values[0] + b * values[1]


@kernel
def values(J, first, scale, a, b, value, gradient):
    """Fill value (w,) and gradient (w, n) of a log M + b log κ, for neighbouring Jacobians J (w, 6, n)."""
    n = J.shape[2]
    B, c, room = np.zeros((6, n - first + 6)), np.empty(6), np.empty((n + 1, max(6, 3)))
    for p in range(6):
        B[p, n - first + p] = 1.0
    for w in range(len(J)):
        value[w] = _value(J[w], first, scale, a, b, _SWEEPS, B, c, room, gradient[w])


@kernel
def curvature(fixed, prismatic, q, J, Z, first, scale, a, b, exponential, step, out):
    """Fill out (w, n, p) with what a small move along each column of Z (w, n, p) changes of the gradient at q (w, n).

    That is of exp(a log M + b log κ) where `exponential`, else of the sum itself.
    """
    n, p = Z.shape[1], Z.shape[2]
    B, c, room = np.zeros((6, n - first + 6)), np.empty(6), np.empty((n + 1, 6))
    near, T, moved, x, here, there = B.copy(), np.empty((4, 4)), np.empty((6, n)), np.empty(n), np.empty(n), np.empty(n)
    for i in range(6):
        B[i, n - first + i] = 1.0
    for w in range(len(q)):
        v = _value(J[w], first, scale, a, b, _SWEEPS, B, c, room, here)
        v = math.exp(v) if exponential else 1.0
        for l in range(p):
            for j in range(n):
                x[j] = q[w, j] + step * Z[w, j, l]
            forward_jacobian(fixed, prismatic, x, T, moved)
            near[:] = B
            u = _value(moved, first, scale, a, b, 1, near, c, room, there)
            u = math.exp(u) if exponential else 1.0
            for j in range(n):
                out[w, j, l] = (u * there[j] - v * here[j]) / step
