"""Compiled symmetric range flow of 2018: a scan against the last one, a keyscan, or both, by how ranges differ."""

import math

import numpy as np

from longreach.geometry._eigen_kernels import solve_in_basis
from longreach.geometry._kernels import se2_adjoint, se2_between, se2_compose, se2_exp, se2_log
from longreach.kernels import kernel
from longreach.odometry.matchers import _flow_kernels
from longreach.odometry.matchers._feature_kernels import smallest
from longreach.odometry.matchers._flow_kernels import as_seen_from, carried, flow_rows, transformed

_ITERATIONS = 10  # reweightings at most; the authors' code
_NOISE = 0.2  # [m] floor under the derivatives in a row's weight; the authors' code
_KNOWN = 3.0  # information over that from errors of slopes alone
_COMMON = 0.02  # of the residuals, the part common to all beams
_AGREE = 0.1  # [m] a residual below it agrees
_WIDEST = 8.0  # beams between two neighbouring points that still are one surface
_UNSEEN = 1.4  # of the variance, with what residuals do not show: measured on made scans, 1.3 to 1.6
_TWICE = 1.5  # where two scans are matched to: the new scan's noise is in both pairs
_LEAST = 1e-3  # [m] scale of the residuals; scans without noise are wrong by something, too
_SLOPE = 0.075  # variance of a slope over that of R_t, after smoothing twice with [1 4 6 4 1]


@kernel(fastmath=True)
def warp_segments(r, cos, sin, increment, x, y, theta, farthest, warped, space):
    """Carry a scan by (x, y, θ): each beam between two neighbouring points sees the line through both.

    Of several the nearest is seen, or the farthest: where less is hidden from there. space (2, n).
    """
    n = len(r)
    ct, st = math.cos(theta), math.sin(theta)
    for u in range(n):
        warped[u] = 0.0
        space[0, u] = -1e9
        if r[u] > 0.0:
            turned, square = carried(r[u], cos[u], sin[u], increment, x, y, ct, st)
            space[0, u], space[1, u] = u + turned, 1.0 / math.sqrt(square + 1e-12)
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
def find_observable(A, m, increment, reach, variance, H, V, observable):
    """Fill observable (3,) with 1 or 0: whether the data determine each direction of the eigenbasis V of H.

    Noise of slopes looks like information: H has to be `_KNOWN` times that. variance: of a weighted residual.
    """
    largest = max(H[0, 0], max(H[1, 1], H[2, 2]))
    for j in range(3):
        errors = weights = 0.0
        for i in range(m):
            along = A[4, i] * V[0, j] + A[5, i] * V[1, j] + A[6, i] * V[2, j]
            errors += along * along
            weights += A[6, i] * A[6, i]
        noise = _SLOPE * variance * m / max(weights * (increment * reach) ** 2, 1e-300)  # of a slope
        observable[j] = 1.0 if H[j, j] > _KNOWN * errors * noise + 1e-5 * largest else 0.0


@kernel
def pulled(xi, pose, guess, sigma, reach, variance, H, V, observable):
    """Draw ξ to the guess: wholly along what is not observable, by information elsewhere. sigma (3,): its deviation."""
    ix, iy, it = se2_between(pose[0], pose[1], pose[2], 0.0, 0.0, 0.0)
    ox, oy, ot = se2_log(*se2_compose(guess[0], guess[1], guess[2], ix, iy, it))
    off = (ox, oy, ot * reach)
    for k in range(3):
        weight = moved = 0.0
        for i in range(3):
            deviation = sigma[i] * (reach if i == 2 else 1.0)
            weight += V[i, k] * V[i, k] * variance / (deviation * deviation)
            moved += V[i, k] * (off[i] - xi[i])
        if observable[k] > 0.0:
            moved *= weight / (H[k, k] + weight)
        for i in range(3):
            xi[i] += V[i, k] * moved


@kernel(fastmath=True)
def scatter(A, m, increment, reach):
    """Return 1.4826 times the median of the residuals |R_t| [m], and how many agree."""
    agreeing = 0
    for i in range(m):
        A[7, i] = abs(A[3, i] / (A[6, i] * increment * reach))
        agreeing += A[7, i] < _AGREE
    return 1.4826 * smallest(A[7, :m], m // 2), agreeing


@kernel
def whole_covariance(A, of_last, k, H, V, C, last, scale, reach, free, observable, out):
    """Fill out (3, 3): the error of the new scan's pose in the frame of the last one.

    C (3, 3): of the flow; last (3, 3): of the last scan's pose, which goes on by H⁻¹ H_last where that scan takes part.
    free (3,): variance where nothing is observable.
    """
    project, whole, part, of_pose = np.zeros((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.zeros((3, 4))
    if of_last > 0:
        _flow_kernels.normal_equations(A, of_last, np.zeros(3), k, True, of_pose)
    for j in range(3):
        solve_in_basis(H, V, of_pose[0, j], of_pose[1, j], of_pose[2, j], part[:, j])
    transformed(part, last, whole)
    unseen, shared = _UNSEEN * (_TWICE if of_last > 0 else 1.0), _COMMON * max(scale, _LEAST)
    for i in range(3):
        whole[i, i] += shared * shared
        for j in range(3):
            whole[i, j] += unseen * C[i, j]
            for k in range(3):
                project[i, j] += observable[k] * V[i, k] * V[j, k]
    transformed(project, whole, out)
    for k in range(3):
        wide = V[0, k] * V[0, k] * free[0] + V[1, k] * V[1, k] * free[1] + V[2, k] * V[2, k] * free[2] * reach * reach
        for i in range(3):
            for j in range(3):
                out[i, j] += (1.0 - observable[k]) * V[i, k] * V[j, k] * wide


@kernel
def fit_scan(
    key, last, new, seen, P_seen, with_last, start, cos, sin, increments, reach, mount, guess, sigma, free,
    pose, covariance, V, observable,
):  # fmt: skip
    """Match the pyramid of a scan coarse to fine, from a guess (3,) of the base's pose seen from the keyscan's.

    seen (3,), P_seen (3, 3): where the base was at the last scan, seen from the keyscan, and its covariance.
    Fills the base's pose (3,), its covariance (3, 3), and which columns of V are observable.
    Returns the rows, the scale of the residuals [m], NaN where something is not finite, and how many of them agree.
    """
    work, A = np.empty((7, start[1])), np.empty((8, 2 * start[1]))
    H, C, P, adjoint = np.zeros((3, 4)), np.zeros((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    ix, iy, it = se2_between(mount[0], mount[1], mount[2], 0.0, 0.0, 0.0)
    lx, ly, lt = as_seen_from(ix, iy, it, seen[0], seen[1], seen[2])  # the laser, as all that follows
    gx, gy, gt = as_seen_from(ix, iy, it, guess[0], guess[1], guess[2])
    between = np.array(se2_between(lx, ly, lt, 0.0, 0.0, 0.0))
    from_start = np.array(se2_between(lx, ly, lt, gx, gy, gt))
    motion, xi, m, of_last, k = from_start.copy(), np.empty(3), 0, 0, 0.0
    for level in range(len(start) - 2, -1, -1):
        at, increment = slice(start[level], start[level + 1]), increments[level]
        c, s, n = cos[at], sin[at], start[level + 1] - start[level]
        space, from_key, warped, rest = work[:2, :n], work[2, :n], work[3, :n], work[4:]
        warp_segments(key[at], c, s, increment, between[0], between[1], between[2], True, from_key, space)
        for _ in range(_flow_kernels.LINEARISATIONS):
            warp_segments(new[at], c, s, increment, motion[0], motion[1], motion[2], False, warped, space)
            of_last = flow_rows(last[at], warped, c, s, increment, reach, _NOISE, True, rest, 0, A) if with_last else 0
            m = flow_rows(from_key, warped, c, s, increment, reach, _NOISE, True, rest, of_last, A)
            if m <= 6:
                break
            variance, k = _flow_kernels.robust_flow(A, m, _ITERATIONS, True, xi, H, V)
            find_observable(A, m, increment, reach, variance, H, V, observable)
            pulled(xi, motion, from_start, sigma, reach, variance, H, V, observable)
            dx, dy, dt = se2_exp(xi[0], xi[1], xi[2] / reach)
            motion[0], motion[1], motion[2] = se2_compose(dx, dy, dt, motion[0], motion[1], motion[2])
            if abs(xi[0]) + abs(xi[1]) + abs(xi[2]) < _flow_kernels.SETTLED:
                break
    if m <= 6:
        return m, 0.0, 0
    scale, agree = scatter(A, m, increments[0], reach)
    _flow_kernels.flow_covariance(A, m, np.zeros(3), k, True, H, V, C)
    se2_adjoint(ix, iy, it, adjoint)  # from the base to the laser
    adjoint[2, 2] = reach  # and from radians to metres
    transformed(adjoint, P_seen, covariance)
    whole_covariance(A, of_last, k, H, V, C, covariance, scale, reach, free, observable, P)
    x, y, t = se2_compose(lx, ly, lt, motion[0], motion[1], motion[2])
    pose[0], pose[1], pose[2] = as_seen_from(mount[0], mount[1], mount[2], x, y, t)
    x, y, t = se2_between(motion[0], motion[1], motion[2], 0.0, 0.0, 0.0)  # errors as the new scan's laser has them
    x, y, t = se2_compose(mount[0], mount[1], mount[2], x, y, t)  # and the base
    se2_adjoint(x, y, t, adjoint)
    for i in range(3):
        adjoint[i, 2] /= reach
    transformed(adjoint, P, covariance)
    return m, scale if math.isfinite(pose.sum() + covariance.sum()) else math.nan, agree
