"""Compiled point-to-line matching: the points of a scan against the surfaces of a local map, with its covariance.

ξ is the error of the base's pose in its own frame. To be compared with metres, θ is counted times the scan's reach.
The covariance is the sandwich H⁻¹ S H⁻¹ of robust statistics (Huber & Ronchetti 2009, chapter 7) about Censi's closed
form of 2007, with the map's noise, surfaces that are not straight, and directions that the surfaces leave open.
"""

import math
from collections import namedtuple

import numpy as np

from longreach.geometry._eigen_kernels import symmetric_eigen
from longreach.geometry._kernels import se2_between, se2_compose, se2_exp, wrap
from longreach.kernels import kernel
from longreach.odometry._local_map_kernels import surface_rows
from longreach.odometry.matchers._feature_kernels import smallest

FitSettings = namedtuple("FitSettings", "iterations gate grazing worst flat known chance common surface coarse fine")
ROWS = 8  # numbers kept of a matched point
_AGREE = 6.0  # residuals that agree, about: a point shows less than its scatter says, against the prior
_SURFACE = 16  # neighbouring rows whose residuals may agree
_LINE = 32  # rows that share a line at most
_FEW = 150  # points that the coarse fit takes
_NEAR = 0.1  # [m]: a prior this sure needs no coarse fit


@kernel(fastmath=True)
def move_rows(rows, m, dx, dy, dt):
    """Change the distances e by a small motion ξ of the base in its own frame: a · ξ."""
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
    """Fill H (3, 3) with Σ w a aᵀ and return -Σ w a e: w falls from 1/variance to 0 at z = 1. (3.25)"""
    h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = 0.0
    scale = 1.0 / reach
    for i in range(m):
        e, w = rows[3, i], rows[4, i]
        w *= max(1.0 - e * e * w * limit, 0.0)
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
    return -g0, -g1, -g2


@kernel
def shown(points, m, reach, V, k):
    """Return Σ (n · v)² over the returns of a scan, v column k of V; where a normal is not known, its mean."""
    total, unknown = 0.0, 0.5 * (V[0, k] * V[0, k] + V[1, k] * V[1, k])
    for u in range(m):
        x, y, nx, ny = points[0, u], points[1, u], points[5, u], points[6, u]
        along = nx * V[0, k] + ny * V[1, k] + (x * ny - y * nx) / reach * V[2, k]
        total += along * along if points[7, u] < math.inf else unknown
    return total


@kernel(fastmath=True)
def find_observable(points, count, rows, m, limit, reach, scale, known, agrees, H, V, observable):
    """Fill observable (3,) with 1 or 0: whether the data determine each direction of the eigenbasis V of H.

    Errors of the surfaces' directions look like information about motion along them: H = Σ w n nᵀ grows by w σ_φ² t tᵀ.
    It has to be more than `known` times what it would be from these alone. Returns lie near a surface by chance, too.
    Their residuals are anywhere up to the limit, and the cost is flat: its curvature Σ w (1 - 3z) (a · v)² has to be a
    third of H. And of Σ (n · v)² over all returns of the scan the part `agrees` has to come from those that agree.
    """
    largest = max(H[0, 0], max(H[1, 1], H[2, 2]))
    for k in range(3):
        observable[k] = 1.0
        if H[k, k] > 0.2 * largest:
            continue
        errors = agree = curvature = 0.0
        for i in range(m):
            e, w = rows[3, i], rows[4, i]
            z = e * e * w * limit
            if z < 1.0:
                across = rows[0, i] * V[1, k] - rows[1, i] * V[0, k] + rows[6, i] / reach * V[2, k]
                errors += w * (1.0 - z) * rows[7, i] * across * across
                along = rows[0, i] * V[0, k] + rows[1, i] * V[1, k] + rows[2, i] / reach * V[2, k]
                agree += (1.0 - z) * along * along
                curvature += w * (1.0 - 3.0 * z) * along * along
        by_chance = agrees > 0.0 and (curvature < H[k, k] / 3.0 or agree < agrees * shown(points, count, reach, V, k))
        if H[k, k] < known * errors * scale * scale + 1e-5 * largest or by_chance:
            observable[k] = 0.0


@kernel
def prior_pull(prior, pose, reach, scale, V, out):
    """Fill out (2, 3) with the gradient and the weight of the prior in the basis V; it is wider than most matches."""
    dx, dy, dt = se2_between(prior.pose[0], prior.pose[1], prior.pose[2], pose[0], pose[1], pose[2])
    c, s = math.cos(dt), math.sin(dt)
    off = np.array([c * dx + s * dy, c * dy - s * dx, dt * reach])
    variance = _AGREE * scale * scale
    for k in range(3):
        out[0, k] = out[1, k] = 0.0
        for i in range(3):
            deviation = prior.sigma[i] * (reach if i == 2 else 1.0)
            weight = variance / (deviation * deviation)
            out[0, k] -= V[i, k] * weight * off[i]
            out[1, k] += V[i, k] * V[i, k] * weight


@kernel
def align(points, m, reach, noise, settings, prior, surfaces, pose, rows, space, H, V, observable):
    """Move the base's pose (3,) until the points lie on the surfaces; leave H diagonal in its eigenbasis V.

    First a few points on surfaces taken over a wide radius, then all of them. Along directions that are not observable
    the pose is the prior's. After a step below a tenth of the noise points stay on their surfaces.
    Returns the rows and the scale of the residuals.
    """
    n, scale, step = 0, 0.0, math.inf
    pull, d, sigma = np.empty((2, 3)), np.empty(3), prior.sigma
    observable[:] = 1.0
    is_settled = False
    coarse, wide, agrees = sigma[0] + sigma[1] + reach * sigma[2] > _NEAR, 1.0, 0.0
    for iteration in range(settings.iterations):
        radius, stride = (settings.coarse, max(m // _FEW, 1)) if coarse else (settings.fine, 1)
        if step < 0.1 * noise and not coarse:
            is_settled, agrees = True, settings.chance  # from here on residuals are small where they are at all
            move_rows(rows, n, d[0], d[1], d[2] / reach)
        else:
            n = surface_rows(points, m, stride, pose, surfaces, radius, settings.grazing, rows)
        if n < 6:
            return n, 0.0
        least = settings.flat * (5.0 if coarse else max(5.0 * wide, 1.0))
        wide *= 1.0 if coarse else 0.5
        worst = max(settings.worst * noise, least)
        scale = min(max(robust_scale(rows, n, space), least), worst)
        limit = 1.0 / (settings.gate * scale) ** 2
        g0, g1, g2 = normal_equations(rows, n, limit, reach, H)
        symmetric_eigen(H, V)
        find_observable(points, m, rows, n, limit, reach, scale, settings.known, agrees, H, V, observable)
        prior_pull(prior, pose, reach, scale, V, pull)
        d[:] = 0.0
        for k in range(3):
            along, weight = pull[0, k], pull[1, k]
            if observable[k] > 0.0:
                along += V[0, k] * g0 + V[1, k] * g1 + V[2, k] * g2
                weight += H[k, k]
            for i in range(3):
                d[i] += V[i, k] * along / weight
        dx, dy, dt = se2_exp(d[0], d[1], d[2] / reach)
        pose[0], pose[1], pose[2] = se2_compose(pose[0], pose[1], pose[2], dx, dy, dt)
        step = abs(d[0]) + abs(d[1]) + abs(d[2])
        if coarse:
            if step < noise or iteration >= settings.iterations // 3:
                coarse, step = False, math.inf
        elif is_settled and step < 0.1 * noise * math.sqrt(3.0 / n) + 1e-9:
            break
    return n, scale


@kernel
def lean(rows, m, limit, reach, H, V, k, out):
    """Fill out (3,) with the variance of the angle [rad²] by which V's column k leans to the others: surfaces' errors.

    Σ w (a · v_l)(a · v_k) is 0 in the eigenbasis; how much it is over blocks of rows tells what it would be elsewhere.
    """
    sums = np.zeros(3)
    out[:] = 0.0
    for i in range(m):
        e, w = rows[3, i], rows[4, i]
        w *= max(1.0 - e * e * w * limit, 0.0)
        a0, a1, a2 = rows[0, i], rows[1, i], rows[2, i] / reach
        along = w * (a0 * V[0, k] + a1 * V[1, k] + a2 * V[2, k])
        for l in range(3):
            sums[l] += along * (a0 * V[0, l] + a1 * V[1, l] + a2 * V[2, l])
        if i % _LINE == _LINE - 1 or i == m - 1:
            for l in range(3):
                out[l] += sums[l] * sums[l]
                sums[l] = 0.0
    for l in range(3):
        out[l] = out[l] / (H[l, l] * H[l, l]) if l != k else 0.0


@kernel
def offsets(rows, m, limit, reach, H, V, deviation, observable, S):
    """Add to S (3, 3), in the basis V, what an error of a deviation [m] gives that each line of rows has in common."""
    sums = np.zeros(3)
    for i in range(m):
        e, w = rows[3, i], rows[4, i]
        w *= max(1.0 - e * e * w * limit, 0.0)
        for k in range(3):
            sums[k] += w * (rows[0, i] * V[0, k] + rows[1, i] * V[1, k] + rows[2, i] / reach * V[2, k])
        if i % _LINE == _LINE - 1 or i == m - 1:
            for k in range(3):
                for l in range(k + 1):
                    S[k, l] += (
                        deviation * deviation * sums[k] * sums[l] * observable[k] * observable[l] / (H[k, k] * H[l, l])
                    )
                    S[l, k] = S[k, l]
            sums[:] = 0.0


@kernel(fastmath=True)
def score_sums(rows, m, limit, reach, V, block, scores, S, shared):
    """Fill S and shared (3, 3), in the basis V: the covariance of the scores Σ ψ a, and the map's part in it.

    Residuals that agree over `block` neighbouring rows, as those of a surface that is not straight, do not average out:
    S grows by as much. Returns how much flatter the cost is than H says: the curvature of ψ = e (1 - z) is 1 - 3z.
    """
    own = np.zeros((3, 3))
    sums = np.zeros(3)
    blocks = plain = curvature = total = 0.0
    for i in range(m):
        e, w = rows[3, i], rows[4, i]
        z = e * e * w * limit
        if z < 1.0:
            curvature += 1.0 - 3.0 * z
            total += 1.0 - z
            psi = w * (1.0 - z) * e
            a2 = rows[2, i] / reach
            for k in range(3):
                scores[k] = psi * (rows[0, i] * V[0, k] + rows[1, i] * V[1, k] + a2 * V[2, k])
                sums[k] += scores[k]
            for k in range(3):
                for l in range(k + 1):
                    own[k, l] += scores[k] * scores[l]
                    shared[k, l] += rows[5, i] * scores[k] * scores[l]
        if i % block == block - 1 or i == m - 1:
            for k in range(3):
                blocks += sums[k] * sums[k] / S[k, k]
                sums[k] = 0.0
    for k in range(3):
        plain += (own[k, k] + shared[k, k]) / S[k, k]
    growth = max(blocks / max(plain, 1e-300), 1.0)
    for k in range(3):
        for l in range(k + 1):
            shared[k, l] *= growth
            S[k, l] = own[k, l] * growth + shared[k, l]
            S[l, k], shared[l, k] = S[k, l], shared[k, l]
    return total / max(curvature, 0.3 * total)


@kernel
def sandwich(rows, m, scale, reach, settings, prior, H, V, observable, covariance, shared):
    """Fill covariance and shared (3, 3) of the base's ξ: the sandwich H⁻¹ S H⁻¹, wide along what is not observable.

    Along it the pose is astray as far as the prior, which surfaces whose directions are wrong turn into errors of the
    other directions. A part `common` of the noise is taken to be common to all beams, and a part `surface` to
    those that see one line: these do not average out.
    """
    limit = 1.0 / (settings.gate * scale) ** 2
    S, K = np.zeros((3, 3)), np.zeros((3, 3))
    for k in range(3):
        S[k, k] = H[k, k] * H[k, k] if observable[k] > 0.0 else 1e300  # sums of scores count by what they move the pose
    flatness = score_sums(rows, m, limit, reach, V, _SURFACE, np.zeros(3), S, K)
    units = np.array([1.0, 1.0, 1.0 / reach])
    bias, angles = settings.common * scale, np.empty(3)
    for k in range(3):
        for l in range(3):
            both = observable[k] * observable[l] * flatness * flatness / (H[k, k] * H[l, l])
            S[k, l] *= both
            K[k, l] *= both
        S[k, k] += bias * bias
    if settings.surface > 0.0:
        offsets(rows, m, limit, reach, H, V, settings.surface * scale, observable, S)
    for k in range(3):
        if observable[k] > 0.0:
            continue
        wide = off = 0.0
        for i in range(3):
            wide += V[i, k] * V[i, k] * prior.free[i] / (units[i] * units[i])
            off += V[i, k] * V[i, k] * prior.astray[i] / (units[i] * units[i])
        S[k, k] += wide
        lean(rows, m, limit, reach, H, V, k, angles)
        for l in range(3):
            S[l, l] += observable[l] * off * angles[l]
    for i in range(3):
        for j in range(i + 1):
            covariance[i, j] = shared[i, j] = 0.0
            for k in range(3):
                for l in range(3):
                    covariance[i, j] += units[i] * V[i, k] * S[k, l] * V[j, l] * units[j]
                    shared[i, j] += units[i] * V[i, k] * K[k, l] * V[j, l] * units[j]
            covariance[j, i], shared[j, i] = covariance[i, j], shared[i, j]


@kernel
def match(points, m, reach, noise, settings, start, prior, surfaces):
    """Match the points of a scan to the surfaces of a local map, starting at a pose (3,), under a `Prior`.

    Returns the base's pose (3,) in the map, the covariance and the map's share in it (3, 3), the directions (k, 3) of ξ
    that the scan does not show, the rows, the scale of the residuals [m], NaN where something is not finite, and how
    many rows agree but for noise.
    """
    rows, space = np.empty((ROWS, m)), np.empty(m)
    H, V, observable = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    pose, covariance, shared = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    pose[0], pose[1], pose[2] = start[0], start[1], start[2]
    n, scale = align(points, m, reach, noise, settings, prior, surfaces, pose, rows, space, H, V, observable)
    if n < 6:
        return pose, covariance, shared, np.empty((0, 3)), n, scale, 0.0
    limit = 1.0 / (settings.gate * noise) ** 2
    total = 0.0
    for i in range(n):
        total += max(1.0 - rows[3, i] * rows[3, i] * rows[4, i] * limit, 0.0)
    sandwich(rows, n, scale, reach, settings, prior, H, V, observable, covariance, shared)
    directions, blind = np.empty((3, 3)), 0
    for k in range(3):
        if observable[k] == 0.0:
            dx, dy, dt = V[0, k], V[1, k], V[2, k] / reach
            size = math.sqrt(dx * dx + dy * dy + dt * dt)
            directions[blind, 0], directions[blind, 1], directions[blind, 2] = dx / size, dy / size, dt / size
            blind += 1
    scale = scale if math.isfinite(pose.sum() + covariance.sum()) else math.nan
    return pose, covariance, shared, directions[:blind], n, scale, total


@kernel
def is_far(poses, pose, distance, turned):
    """Whether all poses (k, 3) are further than a distance [m], or than an angle [rad], from a pose (3,)."""
    for i in range(len(poses)):
        dx, dy = poses[i, 0] - pose[0], poses[i, 1] - pose[1]
        if math.hypot(dx, dy) <= distance and abs(wrap(poses[i, 2] - pose[2])) <= turned:
            return False
    return True
