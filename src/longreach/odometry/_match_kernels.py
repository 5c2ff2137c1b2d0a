"""Compiled point-to-line matching: the points of a scan against the lines of a keyframe, with its covariance.

ξ is the error of the laser's pose in its own frame. To be compared with metres, θ is counted times the scan's reach.
"""

import math
from collections import namedtuple

import numpy as np

from longreach.geometry._eigen_kernels import symmetric_eigen
from longreach.geometry._kernels import se2_adjoint, se2_between, se2_compose, se2_exp
from longreach.kernels import kernel
from longreach.odometry._match_covariance_kernels import carry_covariance, line_covariance
from longreach.odometry._pyramid_kernels import _atan_ratio
from longreach.odometry._rank_kernels import smallest

LineSettings = namedtuple("LineSettings", "iterations gate grazing worst agree known common")
ROWS = 8  # numbers kept of a matched point


@kernel
def line_rows(x, y, r, cos, sin, increment, beams, lines, pose, grazing, m, rows):
    """Add rows (8, m) of the points that fall on a line of a reference, and return how many there are then.

    pose (3,): of the laser, seen from the reference. beams (n,): which line lies in each direction. A row is the
    derivative a (3,) of the distance e from the line, e, its weight 1/variance over σ², the share of the keyframe's
    noise in the variance of what is estimated, the lever about the line's direction and the variance of that over σ².
    """
    n = len(r)
    px, py, ct, st = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    for u in range(n):
        if r[u] <= 0.0:
            continue
        rx, ry = ct * x[u] - st * y[u], st * x[u] + ct * y[u]
        qx, qy = rx + px, ry + py
        position = u + _atan_ratio(cos[u] * qy - sin[u] * qx, cos[u] * qx + sin[u] * qy) / increment
        v = int(position + 0.5)
        if position < -0.5 or v >= n:
            continue
        v = beams[v]
        if lines[v, 2] <= 0.0:
            continue
        nx, ny, rho = lines[v, 0], lines[v, 1], lines[v, 2]
        q2 = qx * qx + qy * qy
        depth = nx * rx + ny * ry
        incidence = depth / r[u]  # cosine of it; of the keyframe's beam squared:
        incidence2 = rho * rho / q2
        own = incidence * incidence + grazing * grazing
        rows[0, m] = nx * ct + ny * st
        rows[1, m] = ny * ct - nx * st
        rows[2, m] = ny * rx - nx * ry
        rows[3, m] = nx * qx + ny * qy - rho
        rows[4, m] = 1.0 / (own + lines[v, 3] * incidence2)
        # a line's error is that of its beams, which may lie closer on the surface than the new ones, or less close
        rows[5, m] = (incidence2 + grazing * grazing) / own * abs(incidence) * q2 / (r[u] * rho)
        rows[6, m] = depth
        rows[7, m] = lines[v, 4]
        m += 1
    return m


@kernel(fastmath=True)
def move_rows(rows, m, dx, dy, dt):
    """Change the distances e by a small motion ξ of the laser in its own frame: a · ξ."""
    for i in range(m):
        rows[3, i] += rows[0, i] * dx + rows[1, i] * dy + rows[2, i] * dt


@kernel
def robust_scale(rows, m, space):
    """1.4826 times the median of the residuals, each over its own deviation: their σ where most of them are good."""
    step = max(m // 300, 1)
    k = 0
    for i in range(0, m, step):
        space[k] = abs(rows[3, i]) * math.sqrt(rows[4, i])
        k += 1
    return 1.4826 * smallest(space[:k], k // 2)


@kernel(fastmath=True)
def normal_equations(rows, m, limit, reach, H):
    """Fill H (3, 3) with Σ w a aᵀ and return -Σ w a e and Σ (1 - z): w falls from 1/variance to 0 at z = 1. (3.25)"""
    h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = total = 0.0
    scale = 1.0 / reach
    for i in range(m):
        e, w = rows[3, i], rows[4, i]
        share = max(1.0 - e * e * w * limit, 0.0)
        w *= share
        total += share
        a0, a1, a2 = rows[0, i], rows[1, i], scale * rows[2, i]
        h00 += w * a0 * a0
        h01 += w * a0 * a1
        h02 += w * a0 * a2
        h11 += w * a1 * a1
        h12 += w * a1 * a2
        h22 += w * a2 * a2
        g0 += w * a0 * e
        g1 += w * a1 * e
        g2 += w * a2 * e
    H[0, 0], H[0, 1], H[0, 2] = h00, h01, h02
    H[1, 0], H[1, 1], H[1, 2] = h01, h11, h12
    H[2, 0], H[2, 1], H[2, 2] = h02, h12, h22
    return -g0, -g1, -g2, total


@kernel(fastmath=True)
def find_told(rows, m, limit, reach, scale, known, H, V, told):
    """Fill told (3,) with 1 or 0: whether the data determine each direction of the eigenbasis V of H.

    Errors of the lines' directions look like information about motion along them: H = Σ w n nᵀ grows by w σ_φ² t tᵀ.
    A direction is told where H is more than `known` times what it would be from these errors alone.
    """
    largest = max(H[0, 0], max(H[1, 1], H[2, 2]))
    for k in range(3):
        told[k] = 1.0
        if H[k, k] > 0.2 * largest:
            continue
        errors = 0.0
        for i in range(m):
            e, w = rows[3, i], rows[4, i]
            w *= max(1.0 - e * e * w * limit, 0.0) * rows[7, i]
            along = rows[0, i] * V[1, k] - rows[1, i] * V[0, k] + rows[6, i] / reach * V[2, k]
            errors += w * along * along
        if H[k, k] < known * errors * scale * scale + 1e-5 * largest:
            told[k] = 0.0


@kernel
def pull(gx, gy, gt, pose, doubt, reach, scale, V, out):
    """Fill out (2, 3) with the gradient and the weight, in the basis V, of the pull to the guess (x, y, θ).

    doubt (3,): deviation of the guess [m, m, rad]. It is far less sure than most matches, and matters in the others.
    """
    dx, dy, dt = se2_between(gx, gy, gt, pose[0], pose[1], pose[2])
    c, s = math.cos(dt), math.sin(dt)
    off = np.array([c * dx + s * dy, c * dy - s * dx, dt * reach])
    variance = scale * scale
    for k in range(3):
        out[0, k] = out[1, k] = 0.0
        for i in range(3):
            deviation = doubt[i] * (reach if i == 2 else 1.0)
            weight = variance / (deviation * deviation)
            out[0, k] -= V[i, k] * weight * off[i]
            out[1, k] += V[i, k] * V[i, k] * weight


@kernel
def align(
    x, y, r, cos, sin, increment, beams, lines, places, reach, noise, settings, doubt, pose, rows, space, H, V, told
):
    """Move the laser's pose (3,) until the points lie on the lines; leave H diagonal in its eigenbasis V.

    beams (k, n), lines (k, n, 5), places (k, 3): of k references, and where each laser was, seen from the first one's.
    Along directions that are not told the pose stays where it was put. Returns the rows, the scale of the residuals
    and the sum of the robust weights. After a step below a tenth of the noise points stay on their lines.
    """
    m, scale, total, step = 0, 0.0, 0.0, math.inf
    gx, gy, gt = pose[0], pose[1], pose[2]
    prior, d, seen = np.empty((2, 3)), np.empty(3), np.empty(3)
    told[:] = 1.0
    for iteration in range(settings.iterations):
        if step < 0.1 * noise:
            move_rows(rows, m, d[0], d[1], d[2] / reach)
        else:
            m = 0
            for k in range(len(lines)):
                px, py, pt = se2_between(places[k, 0], places[k, 1], places[k, 2], pose[0], pose[1], pose[2])
                seen[0], seen[1], seen[2] = px, py, pt
                m = line_rows(x, y, r, cos, sin, increment, beams[k], lines[k], seen, settings.grazing, m, rows)
        if m < 6:
            return m, 0.0, 0.0
        worst = settings.worst * noise * max(1.0, 10.0 * 0.5**iteration)
        scale = min(max(robust_scale(rows, m, space), 0.5 * noise), worst)
        limit = 1.0 / (settings.gate * scale) ** 2
        g0, g1, g2, total = normal_equations(rows, m, limit, reach, H)
        symmetric_eigen(H, V)
        find_told(rows, m, limit, reach, scale, settings.known, H, V, told)
        pull(gx, gy, gt, pose, doubt, reach, scale, V, prior)
        d[:] = 0.0
        for k in range(3):
            if told[k] > 0.0:
                along = V[0, k] * g0 + V[1, k] * g1 + V[2, k] * g2 + prior[0, k]
                along /= H[k, k] + prior[1, k]
                for i in range(3):
                    d[i] += V[i, k] * along
        dx, dy, dt = se2_exp(d[0], d[1], d[2] / reach)
        pose[0], pose[1], pose[2] = se2_compose(pose[0], pose[1], pose[2], dx, dy, dt)
        step = abs(d[0]) + abs(d[1]) + abs(d[2])
        if step < 0.1 * noise * math.sqrt(3.0 / m) + 1e-9 and iteration > 0:
            break
    return m, scale, total


@kernel
def match_points(
    x, y, r, cos, sin, increment, beams, lines, places, reach, noise, settings, mount, guess, doubt, free,
    pose, covariance, shared, told, V,
):  # fmt: skip
    """Match the points of a scan to the lines of keyframes, starting from a guess (3,) of the base's pose.

    mount (3,): the laser in the base. Fills the base's pose (3,) seen from its pose at the keyframe, the covariance and
    its shared part (3, 3), and told (3,): which columns of V, directions of ξ, the scan tells.
    Returns the rows, the scale of the residuals [m], NaN where something is not finite, and how many rows agree but for
    noise.
    """
    n = len(r)
    rows, space = np.empty((ROWS, n * len(lines))), np.empty(n * len(lines))
    H, local, common = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    ix, iy, it = se2_between(mount[0], mount[1], mount[2], 0.0, 0.0, 0.0)
    gx, gy, gt = se2_compose(guess[0], guess[1], guess[2], mount[0], mount[1], mount[2])
    pose[0], pose[1], pose[2] = se2_compose(ix, iy, it, gx, gy, gt)
    m, scale, total = align(
        x, y, r, cos, sin, increment, beams, lines, places, reach, noise, settings, doubt, pose, rows, space, H, V, told
    )
    if m < 6:
        return m, scale, 0.0
    limit = 1.0 / (settings.gate * settings.agree * noise) ** 2
    total = 0.0
    for i in range(m):
        total += max(1.0 - rows[3, i] * rows[3, i] * rows[4, i] * limit, 0.0)
    line_covariance(rows, m, scale, reach, settings, H, V, told, free, local, common)
    gx, gy, gt = se2_compose(mount[0], mount[1], mount[2], pose[0], pose[1], pose[2])
    pose[0], pose[1], pose[2] = se2_compose(gx, gy, gt, ix, iy, it)
    adjoint = np.empty((3, 3))
    se2_adjoint(mount[0], mount[1], mount[2], adjoint)
    carry_covariance(adjoint, local, covariance)
    carry_covariance(adjoint, common, shared)
    return m, scale if math.isfinite(pose.sum() + covariance.sum()) else math.nan, total
