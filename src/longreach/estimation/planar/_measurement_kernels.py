"""Compiled observation models (3.27b), innovation z - h(mean), Jacobian H and covariance R; noise of sources; slip.

Each model returns r (k,), H (k, n), R (k, k) with the factors of the source's noise on it, of each component whether it
is a translation (0) or a turn (1), and what is at fault. The noise of a source is a row (7,): the logarithms of two
factors, the information about each, and the deviations of x, y and θ (see `noise_adaptation.Noise`).
Layout of the mean: see `_ekf_kernels`.
"""

import math

import numpy as np

from longreach.estimation.planar._ekf_kernels import REFERENCE, cholesky, solve
from longreach.geometry._eigen_kernels import symmetric_eigen
from longreach.geometry._kernels import se2_adjoint, se2_between, se2_compose, se2_exp, se2_log, wrap
from longreach.kernels import kernel

INFORMATION, DEVIATIONS = 2, 4
HIGHEST = math.log(25.0)  # what a stated variance may be too small by
_LOWEST = math.log(0.25)  # and too large by, of wheels
_OUTLIER = 4.0  # an innovation counts at most this many times what it should be on average
# What is known of a slip: rows (7, 3), by axis, and numbers (`noise_adaptation.Slip`).
RATE, VARIANCE, TOGETHER, ALONE, LAST, LAST_BUT_ONE, LEFT = range(7)
_LASTS = 1.0  # [s], time constant of the process: as long as a base takes to start or to stop
_MEMORY = 40.0  # corrections over which products are averaged; a second of a fast scanner
_CHANCE = 0.3  # correlation that may come by chance: two deviations
_FASTEST = 1.0  # [m/s, rad/s]: what is more is a bump
_GAP = 0.5  # [s] between corrections, after which the last has nothing to do with the next
_REGULAR = 0.1  # of the time between corrections, that stamps may be off by: rates over shorter times are noise


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
    """z = v, the body twist."""
    r, H = np.empty(3), np.zeros((3, len(mean)))
    for i in range(3):
        r[i] = z[i] - mean[3 + i]
        H[i, 3 + i] = 1.0
    return _measured(r, H, R.copy(), noise, 2)


@kernel
def observe_pose(mean, z, R, noise):
    """z = G X, its error n in the world's axes: H = blkdiag(R(θ), 1) on the error Ad(X⁻¹) γ + ξ of G X.

    G is the reference's pose. With d = log((G X)⁻¹ · z) known, that is with all three measured, ours is
    R(θ_z) d = R(θ_z) Ad(exp(-d)) (Ad(X⁻¹) γ + ξ) + n: linearised at the measurement, with the error seen from there, so
    that a first fix after a holiday lands on the pose measured however far that is.
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
    """z = K⁻¹ · X · exp(-n): innovation -e with e = log(z⁻¹ · K⁻¹ · X); K, X are the poses at k and `at`.

    H = Ad(exp(e)) on the error of X and -Ad(z⁻¹) on that of K: the derivatives of e at X · exp(-e), where it is 0, with
    the error seen from there. At X they would be J_r⁻¹(e) and -J_r⁻¹(e) Ad(X⁻¹ K); both agree as e goes to 0. This one
    is exact in X, so that steps that were badly predicted still compound as dead reckoning does, mean and covariance.
    And H vanishes on errors Ad(X⁻¹) g, Ad(K⁻¹) g that all poses share, which no relative pose can observe.
    Source: Huang, Mourikis & Roumeliotis 2010, "Observability-based rules for designing consistent EKF SLAM
    estimators".
    """
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
    """Rate ω + bias, then the acceleration v̇ + ω×v + ω̇×p + ω×(ω×p) of the IMU's position p.

    v̇ and ω̇ are from the state, so that ω̇ is a quantity of the filter's own, whatever the rate of the messages.
    """
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


@kernel
def add_parts(R, blocks, parts):
    """Add to parts (2, k, k) the derivatives of D R D over the logarithms of two factors, which `blocks` (k,) names."""
    k = len(R)
    for block in range(2):
        for i in range(k):
            for j in range(k):
                parts[block, i, j] += 0.5 * ((blocks[i] == block) + (blocks[j] == block)) * R[i, j]


@kernel
def step_noise(covariance, noise, pose, Q, A, parts):
    """Fill Q (3, 3), the covariance of a wheels' step with the factors on it, Ad(pose⁻¹), and add Q's parts."""
    x, y, t = se2_between(pose[0], pose[1], pose[2], 0.0, 0.0, 0.0)
    se2_adjoint(x, y, t, A)
    for i in range(3):
        for j in range(3):
            Q[i, j] = covariance[i, j] * (noise[DEVIATIONS + i] * noise[DEVIATIONS + j])
    blocks = np.zeros(3, dtype=np.int64)
    blocks[2] = 1
    add_parts(Q, blocks, parts)


@kernel
def learn(S, r, H, R, blocks, coupled, added, memory, is_wheels, noises):
    """Move the logarithms of noises (m, 7) by the score over the information, both gathered, where S is definite.

    R (k, k): the part of S that is the first noise's, of wheels or not. added (m - 1, 2, 3, 3): parts of the others,
    which are of the wheels' steps, in the pose as far as it is coupled (3,). An innovation with a NIS above _OUTLIER k
    counts as one at it.
    Source: the score and Fisher information of a normal distribution's covariance, Magnus & Neudecker 1988, 15.3.
    """
    k, m = len(r), len(noises)
    parts, inverse_parts = np.zeros((2 * m, k, k)), np.empty((2 * m, k, k))
    L, x, column = np.empty((k, k)), np.empty(k), np.empty(k)
    if not cholesky(S, L):
        return
    add_parts(R, blocks, parts)
    for n in range(m - 1):
        for block in range(2):
            for i in range(k):
                for j in range(k):
                    for a in range(3):
                        for b in range(3):
                            seen = H[i, a] * coupled[a], H[j, b] * coupled[b]
                            parts[2 + 2 * n + block, i, j] += seen[0] * added[n, block, a, b] * seen[1]
    solve(L, r, x)
    nis = np.sum(r * x)
    counted = min(1.0, _OUTLIER * k / nis) if nis > 0.0 else 1.0
    for p in range(2 * m):
        for j in range(k):
            solve(L, parts[p, :, j].copy(), column)
            for i in range(k):
                inverse_parts[p, i, j] = column[i]
    for p in range(2 * m):
        score, information, noise, block = 0.0, 0.0, noises[p // 2], p % 2
        for i in range(k):
            score -= inverse_parts[p, i, i]
            for j in range(k):
                score += counted * x[i] * parts[p, i, j] * x[j]
        for other in range(2 * m):
            shared = 0.0
            for i in range(k):
                for j in range(k):
                    shared += inverse_parts[p, i, j] * inverse_parts[other, j, i]
            information += 0.5 * abs(shared)
        gathered = min(noise[INFORMATION + block] + information, memory)
        lowest = _LOWEST if p > 1 or is_wheels else 0.0
        noise[block] = max(lowest, min(HIGHEST, noise[block] + 0.5 * score / gathered))
        noise[INFORMATION + block] = gathered
        for axis in range(2 * block, 2 + block):  # x, y or θ
            noise[DEVIATIONS + axis] = math.exp(0.5 * noise[block])


@kernel
def own_part(C, pose, shared, least, out):
    """Fill out (3, 3) with C - Ad(pose⁻¹) shared Ad(pose⁻¹)ᵀ, but in every direction at least the part `least` of C.

    In the basis where C is the identity both are diagonal: the generalised eigenvalues w of what is taken off become
    max(1 - w, least). Returns False where C is not positive definite or the pose not finite.
    """
    A, L, V = np.empty((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    if not (cholesky(C, L) and math.isfinite(pose[0] + pose[1] + pose[2])):
        return False
    x, y, t = se2_between(pose[0], pose[1], pose[2], 0.0, 0.0, 0.0)
    se2_adjoint(x, y, t, A)
    for j in range(3):  # A := L⁻¹ A
        for i in range(3):
            for k in range(i):
                A[i, j] -= L[i, k] * A[k, j]
            A[i, j] /= L[i, i]
    W = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for l in range(3):
                    W[i, j] += A[i, k] * shared[k, l] * A[j, l]
    symmetric_eigen(W, V)
    out[:] = 0.0
    for k in range(3):
        part = max(1.0 - W[k, k], least)
        for i in range(3):
            for j in range(3):
                a = b = 0.0
                for l in range(3):
                    a += L[i, l] * V[l, k]
                    b += L[j, l] * V[l, k]
                out[i, j] += part * a * b
    return True


@kernel
def fading(t):
    """What is left of a rate after t [s]."""
    return math.exp(-t / _LASTS)


@kernel
def _lasting(rows, mean, off, i):
    """The variance of the process in axis i: none where corrections are as white as they may be by chance."""
    return 0.0 if off > _REGULAR * mean else max(rows[TOGETHER, i] - _CHANCE * rows[ALONE, i], 0.0)


@kernel
def correct(rows, seen, mean, off, r, before, after, stamp, coupled, out):
    """Take that the pose was off by r (3,) and moved from one pose (3,) to another for that; fills out (7, 3).

    mean, off [s]: time between corrections, and how far off it they are. Returns both as they are now.
    """
    dt = stamp - seen
    fade = fading(dt) if 0.0 < dt < math.inf else 0.0
    moved = se2_log(*se2_between(before[0], before[1], before[2], after[0], after[1], after[2]))
    for i in range(3):
        out[RATE, i], out[LEFT, i], out[LAST, i], out[LAST_BUT_ONE, i] = fade * rows[RATE, i], r[i] - moved[i], 0.0, 0.0
        for row in (VARIANCE, TOGETHER, ALONE):
            out[row, i] = rows[row, i]
    if not 0.0 < dt <= _GAP:
        return mean, off
    mean, off = mean + (dt - mean) / _MEMORY, off + (abs(dt - mean) - off) / _MEMORY
    lasts = False
    for i in range(3):
        rate = min(max(coupled[i] * ((r[i] - rows[LEFT, i]) / dt + out[RATE, i]), -_FASTEST), _FASTEST)
        out[TOGETHER, i] += (rate * rows[LAST_BUT_ONE, i] - rows[TOGETHER, i]) / _MEMORY
        out[ALONE, i] += (rate * rate - rows[ALONE, i]) / _MEMORY
        out[LAST_BUT_ONE, i], out[LAST, i] = rows[LAST, i], rate
        lasts = lasts or _lasting(out, mean, off, i) > 0.0
    for i in range(3):
        lasting, alone, gain = _lasting(out, mean, off, i), out[ALONE, i], 0.0
        variance = fade * fade * rows[VARIANCE, i] + (1.0 - fade * fade) * lasting if lasts else 0.0
        if lasting > 0.0:
            gain = variance / (variance + max(alone - max(out[TOGETHER, i], 0.0), 0.01 * alone))
        out[RATE, i] = out[RATE, i] + gain * (out[LAST, i] - out[RATE, i]) if lasting > 0.0 else 0.0
        out[VARIANCE, i] = (1.0 - gain) * variance
    return mean, off


@kernel
def possible(rows, speed):
    """The part of the rate that a base slips by that drives at a speed [m/s]: one that stands does not."""
    most = math.hypot(rows[RATE, 0], rows[RATE, 1])
    return min(1.0, speed / most) if most > 0.0 else 1.0


@kernel
def way(rows, seen, mean, off, speed, begin, end, xi, variance):
    """Fill ξ (3,), that is slipped from one time to another [s], and its variance (3,), which grows with time."""
    t0, t1, part = max(begin - seen, 0.0), max(end - seen, 0.0), possible(rows, speed)
    for i in range(3):
        xi[i], variance[i] = _LASTS * (fading(t0) - fading(t1)) * (part * rows[RATE, i]), 0.0
        for sign, t in ((1.0, t1), (-1.0, t0)):
            rate = rows[VARIANCE, i] + _lasting(rows, mean, off, i) * min(1.0, 2.0 * t / _LASTS)
            variance[i] += sign * (rate * t * t / (1.0 + 0.5 * t / _LASTS))
