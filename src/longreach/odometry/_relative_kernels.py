"""Compiled covariance of relative poses on SE(2): over one step, and along a chain of them."""

import numpy as np

from longreach.geometry._kernels import se2_adjoint, se2_compose, se2_exp
from longreach.kernels import kernel


@kernel
def _add_carried(x, y, t, weight, Q, A, out):
    """out += weight · Ad Q Adᵀ, Ad of the pose (x, y, t)."""
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
def spread(xi, Q, out):
    """∫₀¹ Ad(exp(-sξ)) Q Ad(exp(-sξ))ᵀ ds by Simpson's rule: exact on a straight line."""
    A = np.empty((3, 3))
    out[:] = 0.0
    for node in range(3):
        s = -0.5 * node
        x, y, t = se2_exp(s * xi[0], s * xi[1], s * xi[2])
        _add_carried(x, y, t, 4.0 / 6.0 if node == 1 else 1.0 / 6.0, Q, A, out)


@kernel
def spread_all(xi, Q, out):
    """`spread` of each row."""
    for n in range(len(xi)):
        spread(xi[n], Q[n], out[n])


@kernel
def chain_all(reference, relative, Q, poses, covariance):
    """Row i from row reference[i] < i and the pose `relative[i]` seen from it; row 0 is given."""
    A = np.empty((3, 3))
    for i in range(1, len(poses)):
        r, d = reference[i], relative[i]
        poses[i, 0], poses[i, 1], poses[i, 2] = se2_compose(poses[r, 0], poses[r, 1], poses[r, 2], d[0], d[1], d[2])
        for j in range(3):
            for k in range(3):
                covariance[i, j, k] = Q[i, j, k]
        x, y, t = se2_compose(0.0, 0.0, -d[2], -d[0], -d[1], 0.0)
        _add_carried(x, y, t, 1.0, covariance[r], A, covariance[i])
