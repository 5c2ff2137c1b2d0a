"""Compiled pose clones: cloning, wheel odometry's steps, and the change of the local reference.

Layout of the mean and of P: see `_kernels`.
"""

import math

import numpy as np

from longreach.estimation._kernels import REFERENCE, SCALE, congruence
from longreach.geometry._kernels import se2_adjoint, se2_between, se2_compose, se2_exp, se2_log, se2_right_jacobian
from longreach.kernels import kernel


@kernel
def carry(mean, P, i, pose, Q, coupled, variance, reach):
    """Move the pose clone at i by a pose (3,) seen from it, stretched by 1 + s, whose error has covariance Q.

    coupled (3,): axes (1: yes, 0: no) in which the step's error is the error of the present pose as well. s, the scale
    errors of the wheels, fade over `reach` and stay at the variance (3,) that they have when nothing is known.
    """
    n = len(mean)
    moved, T = mean.copy(), np.zeros((n, n))
    for a in range(n):
        T[a, a] = 1.0
    d0, d1, d2 = se2_log(pose[0], pose[1], pose[2])
    way = (d0, d1, d2)
    d0, d1, d2 = d0 * (1.0 + mean[SCALE]), d1 * (1.0 + mean[SCALE + 1]), d2 * (1.0 + mean[SCALE + 2])
    x, y, t = se2_exp(d0, d1, d2)
    moved[i], moved[i + 1], moved[i + 2] = se2_compose(mean[i], mean[i + 1], mean[i + 2], x, y, t)
    x, y, t = se2_exp(-d0, -d1, -d2)
    se2_adjoint(x, y, t, T[i : i + 3, i : i + 3])
    J, L = np.empty((3, 3)), np.empty((3, 3))
    se2_right_jacobian(d0, d1, d2, J)
    x, y, t = se2_between(mean[0], mean[1], mean[2], moved[i], moved[i + 1], moved[i + 2])
    se2_adjoint(x, y, t, L)  # the clone's error as the pose's, where both move together
    for a in range(3):
        L[:, a] *= coupled[a]
    fade = math.exp(-(math.hypot(way[0], way[1]) + abs(way[2])) / reach)
    for b in range(3):
        T[SCALE + b, SCALE + b] = fade
        moved[SCALE + b] = fade * mean[SCALE + b]
        for a in range(3):
            T[i + a, SCALE + b] = J[a, b] * way[b]
            for c in range(3):
                T[a, SCALE + b] += L[a, c] * J[c, b] * way[b]
    new = congruence(T, P)
    for a in range(3):
        new[SCALE + a, SCALE + a] += (1.0 - fade * fade) * variance[a]
        for b in range(3):
            new[i + a, i + b] += Q[a, b]
            for c in range(3):
                new[a, i + b] += L[a, c] * Q[c, b]
                new[i + b, a] += L[a, c] * Q[c, b]
                for d in range(3):
                    new[a, b] += L[a, c] * Q[c, d] * L[b, d]
    return moved, new, T


@kernel
def as_clone(mean, i, A):
    """Fill A (3, 3), which makes an error of the base's pose one of the pose clone at i, where both move together."""
    x, y, t = se2_between(mean[i], mean[i + 1], mean[i + 2], mean[0], mean[1], mean[2])
    se2_adjoint(x, y, t, A)


@kernel
def chosen(mean, P, rows):
    """Choose these rows of the mean and of P, correlations and all."""
    n = len(rows)
    new, covariance = np.empty(n), np.empty((n, n))
    for a in range(n):
        new[a] = mean[rows[a]]
        for b in range(n):
            covariance[a, b] = P[rows[a], rows[b]]
    return new, covariance


@kernel
def rebase(mean, P, r):
    """Make the pose A at r the reference; returns the mean, P, and how errors before are errors after.

    A pose Y, seen from the reference, becomes A⁻¹Y, its error η - Ad((A⁻¹Y)⁻¹) α: nothing at all for A itself. The
    pose G of the reference becomes G A, its error Ad(A⁻¹) γ + α.
    """
    n = len(mean)
    new, M, B = mean.copy(), np.zeros((n, n)), np.empty((3, 3))
    for a in range(n):
        M[a, a] = 1.0
    A = (mean[r], mean[r + 1], mean[r + 2])
    for k in range((n - REFERENCE) // 3 + 1):
        i = 0 if k == 0 else REFERENCE + 3 * (k - 1)
        if i == REFERENCE:
            new[i], new[i + 1], new[i + 2] = se2_compose(mean[i], mean[i + 1], mean[i + 2], A[0], A[1], A[2])
            x, y, t = se2_between(A[0], A[1], A[2], 0.0, 0.0, 0.0)
            se2_adjoint(x, y, t, M[i : i + 3, i : i + 3])
            for a in range(3):
                M[i + a, r + a] = 1.0
        elif i == r:
            new[i : i + 3] = 0.0
            M[i : i + 3, i : i + 3] = 0.0
        else:
            new[i], new[i + 1], new[i + 2] = se2_between(A[0], A[1], A[2], mean[i], mean[i + 1], mean[i + 2])
            x, y, t = se2_between(new[i], new[i + 1], new[i + 2], 0.0, 0.0, 0.0)
            se2_adjoint(x, y, t, B)
            for a in range(3):
                for b in range(3):
                    M[i + a, r + b] = -B[a, b]
    return new, congruence(M, P), M


@kernel
def compound(mean, P):
    """The base's pose G X in the world; the covariance (10, 10) of its error Ad(X⁻¹) γ + ξ and the body's others."""
    g = REFERENCE
    pose, covariance, A = np.empty(3), np.empty((10, 10)), np.empty((3, 3))
    pose[0], pose[1], pose[2] = se2_compose(mean[g], mean[g + 1], mean[g + 2], mean[0], mean[1], mean[2])
    x, y, t = se2_between(mean[0], mean[1], mean[2], 0.0, 0.0, 0.0)
    se2_adjoint(x, y, t, A)
    half = np.empty((10, 13))  # of the errors after, with the body's before and the reference's
    for b in range(13):
        column = b if b < 10 else g + b - 10
        for a in range(10):
            half[a, b] = P[a, column]
            if a < 3:
                for c in range(3):
                    half[a, b] += A[a, c] * P[g + c, column]
    for a in range(10):
        for b in range(10):
            covariance[a, b] = half[a, b]
            if b < 3:
                for c in range(3):
                    covariance[a, b] += half[a, 10 + c] * A[b, c]
    for a in range(10):
        for b in range(a):
            covariance[a, b] = covariance[b, a] = 0.5 * (covariance[a, b] + covariance[b, a])
    return pose, covariance
