"""Compiled anchors: past poses in the filter's state, placed by cloning the pose and carried along by a counter.

Layout of the mean and of P: see `_kernels`.
"""

import numpy as np

from longreach.estimation._kernels import BODY, congruence
from longreach.geometry._kernels import se2_adjoint, se2_between, se2_compose
from longreach.kernels import kernel


@kernel
def carry(mean, P, anchor, pose, Q, led):
    """Move the anchor of that number by a pose (3,) seen from it, whose error has covariance Q (3, 3).

    led (3,): axes (1: yes, 0: no) in which the step's error is the error of the present pose as well.
    """
    i, n = BODY + 3 * anchor, len(mean)
    moved, T, A = mean.copy(), np.zeros((n, n)), np.empty((3, 3))
    moved[i], moved[i + 1], moved[i + 2] = se2_compose(mean[i], mean[i + 1], mean[i + 2], pose[0], pose[1], pose[2])
    x, y, t = se2_between(pose[0], pose[1], pose[2], 0.0, 0.0, 0.0)
    se2_adjoint(x, y, t, A)
    for a in range(n):
        T[a, a] = 1.0
    T[i : i + 3, i : i + 3] = A
    new = congruence(T, P)
    for a in range(3):
        for b in range(3):
            new[i + a, i + b] += Q[a, b]
            new[a, b] += led[a] * led[b] * Q[a, b]
            new[a, i + b] += led[a] * Q[a, b]
            new[i + a, b] += led[b] * Q[a, b]
    return moved, new


@kernel
def clone(mean, P, anchor):
    """Make the anchor of that number (the next one: a new anchor) a copy of the pose, correlations and all."""
    i = BODY + 3 * anchor
    n = max(len(mean), i + 3)
    source = np.arange(n)
    source[i : i + 3] = np.arange(3)
    new, covariance = np.empty(n), np.empty((n, n))
    for a in range(n):
        new[a] = mean[source[a]]
        for b in range(n):
            covariance[a, b] = P[source[a], source[b]]
    return new, covariance
