"""Compiled observation models (3.27b): innovation z - h(mean), Jacobian H over the errors, covariance R.

They write into the arrays z and R that they are given. Layout of the mean: see `_kernels`.
"""

import math

import numpy as np

from longreach.estimation._kernels import REFERENCE
from longreach.geometry._kernels import se2_adjoint, se2_between, se2_compose, se2_exp, se2_log, wrap
from longreach.kernels import kernel


@kernel
def _select_rows(r, H, R):
    """Leave out the rows of infinite variance."""
    k = len(r)
    rows = np.empty(k, dtype=np.int64)
    m = 0
    for i in range(k):
        if R[i, i] != np.inf:
            rows[m] = i
            m += 1
    if m == k:
        return r, H, R
    r2, H2, R2 = np.empty(m), np.empty((m, H.shape[1])), np.empty((m, m))
    for i in range(m):
        r2[i] = r[rows[i]]
        for j in range(H.shape[1]):
            H2[i, j] = H[rows[i], j]
        for j in range(m):
            R2[i, j] = R[rows[i], rows[j]]
    return r2, H2, R2


@kernel
def observe_twist(mean, z, R):
    H = np.zeros((3, len(mean)))
    for i in range(3):
        z[i] -= mean[3 + i]
        H[i, 3 + i] = 1.0
    return _select_rows(z, H, R)


@kernel
def observe_pose(mean, z, R):
    """Innovation z - G X in the world's axes, G the reference's pose.

    With the heading measured, linearised where it vanishes: at G X · exp(d).
    """
    H, A, B, g = np.zeros((3, len(mean))), np.empty((3, 3)), np.zeros((3, 3)), REFERENCE
    x, y, t = se2_compose(mean[g], mean[g + 1], mean[g + 2], mean[0], mean[1], mean[2])
    whole = R[0, 0] != np.inf and R[1, 1] != np.inf and R[2, 2] != np.inf
    if whole:
        c, s = math.cos(z[2]), math.sin(z[2])
        x, y, t = se2_between(x, y, t, z[0], z[1], z[2])
        d0, d1, d2 = se2_log(x, y, t)
        x, y, t = se2_exp(-d0, -d1, -d2)
        se2_adjoint(x, y, t, B)
        for j in range(3):
            B[0, j], B[1, j] = c * B[0, j] - s * B[1, j], s * B[0, j] + c * B[1, j]
        z[0], z[1], z[2] = c * d0 - s * d1, s * d0 + c * d1, d2
    else:
        c, s = math.cos(t), math.sin(t)
        B[0, 0], B[0, 1], B[1, 0], B[1, 1], B[2, 2] = c, -s, s, c, 1.0
        z[0] -= x
        z[1] -= y
        z[2] = wrap(z[2] - t)
    x, y, t = se2_between(mean[0], mean[1], mean[2], 0.0, 0.0, 0.0)
    se2_adjoint(x, y, t, A)
    for i in range(3):
        for j in range(3):
            H[i, j] = B[i, j]
            for l in range(3):
                H[i, g + j] += B[i, l] * A[l, j]
    if whole:
        return z, H, R
    return _select_rows(z, H, R)


@kernel
def observe_relative_pose(mean, z, R, k, at):
    """Innovation -e, e = log(z⁻¹ · K⁻¹ · X), K, X the poses at k and `at`, linearised where it is 0: at X · exp(-e)."""
    x, y, t = se2_between(mean[k], mean[k + 1], mean[k + 2], mean[at], mean[at + 1], mean[at + 2])
    if R[2, 2] == np.inf:
        z[2] = t
    e0, e1, e2 = se2_between(z[0], z[1], z[2], x, y, t)
    e0, e1, e2 = se2_log(e0, e1, e2)
    H = np.zeros((3, len(mean)))
    x, y, t = se2_exp(e0, e1, e2)
    se2_adjoint(x, y, t, H[:, at : at + 3])
    x, y, t = se2_between(z[0], z[1], z[2], 0.0, 0.0, 0.0)
    se2_adjoint(x, y, t, H[:, k : k + 3])
    for i in range(3):
        for j in range(k, k + 3):
            H[i, j] = -H[i, j]
    z[0], z[1], z[2] = -e0, -e1, -e2
    return _select_rows(z, H, R)


@kernel
def observe_imu(mean, z, R, px, py):
    """Rate, then the acceleration v̇ + ω×v + ω̇×p + ω×(ω×p) of the point p."""
    vx, vy, w, ax, ay, alpha, bias = mean[3], mean[4], mean[5], mean[6], mean[7], mean[8], mean[9]
    H = np.zeros((3, len(mean)))
    H[0, 5] = H[0, 9] = H[1, 6] = H[2, 7] = 1.0
    H[1, 4], H[1, 5], H[1, 8] = -w, -vy - 2.0 * w * px, -py
    H[2, 3], H[2, 5], H[2, 8] = w, vx - 2.0 * w * py, px
    z[0] -= w + bias
    z[1] -= ax - w * vy - alpha * py - w * w * px
    z[2] -= ay + w * vx + alpha * px - w * w * py
    return _select_rows(z, H, R)


@kernel
def fault(r, R):
    """0: usable, 1: not finite or absurdly large, 2: R is not a covariance, 3: nothing measured."""
    k = len(r)
    if k == 0:
        return 3
    for i in range(k):
        if not abs(r[i]) < 1e9:
            return 1
        for j in range(k):
            if not math.isfinite(R[i, j]):
                return 1
    for i in range(k):  # every principal minor, of the correlations where they exist, is nonnegative
        if R[i, i] < 0.0:
            return 2
        for j in range(i):
            size = math.sqrt(R[i, i]) * math.sqrt(R[j, j])
            if abs(R[i, j] - R[j, i]) > 1e-6 * size or abs(R[i, j]) > (1.0 + 1e-9) * size:
                return 2
    if k == 3 and R[0, 0] > 0.0 and R[1, 1] > 0.0 and R[2, 2] > 0.0:
        d0, d1, d2 = math.sqrt(R[0, 0]), math.sqrt(R[1, 1]), math.sqrt(R[2, 2])
        a, b, c = R[1, 0] / d1 / d0, R[2, 0] / d2 / d0, R[2, 1] / d2 / d1
        if 1.0 + 2.0 * a * b * c - a * a - b * b - c * c < -1e-9:
            return 2
    return 0
