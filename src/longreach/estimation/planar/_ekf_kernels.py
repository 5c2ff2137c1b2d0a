"""Compiled extended Kalman filter: Singer motion, gated correction in Joseph form, pose clones and the reference.

Layout of the mean (16 + 3m,): the base's pose x y θ seen from the local reference, body twist, body acceleration, gyro
bias, scale errors of the wheels in x y θ, the pose of the reference in the world; then m pose clones x y θ, seen from
the reference. P has the same layout over the errors; that of a pose is ξ = log(mean⁻¹ · truth).
"""

import math

import numpy as np

from longreach.geometry._kernels import se2_adjoint, se2_between, se2_compose, se2_exp, se2_log, se2_right_jacobian
from longreach.kernels import kernel

BODY = 13  # error states before the poses beside the base's
SCALE = 10  # the first of the wheels' scale errors
BIASES = 9  # of the gyro, then of the wheels
REFERENCE = 13  # its pose


@kernel
def cholesky(S, L):
    for i in range(len(S)):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            elif total > 0.0 and total < np.inf:
                L[i, i] = math.sqrt(total)
            else:
                return False
    return True


@kernel
def solve(L, b, x):
    """L Lᵀ x = b."""
    n = len(b)
    for i in range(n):
        total = b[i]
        for k in range(i):
            total -= L[i, k] * x[k]
        x[i] = total / L[i, i]
    for i in range(n - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, n):
            total -= L[k, i] * x[k]
        x[i] = total / L[i, i]


@kernel
def squared_norm(S, r):
    """rᵀ S⁻¹ r, or 0 where S is not positive definite."""
    L, x = np.empty(S.shape), np.empty(len(r))
    if not cholesky(S, L):
        return 0.0
    solve(L, r, x)
    return np.sum(r * x)


@kernel
def singer(dt, tau):
    """Chain (displacement, v, a) of unit stationary variance over dt: f, g, e of Φ and the six entries of Q.

    Φ = [[1, dt, f], [0, 1, g], [0, 0, e]]. The closed forms cancel for short dt (Q[0, 0] goes as dt⁵), hence series.
    """
    u = dt / tau
    e, g = math.exp(-u), -math.expm1(-u)
    s33 = -0.5 * math.expm1(-2.0 * u)
    if u < 1.0:
        f, s11, s13, s22 = 0.0, 0.0, 0.0, 0.0
        term, two = -u, 2.0  # (-u)^k / k! and 2^k
        for k in range(2, 25):
            term *= -u / k
            two *= 2.0
            part = term * u / (k + 1)
            f += term
            s22 += part * (two - 2.0)
            s13 += part * (two - k - 1.0)
            if k > 3:
                s11 += part * (two - 2.0 * k - 2.0)
    else:
        f = u - g
        s22 = u - 2.0 * g + s33
        s13 = f * g - s22
        s11 = s33 + u + u * u * u / 3.0 - u * u - 2.0 * u * e
    t2 = tau * tau
    q = (2.0 * t2 * t2 * s11, t2 * tau * f * f, 2.0 * t2 * s13, 2.0 * t2 * s22, tau * g * g, 2.0 * s33)
    return t2 * f, tau * g, e, q


@kernel
def transition(mean, dt, tau, variances, bias_walk, F, Q):
    """Motion model (3.27a): the mean after dt; fills F (n, n) and Q (n, n)."""
    f, g, e, q = singer(dt, tau)
    d0, d1, d2 = dt * mean[3] + f * mean[6], dt * mean[4] + f * mean[7], dt * mean[5] + f * mean[8]
    J, A = np.empty((3, 3)), np.empty((3, 3))
    se2_right_jacobian(d0, d1, d2, J)
    x, y, t = se2_exp(-d0, -d1, -d2)
    se2_adjoint(x, y, t, A)
    F[:] = 0.0
    Q[:] = 0.0
    for i in range(9, len(mean)):
        F[i, i] = 1.0
    for i in range(3):
        for k in range(3):
            F[i, k], F[i, 3 + k], F[i, 6 + k] = A[i, k], dt * J[i, k], f * J[i, k]
            Q[i, 3 + k] = Q[3 + k, i] = J[i, k] * q[1] * variances[k]
            Q[i, 6 + k] = Q[6 + k, i] = J[i, k] * q[2] * variances[k]
            for l in range(3):
                Q[i, k] += J[i, l] * J[k, l] * q[0] * variances[l]
        F[3 + i, 3 + i], F[3 + i, 6 + i], F[6 + i, 6 + i] = 1.0, g, e
        Q[3 + i, 3 + i], Q[6 + i, 6 + i] = q[3] * variances[i], q[5] * variances[i]
        Q[3 + i, 6 + i] = Q[6 + i, 3 + i] = q[4] * variances[i]
    Q[9, 9] = bias_walk * dt
    new = mean.copy()
    x, y, t = se2_exp(d0, d1, d2)
    new[0], new[1], new[2] = se2_compose(mean[0], mean[1], mean[2], x, y, t)
    for i in range(3):
        new[3 + i] = mean[3 + i] + g * mean[6 + i]
        new[6 + i] = e * mean[6 + i]
    return new


@kernel
def _multiply(M, B, out):
    """M B, quick where M is mostly zeros."""
    n = len(M)
    out[:] = 0.0
    for i in range(n):
        for k in range(n):
            m = M[i, k]
            if m != 0.0:
                for j in range(n):
                    out[i, j] += m * B[k, j]


@kernel
def congruence(M, P):
    """M P Mᵀ, exactly symmetric."""
    n = len(M)
    half, out = np.empty((n, n)), np.empty((n, n))
    _multiply(M, P, half)
    _multiply(M, half.T.copy(), out)
    for i in range(n):
        for j in range(i):
            out[i, j] = out[j, i] = 0.5 * (out[i, j] + out[j, i])
    return out


@kernel
def predict(mean, P, dt, tau, variances, bias_walk, stamp_variance):
    """A stamp off by ε moves the pose by vε: E[v vᵀ] · stamp_variance adds to what the pose may be off."""
    n = len(mean)
    F, Q = np.empty((n, n)), np.empty((n, n))
    new = transition(mean, dt, tau, variances, bias_walk, F, Q)  # (3.28a)
    for i in range(3):
        for j in range(3):
            Q[i, j] += stamp_variance * (mean[3 + i] * mean[3 + j] + P[3 + i, 3 + j])
    return new, congruence(F, P) + Q  # (3.28b)


@kernel
def _inflation(A, R, r, gate, L):
    """Scale s of R at which the NIS rᵀ (A + s R)⁻¹ r falls to the gate, L the factor there; 0 where there is none.

    1/NIS is concave and grows with s, so Newton's method from s = 1 climbs to the root without overshooting it.
    """
    x = np.empty(len(r))
    s = 1.0
    for _ in range(60):
        if not cholesky(A + s * R, L):
            return 0.0
        solve(L, r, x)
        nis = np.sum(r * x)
        if nis <= gate * (1.0 + 1e-9):
            return s
        slope = 0.0
        for i in range(len(r)):
            for j in range(len(r)):
                slope += x[i] * R[i, j] * x[j]
        if not slope > 0.0:
            return 0.0
        s += (nis * nis / gate - nis) / slope
    return 0.0


@kernel
def _retract_pose(i, dx, mean, G):
    """Move the pose at i of the mean; its error, seen from there, is Ad(exp(-dx)) times what is left of the old one.

    J_r(dx) would be as good to first order, but then a common motion of all poses, which relative poses do not observe,
    would seem to be observed by them.
    """
    x, y, t = se2_exp(dx[i], dx[i + 1], dx[i + 2])
    mean[i], mean[i + 1], mean[i + 2] = se2_compose(mean[i], mean[i + 1], mean[i + 2], x, y, t)
    x, y, t = se2_exp(-dx[i], -dx[i + 1], -dx[i + 2])
    se2_adjoint(x, y, t, G[i : i + 3, i : i + 3])


@kernel
def retract(mean, dx, G):
    """Move by an error state; fills G (n, n), from the errors about the old mean to those about the new."""
    n = len(mean)
    G[:] = 0.0
    for i in range(n):
        G[i, i] = 1.0
    out = mean.copy()
    _retract_pose(0, dx, out, G)
    for i in range(3, BODY):
        out[i] += dx[i]
    for i in range(BODY, n, 3):
        _retract_pose(i, dx, out, G)
    return out


@kernel
def _is_finite(mean, P):
    total = 0.0
    for i in range(len(mean)):
        total += 0.0 * mean[i]
        for j in range(len(mean)):
            total += 0.0 * P[i, j]
    return total == 0.0


@kernel
def _innovation_parts(P, H):
    """P Hᵀ (n, k) and H P Hᵀ (k, k), quick where H is mostly zeros."""
    k, n = H.shape
    PHt, A = np.zeros((n, k)), np.zeros((k, k))
    for b in range(k):
        for j in range(n):
            h = H[b, j]
            if h != 0.0:
                for i in range(n):
                    PHt[i, b] += P[i, j] * h
    for a in range(k):
        for b in range(k):
            for j in range(n):
                A[a, b] += 0.5 * (H[a, j] * PHt[j, b] + H[b, j] * PHt[j, a])
    return PHt, A


@kernel
def _joseph(P, K, H, R, scale):
    """(I - K H) P (I - K H)ᵀ + K (scale R) Kᵀ."""
    n, k = K.shape
    M = np.zeros((n, n))
    for i in range(n):
        M[i, i] = 1.0
        for a in range(k):
            for j in range(n):
                M[i, j] -= K[i, a] * H[a, j]
    new = congruence(M, P)
    for a in range(k):
        for b in range(k):
            noise = 0.5 * scale * (R[a, b] + R[b, a])
            if noise != 0.0:
                for i in range(n):
                    for j in range(n):
                        new[i, j] += K[i, a] * noise * K[j, b]
    return new


@kernel
def _restrict(mean, K, gain):
    """Leave the gain K (n, k) to what a measurement may correct.

    1, of the local state: all but the reference's pose G. 2, of a fix: the biases of the sensors, and G, by as much as
    moves the base's pose G X as the gains of G and X would: K_G + Ad(X) K_X, for the error of G X is Ad(X⁻¹) γ + ξ.
    """
    k, g = K.shape[1], REFERENCE
    if gain == 1:
        K[g : g + 3] = 0.0
    elif gain == 2:
        A = np.empty((3, 3))
        se2_adjoint(mean[0], mean[1], mean[2], A)
        for a in range(3):
            for b in range(k):
                for c in range(3):
                    K[g + a, b] += A[a, c] * K[c, b]
        K[:BIASES] = 0.0
        K[g + 3 :] = 0.0


@kernel
def correct(mean, P, r, H, R, gate, inflate, gain):
    """Take one innovation r (k,): the new mean, the new P, NIS, the scale put on R (0: not taken) and S = H P Hᵀ + R.

    gain: what is corrected, 0: all, 1 and 2: see `_restrict`; the rest is considered in P (Schmidt).
    NIS is infinite where its covariance is not positive definite or the result would not be finite.
    Source: Schmidt 1966, "Application of state-space methods to navigation problems".
    """
    n, k = len(mean), len(r)
    PHt, A = _innovation_parts(P, H)
    S, L, x = A + R, np.zeros((k, k)), np.empty(k)
    if not cholesky(S, L):
        return mean.copy(), P.copy(), np.inf, 0.0, S
    solve(L, r, x)
    nis, scale = np.sum(r * x), 1.0
    if nis > gate:
        scale = _inflation(A, R, r, gate, L) if inflate else 0.0
        if scale == 0.0:
            return mean.copy(), P.copy(), nis, 0.0, S
    K, G, dx = np.empty((n, k)), np.empty((n, n)), np.zeros(n)
    for i in range(n):  # (3.29c)
        solve(L, PHt[i], K[i])
    _restrict(mean, K, gain)
    for i in range(n):
        for a in range(k):
            dx[i] += K[i, a] * r[a]
    moved = retract(mean, dx, G)  # (3.29a)
    new = congruence(G, _joseph(P, K, H, R, scale))  # (3.29b)
    if not _is_finite(moved, new):
        return mean.copy(), P.copy(), np.inf, 0.0, S
    return moved, new, nis, scale, S


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
