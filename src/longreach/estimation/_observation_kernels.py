"""Compiled observation models (3.27b): innovation z - h(mean), Jacobian H over the errors, covariance R.

Each returns r (k,), H (k, n), R (k, k) with the factors of the source's noise on it, of each component whether it is a
translation (0) or a turn (1), and what is at fault. Layout of the mean: see `_kernels`; of the noise: `_noise_kernels`.
"""

import math

import numpy as np

from longreach.estimation._kernels import REFERENCE
from longreach.estimation._noise_kernels import DEVIATIONS
from longreach.geometry._kernels import se2_adjoint, se2_between, se2_compose, se2_exp, se2_log, wrap
from longreach.kernels import kernel


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


@kernel
def _measured(r, H, R, noise, turn):
    """Leave out the rows of infinite variance; turn: the row that is a turn."""
    rows, m = np.empty(len(r), dtype=np.int64), 0
    for i in range(len(r)):
        if R[i, i] != np.inf:
            rows[m] = i
            m += 1
    r2, H2, R2, blocks = np.empty(m), np.empty((m, H.shape[1])), np.empty((m, m)), np.empty(m, dtype=np.int64)
    for i in range(m):
        r2[i], blocks[i] = r[rows[i]], rows[i] == turn
        for j in range(H.shape[1]):
            H2[i, j] = H[rows[i], j]
        for j in range(m):
            R2[i, j] = R[rows[i], rows[j]]
    at_fault = fault(r2, R2)
    for i in range(m):
        for j in range(m):
            R2[i, j] *= noise[DEVIATIONS + 2 * blocks[i]] * noise[DEVIATIONS + 2 * blocks[j]]
    return r2, H2, R2, blocks, at_fault


@kernel
def observe_twist(mean, z, R, noise):
    r, H = np.empty(3), np.zeros((3, len(mean)))
    for i in range(3):
        r[i] = z[i] - mean[3 + i]
        H[i, 3 + i] = 1.0
    return _measured(r, H, R.copy(), noise, 2)


@kernel
def observe_pose(mean, z, R, noise):
    """Innovation z - G X in the world's axes, G the reference's pose.

    With the heading measured, linearised where it vanishes: at G X · exp(d).
    """
    r, H, A, B, g = np.empty(3), np.zeros((3, len(mean))), np.empty((3, 3)), np.zeros((3, 3)), REFERENCE
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
        r[0], r[1], r[2] = c * d0 - s * d1, s * d0 + c * d1, d2
    else:
        c, s = math.cos(t), math.sin(t)
        B[0, 0], B[0, 1], B[1, 0], B[1, 1], B[2, 2] = c, -s, s, c, 1.0
        r[0], r[1], r[2] = z[0] - x, z[1] - y, wrap(z[2] - t)
    x, y, t = se2_between(mean[0], mean[1], mean[2], 0.0, 0.0, 0.0)
    se2_adjoint(x, y, t, A)
    for i in range(3):
        for j in range(3):
            H[i, j] = B[i, j]
            for l in range(3):
                H[i, g + j] += B[i, l] * A[l, j]
    return _measured(r, H, R.copy(), noise, 2)


@kernel
def observe_relative_pose(mean, z, R, noise, k, at):
    """Innovation -e, e = log(z⁻¹ · K⁻¹ · X), K, X the poses at k and `at`, linearised where it is 0: at X · exp(-e)."""
    x, y, t = se2_between(mean[k], mean[k + 1], mean[k + 2], mean[at], mean[at + 1], mean[at + 2])
    turn = t if R[2, 2] == np.inf else z[2]
    e0, e1, e2 = se2_between(z[0], z[1], turn, x, y, t)
    e0, e1, e2 = se2_log(e0, e1, e2)
    r, H = np.empty(3), np.zeros((3, len(mean)))
    x, y, t = se2_exp(e0, e1, e2)
    se2_adjoint(x, y, t, H[:, at : at + 3])
    x, y, t = se2_between(z[0], z[1], turn, 0.0, 0.0, 0.0)
    se2_adjoint(x, y, t, H[:, k : k + 3])
    for i in range(3):
        for j in range(k, k + 3):
            H[i, j] = -H[i, j]
    r[0], r[1], r[2] = -e0, -e1, -e2
    return _measured(r, H, R.copy(), noise, 2)


@kernel
def observe_imu(mean, rate, variance, acceleration, covariance, position, noise):
    """Rate, then the acceleration v̇ + ω×v + ω̇×p + ω×(ω×p) of the point p."""
    vx, vy, w, ax, ay, alpha, bias = mean[3], mean[4], mean[5], mean[6], mean[7], mean[8], mean[9]
    px, py = position[0], position[1]
    r, H, R = np.empty(3), np.zeros((3, len(mean))), np.zeros((3, 3))
    R[0, 0] = variance
    for i in range(2):
        for j in range(2):
            R[1 + i, 1 + j] = covariance[i, j]
    H[0, 5] = H[0, 9] = H[1, 6] = H[2, 7] = 1.0
    H[1, 4], H[1, 5], H[1, 8] = -w, -vy - 2.0 * w * px, -py
    H[2, 3], H[2, 5], H[2, 8] = w, vx - 2.0 * w * py, px
    r[0] = rate - (w + bias)
    r[1] = acceleration[0] - (ax - w * vy - alpha * py - w * w * px)
    r[2] = acceleration[1] - (ay + w * vx + alpha * px - w * w * py)
    return _measured(r, H, R, noise, 0)
