"""Compiled parts of range flow: the pyramid, the warp, the rows of the least-squares problem and its robust solution.

A pyramid is one flat array; level l occupies [start[l], start[l + 1]). Ranges are metres, 0 is null.
Loops over beams run with fastmath, so nothing infinite or NaN may enter (the face replaces them by 0).
"""

import math

import numpy as np

from longreach.geometry._kernels import se2_compose, se2_exp, se2_log
from longreach.kernels import kernel


@kernel(fastmath=True)
def _smooth_beam(r, u, n, reach):
    """Bilateral mask [1 4 6 4 1] · (reach - |Δr|): neighbours across an edge have no part in the mean."""
    centre = r[u]
    weight = 6.0 * reach
    total = weight * centre
    for step in range(1, 3):
        mask = 4.0 if step == 1 else 1.0
        if u >= step:
            w = mask * max(0.0, reach - abs(r[u - step] - centre))
            weight += w
            total += w * r[u - step]
        if u + step < n:
            w = mask * max(0.0, reach - abs(r[u + step] - centre))
            weight += w
            total += w * r[u + step]
    return total / weight


@kernel(fastmath=True)
def build_pyramid(ranges, start, reach, out):
    """Step 1: smooth each level, then keep every second beam for the next."""
    n = len(ranges)
    source = ranges
    for level in range(len(start) - 1):
        target = out[start[level] : start[level + 1]]
        if level == 0:
            for u in range(n):
                target[u] = _smooth_beam(source, u, n, reach) if source[u] > 0.0 else 0.0
        else:
            for u in range(len(target)):
                target[u] = _smooth_beam(source, 2 * u, n, reach) if source[2 * u] > 0.0 else 0.0
        source = target
        n = len(target)


@kernel(fastmath=True)
def _atan_ratio(y, x):
    """atan2(y, x), by its series to 1e-9 where the angle is small, which it nearly always is between two scans."""
    if x > 0.0 and abs(y) < 0.2 * x:
        z = y / x
        z2 = z * z
        return z * (1.0 - z2 * (1 / 3 - z2 * (1 / 5 - z2 * (1 / 7 - z2 * (1 / 9 - z2 / 11)))))
    return math.atan2(y, x)


@kernel(fastmath=True)
def warp(r, cos, sin, increment, x, y, theta, warped, weight):
    """Step 2: carry the new scan by the motion (x, y, θ) into the old one's beams.

    Each point gives its range to its two neighbouring beams, weighted by nearness squared.
    """
    n = len(r)
    ct, st = math.cos(theta), math.sin(theta)
    for u in range(n):
        warped[u] = 0.0
        weight[u] = 0.0
    for u in range(n):
        if r[u] <= 0.0:
            continue
        px, py = r[u] * cos[u], r[u] * sin[u]
        qx, qy = ct * px - st * py + x, st * px + ct * py + y
        position = u + _atan_ratio(cos[u] * qy - sin[u] * qx, cos[u] * qx + sin[u] * qy) / increment
        if position < 0.0 or position > n - 1:
            continue
        distance = math.sqrt(qx * qx + qy * qy)
        left = min(int(position), n - 2)
        to_left = position - left
        w = (1.0 - to_left) * (1.0 - to_left)
        warped[left] += w * distance
        weight[left] += w
        w = to_left * to_left
        warped[left + 1] += w * distance
        weight[left + 1] += w
    for u in range(n):
        warped[u] = warped[u] / weight[u] if weight[u] > 1e-4 else 0.0


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
            slope[u] = (arc[u - 1] * (mean[u + 1] - mean[u]) + arc[u] * (mean[u] - mean[u - 1])) / (
                arc[u - 1] + arc[u]
            )
        elif right:
            slope[u] = mean[u + 1] - mean[u]
        elif left:
            slope[u] = mean[u] - mean[u - 1]
        else:
            slope[u] = 0.0


@kernel(fastmath=True)
def flow_rows(old, warped, mean, slope, cos, sin, increment, noise, A, b):
    """Fill the weighted rows A (3, m), b (m,) of ρ = b + Aᵀ ξ, and return m and the mean of |R_t|. (3.24), corrected

    ξ = [v_x, v_y, ω] per scan, in the sensor's frame. Step 5: the weight of a row falls with the derivatives and with
    their change, where the linearisation is poor; `noise` [m] keeps it finite on identical scans.
    """
    n = len(old)
    k = 1.0 / increment
    m = 0
    flow = 0.0
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
        flow += abs(R_t)
        largest = max(largest, w)
        m += 1
    if m > 0:
        scale = 1.0 / largest
        for i in range(m):
            A[0, i] *= scale
            A[1, i] *= scale
            A[2, i] *= scale
            b[i] *= scale
        flow /= m
    return m, flow


@kernel(fastmath=True)
def normal_equations(A, b, m, xi, k, H):
    """Fill H with Σ w a aᵀ and return (-Σ w a b, Σ w ρ²) at the Cauchy weights w = 1/(1 + (kρ)²) of ξ. (3.25)"""
    x0, x1, x2 = xi[0], xi[1], xi[2]
    h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = squares = 0.0
    k2 = k * k
    for i in range(m):
        a0, a1, a2, bi = A[0, i], A[1, i], A[2, i], b[i]
        residual = bi + a0 * x0 + a1 * x1 + a2 * x2
        w = 1.0 / (1.0 + k2 * residual * residual)
        h00 += w * a0 * a0
        h01 += w * a0 * a1
        h02 += w * a0 * a2
        h11 += w * a1 * a1
        h12 += w * a1 * a2
        h22 += w * a2 * a2
        g0 += w * a0 * bi
        g1 += w * a1 * bi
        g2 += w * a2 * bi
        squares += w * residual * residual
    H[0, 0], H[0, 1], H[0, 2] = h00, h01, h02
    H[1, 0], H[1, 1], H[1, 2] = h01, h11, h12
    H[2, 0], H[2, 1], H[2, 2] = h02, h12, h22
    return -g0, -g1, -g2, squares


@kernel
def symmetric_eigen(S, V):
    """Jacobi's rotations: S (3, 3) becomes diagonal in place, V (3, 3) its eigenvectors as columns."""
    for i in range(3):
        for j in range(3):
            V[i, j] = 1.0 if i == j else 0.0
    for _ in range(12):
        off = abs(S[0, 1]) + abs(S[0, 2]) + abs(S[1, 2])
        if off <= 1e-15 * (abs(S[0, 0]) + abs(S[1, 1]) + abs(S[2, 2])):
            return
        for p in range(2):
            for q in range(p + 1, 3):
                if S[p, q] == 0.0:
                    continue
                ratio = (S[q, q] - S[p, p]) / (2.0 * S[p, q])
                t = 1.0 / (abs(ratio) + math.sqrt(1.0 + ratio * ratio))
                if ratio < 0.0:
                    t = -t
                c = 1.0 / math.sqrt(1.0 + t * t)
                s = t * c
                for k in range(3):
                    S[k, p], S[k, q] = c * S[k, p] - s * S[k, q], s * S[k, p] + c * S[k, q]
                for k in range(3):
                    S[p, k], S[q, k] = c * S[p, k] - s * S[q, k], s * S[p, k] + c * S[q, k]
                for k in range(3):
                    V[k, p], V[k, q] = c * V[k, p] - s * V[k, q], s * V[k, p] + c * V[k, q]


@kernel
def _solve_in_basis(values, V, g0, g1, g2, xi):
    """ξ = Σ v (vᵀ g) / λ over the directions that the data determine."""
    floor = 1e-12 * max(values[0, 0], max(values[1, 1], values[2, 2]))
    for i in range(3):
        xi[i] = 0.0
    for i in range(3):
        if values[i, i] > floor:
            along = (V[0, i] * g0 + V[1, i] * g1 + V[2, i] * g2) / values[i, i]
            for j in range(3):
                xi[j] += V[j, i] * along


@kernel
def robust_flow(A, b, m, flow, iterations, xi, H, V):
    """Step 6: least squares, then Cauchy IRLS until ξ stands still; leave H diagonal in its eigenbasis V.

    Return σ², the variance of a weighted residual at the solution.
    """
    k = 0.0
    squares = 0.0
    for i in range(3):
        xi[i] = 0.0
    for iteration in range(iterations + 1):
        g0, g1, g2, squares = normal_equations(A, b, m, xi, k, H)
        symmetric_eigen(H, V)
        b0, b1, b2 = xi[0], xi[1], xi[2]
        _solve_in_basis(H, V, g0, g1, g2, xi)
        change = abs(xi[0] - b0) + abs(xi[1] - b1) + abs(xi[2] - b2)
        size = abs(xi[0]) + abs(xi[1]) + abs(xi[2])
        if iteration > 0 and change < 1e-3 * size + 1e-6:
            break
        k = 10.0 / max(flow, 1e-6)
    _, _, _, squares = normal_equations(A, b, m, xi, k, H)
    symmetric_eigen(H, V)
    return squares / max(m - 3, 1)


@kernel
def blend(xi, H, V, variance, expected, c, d):
    """Step 8: in the covariance's eigenbasis draw ξ to the expected one, the more the less the data say."""
    floor = 1e-12 * max(H[0, 0], max(H[1, 1], H[2, 2])) + 1e-300
    m0, m1, m2 = xi[0], xi[1], xi[2]
    for j in range(3):
        xi[j] = 0.0
    for i in range(3):
        pull = c * variance / max(H[i, i], floor) + d
        found = V[0, i] * m0 + V[1, i] * m1 + V[2, i] * m2
        prior = V[0, i] * expected[0] + V[1, i] * expected[1] + V[2, i] * expected[2]
        along = (found + pull * prior) / (1.0 + pull)
        for j in range(3):
            xi[j] += V[j, i] * along


@kernel
def match_pyramids(old, new, start, cos, sin, increments, previous, settings, work, rows, covariance):
    """Estimate the sensor's motion from the old scan to the new one, coarse to fine (Jaimez 2016).

    settings: iterations, c, d, noise. previous: the last motion as a twist per scan. work (5, n), rows (4, n): space.
    Fills covariance (3, 3) of ξ on the finest level. Returns x, y, θ, the rows used there and σ² there.
    """
    iterations, c, d, noise = int(settings[0]), settings[1], settings[2], settings[3]
    x = y = theta = 0.0
    xi, expected = np.zeros(3), np.zeros(3)
    H, V = np.zeros((3, 3)), np.zeros((3, 3))
    m = 0
    variance = 0.0
    for level in range(len(start) - 2, -1, -1):
        lo, hi = start[level], start[level + 1]
        n = hi - lo
        if n < 4:
            continue
        r_old, r_new, co, si = old[lo:hi], new[lo:hi], cos[lo:hi], sin[lo:hi]
        warped, weight, mean, arc, slope = work[0, :n], work[1, :n], work[2, :n], work[3, :n], work[4, :n]
        warp(r_new, co, si, increments[level], x, y, theta, warped, weight)
        mean_scan(r_old, warped, co, si, mean, arc, slope)
        m, flow = flow_rows(r_old, warped, mean, slope, co, si, increments[level], noise, rows[:3], rows[3])
        if m <= 3:
            continue
        variance = robust_flow(rows[:3], rows[3], m, flow, iterations, xi, H, V)
        done = se2_log(x, y, theta)
        for j in range(3):
            expected[j] = previous[j] - done[j]
        blend(xi, H, V, variance, expected, c * math.exp(-level), d * math.exp(-level))
        dx, dy, dt = se2_exp(xi[0], xi[1], xi[2])
        x, y, theta = se2_compose(x, y, theta, dx, dy, dt)
    floor = 1e-12 * max(H[0, 0], max(H[1, 1], H[2, 2])) + 1e-300
    for i in range(3):
        for j in range(3):
            covariance[i, j] = 0.0
            for k in range(3):
                covariance[i, j] += V[i, k] * V[j, k] * variance / max(H[k, k], floor)
    return x, y, theta, m, variance
