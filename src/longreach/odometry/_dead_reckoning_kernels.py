"""Compiled composition of relative poses on SE(2), with the covariance of the result."""

import numpy as np

from longreach.geometry._kernels import se2_adjoint, se2_compose
from longreach.kernels import kernel


@kernel
def add_transformed(x, y, t, weight, Q, A, out):
    """out += weight · Ad Q Adᵀ, Ad the adjoint of the pose (x, y, t); A (3, 3) is work space."""
    se2_adjoint(x, y, t, A)
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for k in range(3):
                for l in range(3):
                    total += A[i, k] * Q[k, l] * A[j, l]
            out[i, j] += weight * total
            if i != j:
                out[j, i] = out[i, j]


@kernel
def integrate_all(reference, relative, Q, poses, covariance):
    """Row i from row reference[i] < i and the pose `relative[i]` seen from it; row 0 is given."""
    A = np.empty((3, 3))
    for i in range(1, len(poses)):
        r, d = reference[i], relative[i]
        poses[i, 0], poses[i, 1], poses[i, 2] = se2_compose(poses[r, 0], poses[r, 1], poses[r, 2], d[0], d[1], d[2])
        for j in range(3):
            for k in range(3):
                covariance[i, j, k] = Q[i, j, k]
        x, y, t = se2_compose(0.0, 0.0, -d[2], -d[0], -d[1], 0.0)
        add_transformed(x, y, t, 1.0, covariance[r], A, covariance[i])
