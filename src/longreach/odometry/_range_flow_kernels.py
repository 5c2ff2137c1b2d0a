"""Compiled range flow: the rows of the least-squares problem, its robust solution and covariance, coarse to fine.

Loops over beams run with fastmath, so nothing infinite or NaN may enter (the face replaces them by 0).
"""

import math
from collections import namedtuple

import numpy as np

from longreach.geometry._kernels import se2_adjoint, se2_between, se2_compose, se2_exp, se2_log
from longreach.kernels import kernel
from longreach.odometry._flow_solution_kernels import blend, flow_covariance, robust_flow
from longreach.odometry._pyramid_kernels import build_pyramid, clean, deskew, sampling_error, warp

_FRESH = 0.3  # weight of the last twist in the running mean
Settings = namedtuple("Settings", "reach iterations linearisations settled noise c d lags share")


@kernel(fastmath=True)
def mean_scan(old, warped, cos, sin, mean, arc, slope):
    """Steps 3 and 4: the mean of both scans, the distance between its neighbouring points, and its slope R_α.

    The slope takes both neighbours, each weighted by the arc to the other one, so that it does not reach across edges;
    where one neighbour is null it takes the other alone. A point with no neighbour is made null.
    """
    n = len(old)
    for u in range(n):
        mean[u] = 0.5 * (old[u] + warped[u]) if old[u] > 0.0 and warped[u] > 0.0 else 0.0
    for u in range(n - 1):
        dx = mean[u + 1] * cos[u + 1] - mean[u] * cos[u]
        dy = mean[u + 1] * sin[u + 1] - mean[u] * sin[u]
        arc[u] = math.sqrt(dx * dx + dy * dy) + 1e-9
    slope[0] = 0.0
    slope[n - 1] = 0.0
    for u in range(1, n - 1):
        left, right = mean[u - 1] > 0.0, mean[u + 1] > 0.0
        if left and right:
            slope[u] = (arc[u - 1] * (mean[u + 1] - mean[u]) + arc[u] * (mean[u] - mean[u - 1])) / (arc[u - 1] + arc[u])
        elif right:
            slope[u] = mean[u + 1] - mean[u]
        elif left:
            slope[u] = mean[u] - mean[u - 1]
        else:
            slope[u] = 0.0


@kernel(fastmath=True)
def flow_rows(old, warped, mean, slope, cos, sin, increment, noise, A, b):
    """Fill the weighted rows A (3, m), b (m,) of ρ = b + Aᵀ ξ, and return m. (3.24), corrected

    ξ = [v_x, v_y, ω] per scan, in the sensor's frame. Step 5: the weight of a row falls with the derivatives and with
    their change, where the linearisation is poor; `noise` [m] keeps it finite on identical scans.
    """
    n = len(old)
    k = 1.0 / increment
    m = 0
    largest = 0.0
    for u in range(1, n - 1):
        if mean[u] <= 0.0 or (mean[u - 1] <= 0.0 and mean[u + 1] <= 0.0):
            continue
        R_t = warped[u] - old[u]
        R_a = slope[u]
        change = 0.0
        if mean[u - 1] > 0.0 and mean[u + 1] > 0.0:
            change = abs((old[u + 1] - old[u - 1]) - (warped[u + 1] - warped[u - 1])) + abs(slope[u + 1] - slope[u - 1])
        w = 1.0 / math.sqrt(R_t * R_t + R_a * R_a + 0.2 * change + noise * noise)
        c, s, lever = cos[u], sin[u], R_a * k / mean[u]
        A[0, m] = w * (c + lever * s)
        A[1, m] = w * (s - lever * c)
        A[2, m] = -w * R_a * k
        b[m] = w * R_t
        largest = max(largest, w)
        m += 1
    if m > 0:
        scale = 1.0 / largest
        for i in range(m):
            A[0, i] *= scale
            A[1, i] *= scale
            A[2, i] *= scale
            b[i] *= scale
    return m


@kernel
def match_pyramids(old, new, start, cos, sin, increments, previous, settings, work, rows, covariance):
    """Estimate the sensor's motion from the old scan to the new one, coarse to fine (Jaimez 2016).

    previous: the last motion as a twist per scan. settings: a `Settings`. work (5, n), rows (4, n): space.
    Fills covariance (3, 3) of ξ. Returns x, y, θ of the new scan seen from the old one, and the rows used.
    """
    x = y = theta = 0.0
    xi, expected = np.zeros(3), np.zeros(3)
    H, V = np.zeros((3, 3)), np.zeros((3, 3))
    A, b = rows[:3], rows[3]
    m = 0
    for level in range(len(start) - 2, -1, -1):
        lo, hi = start[level], start[level + 1]
        n = hi - lo
        r_old, r_new, co, si, increment = old[lo:hi], new[lo:hi], cos[lo:hi], sin[lo:hi], increments[level]
        warped, weight, mean, arc, slope = work[0, :n], work[1, :n], work[2, :n], work[3, :n], work[4, :n]
        for _ in range(settings.linearisations):
            warp(r_new, co, si, increment, x, y, theta, warped, weight)
            mean_scan(r_old, warped, co, si, mean, arc, slope)
            m = flow_rows(r_old, warped, mean, slope, co, si, increment, settings.noise, A, b)
            if m <= 3:
                break
            variance, k = robust_flow(A, b, m, settings.iterations, xi, H, V)
            if level == 0:
                flow_covariance(A, b, m, xi, k, False, settings.lags, H, V, work, covariance)
            done = se2_log(x, y, theta)
            for j in range(3):
                expected[j] = previous[j] - done[j]
            fade = math.exp(-level)
            blend(xi, H, V, variance, expected, settings.c * fade, settings.d * fade, covariance)
            dx, dy, dt = se2_exp(xi[0], xi[1], xi[2])
            x, y, theta = se2_compose(x, y, theta, dx, dy, dt)
            if abs(xi[0]) + abs(xi[1]) + abs(xi[2]) < settings.settled:
                break
    return x, y, theta, m


@kernel
def step_scan(
    scan, low, high, flipped, share, old, new, start, cos, sin, increments, motion, mount, settings, pose, covariance
):  # fmt: skip
    """Fill the pyramid `new` from the ranges of a scan between low and high, and match it against `old`.

    motion (2, 3): the laser's last twist per scan and its running mean, both brought up to date. share: the part of it
    that goes by from beam to beam. Fills the base's pose (3,) and covariance (3, 3), carried from the laser through the
    planar mount (3,). Returns the rows used on the finest level, 0 where the result is not finite.
    """
    n = len(scan)
    ranges = np.empty(n)
    clean(scan, low, high, flipped, ranges)
    if share > 0.0:
        swept = ranges.copy()
        deskew(swept, cos, sin, increments[0], motion[1], share, flipped, ranges, np.empty(n))
    build_pyramid(ranges, start, settings.reach, new)
    local = np.zeros((3, 3))
    x, y, theta, m = match_pyramids(
        old, new, start, cos, sin, increments, motion[0], settings, np.empty((5, n)), np.empty((4, n)), local
    )
    motion[0, 0], motion[0, 1], motion[0, 2] = se2_log(x, y, theta)
    for i in range(3):  # a mean, for an error of the last twist would skew the next scan, and come back larger
        motion[1, i] += _FRESH * (motion[0, i] - motion[1, i])
    deviation = sampling_error(ranges, increments[0], x, y, theta, settings.share)
    for i in range(2):
        local[i, i] += deviation * deviation
    x, y, theta = se2_compose(mount[0], mount[1], mount[2], x, y, theta)
    ix, iy, it = se2_between(mount[0], mount[1], mount[2], 0.0, 0.0, 0.0)
    pose[0], pose[1], pose[2] = se2_compose(x, y, theta, ix, iy, it)
    adjoint = np.empty((3, 3))
    se2_adjoint(mount[0], mount[1], mount[2], adjoint)
    for i in range(3):
        for j in range(3):
            covariance[i, j] = 1e-12 if i == j else 0.0
            for k in range(3):
                for l in range(3):
                    covariance[i, j] += adjoint[i, k] * local[k, l] * adjoint[j, l]
    return m if math.isfinite(pose.sum() + covariance.sum()) else 0
