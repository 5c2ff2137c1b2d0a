"""Compiled symmetric range flow: a scan against the last one, a keyscan, or both, from what their ranges differ.

Source: Jaimez, Monroy, Lopez-Antequera & Gonzalez-Jimenez 2018, "Robust planar odometry based on symmetric range flow
and multiscan alignment". Ranges are metres, 0 is null; loops over beams run with fastmath, so nothing infinite or NaN
may enter.
"""

import math
from collections import namedtuple

import numpy as np

from longreach.geometry._kernels import se2_adjoint, se2_between, se2_compose, se2_exp, se2_log
from longreach.kernels import kernel
from longreach.odometry._flow_solution_kernels import flow_covariance, normal_equations, truncated_flow
from longreach.odometry._pyramid_kernels import _atan_ratio
from longreach.odometry._range_flow_kernels import mean_scan
from longreach.odometry._rank_kernels import smallest

SymmetricSettings = namedtuple("SymmetricSettings", "iterations linearisations settled lags known common agree")
_WIDEST = 8.0  # beams between two neighbouring points that still are one surface
_UNSEEN = 1.4  # of the variance, with what residuals do not show: measured on made scans, 1.3 to 1.6
_TWICE = 1.5  # where two scans are matched to: the new scan's noise is in both pairs
_LEAST = 1e-3  # [m] scale of the residuals; scans without noise are wrong by something, too
_SLOPE = 0.075  # variance of a slope over that of R_t, after smoothing twice with [1 4 6 4 1]


@kernel(fastmath=True)
def warp_segments(r, cos, sin, increment, x, y, theta, farthest, warped, space):
    """Carry a scan by (x, y, θ): each beam between two neighbouring points sees the line through both.

    Of several the nearest is seen, or the farthest: where a scan goes to a place from which less is hidden.
    space (2, n).
    """
    n = len(r)
    ct, st = math.cos(theta), math.sin(theta)
    for u in range(n):
        warped[u] = 0.0
        space[0, u] = -1e9
        if r[u] > 0.0:
            px, py = r[u] * cos[u], r[u] * sin[u]
            qx, qy = ct * px - st * py + x, st * px + ct * py + y
            space[0, u] = u + _atan_ratio(cos[u] * qy - sin[u] * qx, cos[u] * qx + sin[u] * qy) / increment
            space[1, u] = 1.0 / math.sqrt(qx * qx + qy * qy + 1e-12)
    for u in range(n - 1):
        a, b = space[0, u], space[0, u + 1]
        if a < -1.0 or b <= a or b - a > _WIDEST:
            continue
        for v in range(max(math.ceil(a), 0), min(math.floor(b), n - 1) + 1):
            part = (v - a) / (b - a)
            distance = 1.0 / ((1.0 - part) * space[1, u] + part * space[1, u + 1])  # 1/r of a line is nearly linear
            if warped[v] == 0.0 or (distance > warped[v]) == farthest:
                warped[v] = distance


@kernel(fastmath=True)
def symmetric_rows(old, warped, mean, slope, cos, sin, increment, reach, m, A, b):
    """Add the weighted rows A (6, m), b (m,) of ρ = b + Aᵀ ξ, and return how many there are then. (3.24)

    ξ: motion of the sensor in the frame of `old`, θ times reach [m]. Derivatives are those of the mean of both scans,
    which is right to second order. The weight falls with the derivatives and with their change, where the linearisation
    is poor.
    Rows 3 to 5 are what an error of the slope R_α adds to rows 0 to 2.
    """
    n = len(old)
    k = 1.0 / increment
    first, largest = m, 0.0
    for u in range(1, n - 1):
        if mean[u] <= 0.0 or (mean[u - 1] <= 0.0 and mean[u + 1] <= 0.0):
            continue
        R_t, R_a = warped[u] - old[u], slope[u]
        change = 0.0
        if mean[u - 1] > 0.0 and mean[u + 1] > 0.0:
            change = slope[u + 1] - slope[u - 1]
        w = 1.0 / math.sqrt(0.01 * (R_t * R_t + R_a * R_a) + 2e-4 * change * change + 4e-4)
        A[3, m] = w * k / mean[u] * sin[u]
        A[4, m] = -w * k / mean[u] * cos[u]
        A[5, m] = -w * k / reach
        A[0, m] = w * cos[u] + A[3, m] * R_a
        A[1, m] = w * sin[u] + A[4, m] * R_a
        A[2, m] = A[5, m] * R_a
        b[m] = w * R_t
        largest = max(largest, w)
        m += 1
    for i in range(first, m):
        for j in range(6):
            A[j, i] /= largest
        b[i] /= largest
    return m


@kernel(fastmath=True)
def find_observable(A, m, increment, reach, variance, known, H, V, observable):
    """Fill observable (3,) with 1 or 0: whether the data determine each direction of the eigenbasis V of H.

    Noise of the slopes looks like information about motion along a wall: a direction is observable where H is more than
    `known` times what it would be from that alone. variance: of a weighted residual.
    """
    largest = max(H[0, 0], max(H[1, 1], H[2, 2]))
    weights = 0.0
    for i in range(m):
        weights += A[5, i] * A[5, i]
    weights *= (increment * reach) ** 2  # of the rows
    noise = _SLOPE * variance * m / max(weights, 1e-300)  # of a slope
    for j in range(3):
        errors = 0.0
        for i in range(m):
            along = A[3, i] * V[0, j] + A[4, i] * V[1, j] + A[5, i] * V[2, j]
            errors += along * along
        observable[j] = 1.0 if H[j, j] > known * errors * noise + 1e-5 * largest else 0.0


@kernel
def pulled(xi, pose, guess, sigma, reach, variance, H, V, observable):
    """Draw ξ to the guess: wholly along what is not observable, by information elsewhere. sigma (3,): its deviation."""
    ix, iy, it = se2_between(pose[0], pose[1], pose[2], 0.0, 0.0, 0.0)
    ox, oy, ot = se2_log(*se2_compose(guess[0], guess[1], guess[2], ix, iy, it))
    off, found = (ox, oy, ot * reach), xi.copy()
    xi[:] = 0.0
    for k in range(3):
        weight = along = prior = 0.0
        for i in range(3):
            deviation = sigma[i] * (reach if i == 2 else 1.0)
            weight += V[i, k] * V[i, k] * variance / (deviation * deviation)
            along += V[i, k] * found[i]
            prior += V[i, k] * off[i]
        share = H[k, k] / (H[k, k] + weight) if observable[k] > 0.0 else 0.0
        for i in range(3):
            xi[i] += V[i, k] * (share * along + (1.0 - share) * prior)


@kernel
def add_pair(old, warped, cos, sin, increment, reach, work, m, A, b):
    """Add the rows of one pair of scans."""
    mean_scan(old, warped, cos, sin, work[0], work[1], work[2])
    return symmetric_rows(old, warped, work[0], work[2], cos, sin, increment, reach, m, A, b)


@kernel
def match_level(
    key, last, new, between, with_last, cos, sin, increment, reach, guess, sigma, s, pose, work, A, b, H, V, observable
):
    """Move pose (3,), of the new scan seen from the last one, by the flow of one level of the pyramids.

    key, last, new (n,): ranges. between (3,): pose of the keyscan seen from the last scan. with_last: the last scan
    takes part. Returns the rows, those of the last scan among them, the residuals' variance and k of their weights.
    """
    n = len(new)
    space, carried, warped, rest = work[:2, :n], work[2, :n], work[3, :n], work[4:, :n]
    xi = np.empty(3)
    m, of_last, variance, k = 0, 0, 0.0, 0.0
    warp_segments(key, cos, sin, increment, between[0], between[1], between[2], True, carried, space)
    for _ in range(s.linearisations):
        warp_segments(new, cos, sin, increment, pose[0], pose[1], pose[2], False, warped, space)
        of_last = add_pair(last, warped, cos, sin, increment, reach, rest, 0, A, b) if with_last else 0
        m = add_pair(carried, warped, cos, sin, increment, reach, rest, of_last, A, b)
        if m <= 6:
            break
        variance, k = truncated_flow(A, b, m, s.iterations, xi, H, V, A[6])
        find_observable(A, m, increment, reach, variance, s.known, H, V, observable)
        pulled(xi, pose, guess, sigma, reach, variance, H, V, observable)
        dx, dy, dt = se2_exp(xi[0], xi[1], xi[2] / reach)
        pose[0], pose[1], pose[2] = se2_compose(dx, dy, dt, pose[0], pose[1], pose[2])
        if abs(xi[0]) + abs(xi[1]) + abs(xi[2]) < s.settled:
            break
    return m, of_last, variance, k


@kernel(fastmath=True)
def scatter(A, b, m, increment, reach, agree, space):
    """Return 1.4826 times the median of the residuals |R_t| [m], and how many are below `agree` [m]."""
    agreeing = 0
    for i in range(m):
        space[i] = abs(b[i] / (A[5, i] * increment * reach))
        if space[i] < agree:
            agreeing += 1
    return 1.4826 * smallest(space[:m], m // 2), agreeing


@kernel
def flow_part(A, b, of_last, k, H, V, part):
    """Fill part (3, 3) with H⁻¹ H_last: what an error of the last scan's pose has to do with that of the new one's."""
    of = np.zeros((3, 3))
    if of_last > 0:
        normal_equations(A, b, of_last, np.zeros(3), k, True, of)
    for i in range(3):
        for j in range(3):
            part[i, j] = 0.0
            for l in range(3):
                for c in range(3):
                    part[i, j] += V[i, l] * V[c, l] / max(H[l, l], 1e-300) * of[c, j]


@kernel
def whole_covariance(C, last, part, scale, reach, common, free, V, observable, out):
    """Fill out (3, 3): the error of the new scan's pose in the frame of the last one.

    C (3, 3): of the flow; last (3, 3): of the last scan's pose, of which `part` goes on, if any. A part `common` of the
    residuals' scale [m] does not average out. free (3,): variance where nothing is observable.
    """
    units = np.array([1.0, 1.0, 1.0 / reach])
    project, whole, observable_part = np.zeros((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    carry_covariance(part, last, whole)
    unseen = _UNSEEN * (_TWICE if part[0, 0] > 0.0 else 1.0)
    for i in range(3):
        for j in range(3):
            whole[i, j] += unseen * C[i, j] + ((common * max(scale, _LEAST)) ** 2 if i == j else 0.0)
            for k in range(3):
                project[i, j] += observable[k] * V[i, k] * V[j, k]
    carry_covariance(project, whole, observable_part)
    for k in range(3):
        wide = 0.0
        for i in range(3):
            wide += V[i, k] * V[i, k] * free[i] / (units[i] * units[i])
        for i in range(3):
            for j in range(3):
                observable_part[i, j] += (1.0 - observable[k]) * V[i, k] * V[j, k] * wide
    for i in range(3):
        for j in range(3):
            out[i, j] = units[i] * observable_part[i, j] * units[j]


@kernel
def carry_covariance(adjoint, C, out):
    """out = Ad C Adᵀ, made symmetric and a little larger than nothing."""
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for k in range(3):
                for l in range(3):
                    total += adjoint[i, k] * C[k, l] * adjoint[j, l]
            out[i, j] = out[j, i] = total


@kernel
def fit_scan(
    key, last, new, seen, P_seen, with_last, start, cos, sin, increments, reach, s, mount, guess, sigma, free,
    pose, covariance, V, observable,
):  # fmt: skip
    """Match the pyramid of a scan coarse to fine, from a guess (3,) of the base's pose seen from the keyscan's.

    seen (3,), P_seen (3, 3): where the base was at the last scan, seen from the keyscan, and its covariance.
    Fills the base's pose (3,), its covariance (3, 3), and which columns of V are observable.
    Returns the rows, the scale of the residuals [m], NaN where something is not finite, and how many of them agree.
    """
    n = start[1]
    work, A, b = np.empty((7, n)), np.empty((7, 2 * n)), np.empty(2 * n)
    H, C, part, P = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    adjoint, from_start = np.empty((3, 3)), np.empty(3)
    ix, iy, it = se2_between(mount[0], mount[1], mount[2], 0.0, 0.0, 0.0)
    lx, ly, lt = se2_compose(seen[0], seen[1], seen[2], mount[0], mount[1], mount[2])
    lx, ly, lt = se2_compose(ix, iy, it, lx, ly, lt)  # the laser at the last scan seen from that at the keyscan
    between = np.array(se2_between(lx, ly, lt, 0.0, 0.0, 0.0))
    gx, gy, gt = se2_compose(guess[0], guess[1], guess[2], mount[0], mount[1], mount[2])
    gx, gy, gt = se2_compose(ix, iy, it, gx, gy, gt)
    from_start[0], from_start[1], from_start[2] = se2_between(lx, ly, lt, gx, gy, gt)
    motion, m, of_last, k = from_start.copy(), 0, 0, 0.0
    for level in range(len(start) - 2, -1, -1):
        at = slice(start[level], start[level + 1])
        m, of_last, _, k = match_level(
            key[at], last[at], new[at], between, with_last, cos[at], sin[at], increments[level], reach, from_start,
            sigma, s, motion, work, A, b, H, V, observable,
        )  # fmt: skip
    if m <= 6:
        return m, 0.0, 0
    scale, agree = scatter(A, b, m, increments[0], reach, s.agree, A[6])
    flow_part(A, b, of_last, k, H, V, part)
    flow_covariance(A, b, m, np.zeros(3), k, True, s.lags, H, V, A[3:6], C)
    se2_adjoint(ix, iy, it, adjoint)  # from the base to the laser
    carry_covariance(adjoint, P_seen, P)
    for i in range(3):
        for j in range(3):
            P[i, j] *= (reach if i == 2 else 1.0) * (reach if j == 2 else 1.0)
    whole_covariance(C, P, part, scale, reach, s.common, free, V, observable, P)
    x, y, t = se2_compose(lx, ly, lt, motion[0], motion[1], motion[2])
    x, y, t = se2_compose(mount[0], mount[1], mount[2], x, y, t)
    pose[0], pose[1], pose[2] = se2_compose(x, y, t, ix, iy, it)
    x, y, t = se2_between(motion[0], motion[1], motion[2], 0.0, 0.0, 0.0)  # errors as the new scan's laser has them
    x, y, t = se2_compose(mount[0], mount[1], mount[2], x, y, t)  # and the base
    se2_adjoint(x, y, t, adjoint)
    carry_covariance(adjoint, P, covariance)
    return m, scale if math.isfinite(pose.sum() + covariance.sum()) else math.nan, agree
