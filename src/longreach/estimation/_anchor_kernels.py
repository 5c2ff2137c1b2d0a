"""Compiled anchors: past poses in the filter's state, placed by cloning the pose and carried along by a counter.

Layout of the mean and of P: see `_kernels`.
"""

import math

import numpy as np

from longreach.estimation._kernels import BODY, SCALE, congruence
from longreach.geometry._kernels import se2_adjoint, se2_between, se2_compose, se2_exp, se2_log, se2_right_jacobian
from longreach.kernels import kernel


@kernel
def carry(mean, P, anchor, pose, Q, led, variance, reach):
    """Move the anchor of that number by a pose (3,) seen from it, stretched by 1 + s, whose error has covariance Q.

    led (3,): axes (1: yes, 0: no) in which the step's error is the error of the present pose as well. s, the counter's
    scale errors, fade over `reach` and stay at the variance (3,) that they have when nothing is known.
    """
    i, n = BODY + 3 * anchor, len(mean)
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
    se2_adjoint(x, y, t, L)  # the anchor's error as the pose's, where both move together
    for a in range(3):
        L[:, a] *= led[a]
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
def clone(mean, P, anchor):
    """Make the anchor of that number (the next one: a new anchor) a copy of the pose, correlations and all."""
    i = BODY + 3 * anchor
    n = max(len(mean), i + 3)
    source = np.arange(n)
    for a in range(3):
        source[i + a] = a
    new, covariance = np.empty(n), np.empty((n, n))
    for a in range(n):
        new[a] = mean[source[a]]
        for b in range(n):
            covariance[a, b] = P[source[a], source[b]]
    return new, covariance
