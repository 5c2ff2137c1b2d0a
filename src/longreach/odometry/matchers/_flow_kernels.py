"""Compiled parts of both range flows: a scan's pyramid, the rows of its flow, their robust solution, its covariance.

A pyramid is one flat array; level l occupies [start[l], start[l + 1]). Ranges are metres, 0 is null.
The m rows of ρ = b + aᵀ ξ are columns of A (8, m): 0 to 2: a; 3: b; 4 to 6: what an error of the slope R_α adds to a;
7: space. Their weights are Cauchy's, 1/(1 + (kρ)²), or the truncated parabola's, 1 - (kρ)².
Loops over beams run with fastmath, so nothing infinite or NaN may enter: `scan_pyramid` makes them 0.
"""

import math

import numpy as np

from longreach.geometry._eigen_kernels import solve_in_basis, symmetric_eigen
from longreach.geometry._kernels import se2_between, se2_compose, se2_exp
from longreach.kernels import kernel
from longreach.odometry.matchers._feature_kernels import smallest

LINEARISATIONS = 3  # a level at most; the authors' code of 2018
SETTLED = 0.01  # [m + rad] a level's motion below which it is not linearised again; 0.05 in that code
_REACH = 0.3  # [m] neighbours further away in range are not smoothed; the authors' code of 2016
_MASK = ((-1, 4.0), (1, 4.0), (-2, 1.0), (2, 1.0))  # beams beside one, and their weight in the mean; its own is 6
_LAGS = 6  # neighbouring rows whose errors may be correlated


@kernel
def scan_pyramid(ranges, low, high, flipped, cos, sin, increment, motion, share, start, out, pyramid):
    """Fill out (n,) with the ranges counter-clockwise, deskewed, 0 where there was no return, and their pyramid."""
    n = len(ranges)
    for u in range(n):
        r = ranges[n - 1 - u] if flipped else ranges[u]
        out[u] = r if r > 0.0 and r >= low and r <= high and r < math.inf else 0.0
    if share > 0.0:
        deskew(out.copy(), cos, sin, increment, motion, share, flipped, out)
    build_pyramid(out, start, pyramid)


@kernel(fastmath=True)
def build_pyramid(ranges, start, out):
    """Step 1: smooth each level by the bilateral mask [1 4 6 4 1] · (reach - |Δr|), and keep every second beam."""
    source, n, every = ranges, len(ranges), 1
    for level in range(len(start) - 1):
        target = out[start[level] : start[level + 1]]
        for i in range(len(target)):
            u, weight = every * i, 6.0 * _REACH
            total = weight * source[u]
            for step, mask in _MASK:
                if 0 <= u + step < n:
                    w = mask * max(0.0, _REACH - abs(source[u + step] - source[u]))
                    weight += w
                    total += w * source[u + step]
            target[i] = total / weight if source[u] > 0.0 else 0.0
        source, n, every = target, len(target), 2


@kernel(fastmath=True)
def carried(r, cos, sin, increment, x, y, cos_theta, sin_theta):
    """Carry a beam's point by the motion (x, y, θ); return by how many beams it is turned, and its range squared."""
    px, py = r * cos, r * sin
    qx, qy = cos_theta * px - sin_theta * py + x, sin_theta * px + cos_theta * py + y
    along, across = cos * qx + sin * qy, cos * qy - sin * qx
    if along > 0.0 and abs(across) < 0.2 * along:
        z = across / along  # small between two scans: by the series, to 1e-9
        z2 = z * z
        turned = z * (1.0 - z2 * (1 / 3 - z2 * (1 / 5 - z2 * (1 / 7 - z2 * (1 / 9 - z2 / 11)))))
    else:
        turned = math.atan2(across, along)
    return turned / increment, qx * qx + qy * qy


@kernel(fastmath=True)
def deskew(r, cos, sin, increment, motion, share, flipped, out):
    """Fill out (n,) with the ranges as they would be seen from where the sweep began.

    motion (3,): the sensor's twist from scan to scan; share: the part of it that goes by from beam to beam.
    """
    n, weight = len(r), np.zeros(len(r))
    out[:] = 0.0
    for u in range(n):
        if r[u] <= 0.0:
            continue
        part = share * (n - 1 - u if flipped else u)
        x, y, t = se2_exp(part * motion[0], part * motion[1], part * motion[2])
        turned, square = carried(r[u], cos[u], sin[u], increment, x, y, math.cos(t), math.sin(t))
        position, distance = u + turned, math.sqrt(square)
        left = math.floor(position)
        for v in range(left, left + 2):
            if v >= 0 and v < n:
                w = 1.0 - abs(position - v)
                if weight[v] > 0.0 and abs(out[v] / weight[v] - distance) > 0.3:  # two surfaces: the nearer hides
                    if distance < out[v] / weight[v]:
                        out[v], weight[v] = w * distance, w
                    continue
                out[v] += w * distance
                weight[v] += w
    for u in range(n):
        out[u] = out[u] / weight[u] if weight[u] > 1e-3 else 0.0


@kernel(fastmath=True)
def flow_rows(old, warped, cos, sin, increment, reach, noise, symmetric, work, m, A):
    """Add the weighted rows A (8, m) of ρ = b + aᵀ ξ, and return how many there are then. (3.24), corrected

    ξ = [v_x, v_y, ω] per scan, in the frame of `old`, ω times reach [m]. work (3, n): space.
    Steps 3 and 4: the derivatives are those of the mean of both scans. The slope R_α takes both neighbours, each
    weighted by the arc to the other one, so that it does not reach across edges.
    Step 5: the weight of a row falls with the derivatives and their change, where the linearisation is poor, but by no
    less than `noise` [m]. symmetric: the change as in SRF 2018.
    """
    n, k, mean, arc, slope = len(old), 1.0 / increment, work[0], work[1], work[2]
    for u in range(n):
        mean[u] = 0.5 * (old[u] + warped[u]) if old[u] > 0.0 and warped[u] > 0.0 else 0.0
    for u in range(n - 1):
        dx = mean[u + 1] * cos[u + 1] - mean[u] * cos[u]
        dy = mean[u + 1] * sin[u + 1] - mean[u] * sin[u]
        arc[u] = math.sqrt(dx * dx + dy * dy) + 1e-9
    slope[0] = slope[n - 1] = 0.0
    for u in range(1, n - 1):
        to_left = arc[u] if mean[u - 1] > 0.0 else 0.0
        to_right = arc[u - 1] if mean[u + 1] > 0.0 else 0.0
        rise = to_right * (mean[u + 1] - mean[u]) + to_left * (mean[u] - mean[u - 1])
        slope[u] = rise / max(to_left + to_right, 1e-9)
    first, largest = m, 1e-300
    for u in range(1, n - 1):
        if mean[u] <= 0.0 or (mean[u - 1] <= 0.0 and mean[u + 1] <= 0.0):
            continue
        R_t, R_a, change = warped[u] - old[u], slope[u], 0.0
        if mean[u - 1] > 0.0 and mean[u + 1] > 0.0:
            bend = slope[u + 1] - slope[u - 1]
            if symmetric:
                change = 0.02 * bend * bend
            else:
                change = 0.2 * (abs((old[u + 1] - old[u - 1]) - (warped[u + 1] - warped[u - 1])) + abs(bend))
        w = 1.0 / math.sqrt(R_t * R_t + R_a * R_a + change + noise * noise)
        A[4, m], A[5, m], A[6, m] = w * k / mean[u] * sin[u], -w * k / mean[u] * cos[u], -w * k / reach
        A[0, m], A[1, m], A[2, m] = w * cos[u] + A[4, m] * R_a, w * sin[u] + A[5, m] * R_a, A[6, m] * R_a
        A[3, m] = w * R_t
        largest = max(largest, w)
        m += 1
    for j in range(7):
        for i in range(first, m):
            A[j, i] /= largest
    return m


@kernel(fastmath=True)
def normal_equations(A, m, xi, k, truncated, H):
    """Fill H (3, 4) with Σ w a aᵀ and Σ w a b; return Σ w ρ² and the energy, at the weights w of ξ. (3.25)

    The energy is that of the smooth truncated parabola, in units of where it ends: Σ z (1 - z/2), 1/2 beyond.
    """
    squares = energy = 0.0
    for i in range(m):
        residual = A[3, i] + A[0, i] * xi[0] + A[1, i] * xi[1] + A[2, i] * xi[2]
        z = k * k * residual * residual
        if truncated:
            z = min(z, 1.0)
            energy += z * (1.0 - 0.5 * z)
        A[7, i] = 1.0 - z if truncated else 1.0 / (1.0 + z)
        squares += A[7, i] * residual * residual
    for p in range(3):
        for q in range(p, 4):
            total = 0.0
            for i in range(m):
                total += A[7, i] * A[p, i] * A[q, i]
            H[p, q] = total
            if q < 3:
                H[q, p] = total
    return squares, energy


@kernel
def _residual_scale(A, m, xi, truncated):
    """Return k: of the truncated parabola from the median |ρ|, of some 300 rows, of Cauchy's weights from the mean."""
    step, n, total = max(m // 300, 1) if truncated else 1, 0, 0.0
    for i in range(0, m, step):
        A[7, n] = abs(A[3, i] + A[0, i] * xi[0] + A[1, i] * xi[1] + A[2, i] * xi[2])
        total += A[7, n]
        n += 1
    if truncated:
        return 1.0 / max(4.0 * smallest(A[7, :n], n // 2), 1e-6)
    return 1.0 / (2.385 * 1.2533 * max(total / m, 1e-9))


@kernel
def robust_flow(A, m, iterations, truncated, xi, H, V):
    """Step 6: least squares, then IRLS with weights from its residuals; leave H (3, 4) diagonal in its eigenbasis V.

    Cauchy's weights until ξ stands still, k = 1/(2.385 σ): 95 % efficient where the noise is Gaussian (with the 2016
    code's k = 10/mean|R_t|, ξ is three times as noisy). Or those of the truncated parabola, which ends at four median
    residuals, until its energy falls by less than 0.5 % (SRF 2018). Returns the variance of a weighted residual, and k.
    """
    k, last, squares, settled = 0.0, 0.0, 0.0, False
    xi[:] = 0.0
    for iteration in range(iterations + 2):
        squares, energy = normal_equations(A, m, xi, k, truncated, H)
        symmetric_eigen(H, V)
        if truncated:
            settled = iteration > 1 and energy > 0.995 * last
        if settled or iteration > iterations:
            break
        last = energy
        x0, x1, x2 = xi[0], xi[1], xi[2]
        solve_in_basis(H, V, -H[0, 3], -H[1, 3], -H[2, 3], xi)
        if iteration == 0:
            k = _residual_scale(A, m, xi, truncated)
        else:
            change = abs(xi[0] - x0) + abs(xi[1] - x1) + abs(xi[2] - x2)
            settled = change < 1e-3 * (abs(xi[0]) + abs(xi[1]) + abs(xi[2])) + 1e-6
    return squares / max(m - 3, 1), k


@kernel(fastmath=True)
def flow_covariance(A, m, xi, k, truncated, H, V, covariance):
    """Fill covariance (3, 3) of ξ from what the residuals are, not from what they should be.

    The sandwich H⁻¹ S H⁻¹, with S the long-run covariance of the scores w ρ a over `_LAGS` neighbouring rows (Bartlett
    window, Newey & West 1987), which take the place of rows 4 to 6: neighbours err together.
    H counts w where the curvature of the cost is w (2w - 1), or 3w - 2; `steepness` makes up for it.
    """
    scores, curvature, weights = A[4:7], 0.0, 0.0
    for i in range(m):
        residual = A[3, i] + A[0, i] * xi[0] + A[1, i] * xi[1] + A[2, i] * xi[2]
        z = k * k * residual * residual
        share = max(1.0 - z, 0.0) if truncated else 1.0 / (1.0 + z)
        if share > 0.0:
            curvature += 3.0 * share - 2.0 if truncated else share * (2.0 * share - 1.0)
        weights += share
        w = residual * share
        for j in range(3):
            scores[j, i] = w * (A[0, i] * V[0, j] + A[1, i] * V[1, j] + A[2, i] * V[2, j])
    steepness = weights / max(curvature, 0.1 * weights)
    growth = m / max(m - 3.0, 1.0) * steepness * steepness
    floor = 1e-12 * max(H[0, 0], max(H[1, 1], H[2, 2])) + 1e-300
    S = np.zeros((3, 3))
    for p in range(3):
        for q in range(p, 3):
            total = 0.0
            for lag in range(min(_LAGS, m - 1) + 1):
                part = 0.0
                for i in range(m - lag):
                    part += scores[p, i] * scores[q, i + lag] + scores[p, i + lag] * scores[q, i]
                total += part * (1.0 - lag / (_LAGS + 1.0) if lag > 0 else 0.5)
            S[p, q] = S[q, p] = total * growth / (max(H[p, p], floor) * max(H[q, q], floor))
    transformed(V, S, covariance)


@kernel
def transformed(T, C, out):
    """out = T C Tᵀ (3, 3), exactly symmetric."""
    for i in range(3):
        for j in range(i + 1):
            total = 0.0
            for k in range(3):
                for l in range(3):
                    total += T[i, k] * C[k, l] * T[j, l]
            out[i, j] = out[j, i] = total


@kernel
def as_seen_from(px, py, pt, x, y, t):
    """P T P⁻¹: the motion (x, y, t) of a frame, as one of another from which the frame is at the pose P."""
    ix, iy, it = se2_between(px, py, pt, 0.0, 0.0, 0.0)
    x, y, t = se2_compose(px, py, pt, x, y, t)
    return se2_compose(x, y, t, ix, iy, it)
