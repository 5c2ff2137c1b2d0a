"""Kernels of manipulability: singular values by one-sided Jacobi, gradients in one pass over the columns."""

import numpy as np

from longreach.kernels import kernel

_SWEEPS = 30
# Of two rows, the cosine between them, squared: what a sweep of turns leaves of it is its square.
_NEARLY, _ORTHOGONAL = 1e-16, 1e-30
_SINGULAR = 1e-12  # smaller singular values count as this much of the largest, so that nothing becomes infinite


@kernel(fastmath={"contract"})
def turn(B, p, r, m):
    """Make rows p and r of B orthogonal over their first m columns; return whether they were nearly so before."""
    a, b, c = 0.0, 0.0, 0.0
    for i in range(m):
        a += B[p, i] * B[p, i]
        b += B[r, i] * B[r, i]
        c += B[p, i] * B[r, i]
    if c * c <= _ORTHOGONAL * a * b:
        return True
    h = 0.5 * (b - a) / c
    t = (1.0 if h >= 0 else -1.0) / (abs(h) + np.sqrt(1.0 + h * h))
    cosine = 1.0 / np.sqrt(1.0 + t * t)
    sine = t * cosine
    for i in range(B.shape[1]):
        x, y = B[p, i], B[r, i]
        B[p, i] = cosine * x - sine * y
        B[r, i] = sine * x + cosine * y
    return c * c <= _NEARLY * a * b


@kernel
def singular_values(J, first, scale, B, sigma):
    """Fill B (6, m + 6) with [ΣVᵀ | Uᵀ] and sigma (6,) with the singular values, in no order.

    They are those of A = UΣVᵀ (6, m): the columns of J from `first` on, the three linear rows divided by `scale`.
    Rows of [A | 1] are turned in pairs until those of A are orthogonal. Source: Hestenes 1958, one-sided Jacobi.
    """
    m = J.shape[1] - first
    for p in range(6):
        for i in range(m):
            B[p, i] = J[p, first + i] / scale if p < 3 else J[p, first + i]
        for i in range(6):
            B[p, m + i] = 1.0 if i == p else 0.0
    for _ in range(_SWEEPS):
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
        sigma[p] = np.sqrt(total)


@kernel(fastmath={"contract"})
def contract(J, first, scale, B, c, b, gradient):
    """Fill gradient (n,) with Σ_i W_i · ∂A_i/∂q_j, W = Σ_p c_p u_p (σv)_pᵀ; b (n, 3) is room to work in.

    ∂A_i/∂q_j is a pair of cross products (see `hessian`). So the sum is ω_j times one over the columns i ≥ j, plus v_j
    times one over those before j: no Hessian is made.
    """
    n, m = J.shape[1], J.shape[1] - first
    ax, ay, az = 0.0, 0.0, 0.0
    for j in range(n - 1, -1, -1):
        vx, vy, vz, ox, oy, oz = J[0, j], J[1, j], J[2, j], J[3, j], J[4, j], J[5, j]
        if j >= first:
            w0, w1, w2, w3, w4, w5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for p in range(6):
                x = c[p] * B[p, j - first]
                w0 += x * B[p, m]
                w1 += x * B[p, m + 1]
                w2 += x * B[p, m + 2]
                w3 += x * B[p, m + 3]
                w4 += x * B[p, m + 4]
                w5 += x * B[p, m + 5]
            w0, w1, w2 = w0 / scale, w1 / scale, w2 / scale
            ax += vy * w2 - vz * w1 + oy * w5 - oz * w4
            ay += vz * w0 - vx * w2 + oz * w3 - ox * w5
            az += vx * w1 - vy * w0 + ox * w4 - oy * w3
            b[j, 0], b[j, 1], b[j, 2] = w1 * oz - w2 * oy, w2 * ox - w0 * oz, w0 * oy - w1 * ox
        gradient[j] = ox * ax + oy * ay + oz * az
    bx, by, bz = 0.0, 0.0, 0.0
    for j in range(first, n):
        gradient[j] += J[0, j] * bx + J[1, j] * by + J[2, j] * bz
        bx, by, bz = bx + b[j, 0], by + b[j, 1], bz + b[j, 2]


@kernel
def log_measures(J, first, scale, values, gradients):
    """Fill values (2,) with log M and log κ, and gradients (2, n) with theirs; (4.31) and (4.32), corrected.

    M = Πσ and κ = σ_max/σ_min, so ∂ log M = Σ ∂σ_p/σ_p and ∂ log κ = ∂σ_max/σ_max - ∂σ_min/σ_min, with
    ∂σ_p = u_pᵀ ∂A v_p. All other measures are functions of these two.
    """
    n = J.shape[1]
    B, sigma = np.empty((6, n - first + 6)), np.empty(6)
    singular_values(J, first, scale, B, sigma)
    c, room = np.empty(6), np.empty((n, 3))
    high, low, product = 0, 0, 1.0
    for p in range(6):
        high = p if sigma[p] > sigma[high] else high
        low = p if sigma[p] < sigma[low] else low
    floor = max(_SINGULAR * sigma[high], 1e-300)
    for p in range(6):
        s = max(sigma[p], floor)
        product *= s
        c[p] = 1.0 / (s * s)
    values[0] = np.log(product)
    values[1] = np.log(sigma[high] / max(sigma[low], floor))
    contract(J, first, scale, B, c, room, gradients[0])
    for p in range(6):
        if p != high and p != low:
            c[p] = 0.0
    c[low] = -c[low]
    contract(J, first, scale, B, c, room, gradients[1])


@kernel
def log_measures_batch(J, first, scale, values, gradients):
    """Fill values (m, 2) and gradients (m, 2, n) for J (m, 6, n)."""
    for i in range(J.shape[0]):
        log_measures(J[i], first, scale, values[i], gradients[i])
