"""Compiled covariance of a match of points to lines, from what the residuals are at its solution.

The sandwich H⁻¹ S H⁻¹ of robust statistics (Huber & Ronchetti 2009, chapter 7) about Censi's closed form of 2007, with
the keyframe's noise, surfaces that are not straight, and directions that the lines do not tell.
"""

import numpy as np

from longreach.kernels import kernel

_SURFACE = 16  # neighbouring rows whose residuals may agree
_LINE = 32  # rows that share a line at most


@kernel
def lean(rows, m, limit, reach, H, V, k, out):
    """Fill out (3,) with the variance of the angle [rad²] by which V's column k leans to the others: lines' errors.

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


@kernel(fastmath=True)
def score_sums(rows, m, limit, reach, V, block, scores, S, shared):
    """Fill S and shared (3, 3), in the basis V: the covariance of the scores Σ ψ a, and the keyframe's part in it.

    ψ² is what the residuals are, not what they should be. Residuals that agree over `block` neighbouring rows, as those
    of a surface do that is not straight, do not average out: S grows by as much. Returns how much flatter the cost is
    than H says, for H counts w where the curvature is that of ψ = e (1 - z): 1 - 3z.
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
def line_covariance(rows, m, scale, reach, settings, H, V, told, free, covariance, shared):
    """Fill covariance and shared (3, 3) of the laser's ξ: the sandwich H⁻¹ S H⁻¹, wide along what is not told.

    free (3,): variance of x, y [m²] and θ [rad²] where nothing is known. A part `common` of the noise is taken to be
    common to all beams: it does not average out.
    """
    limit = 1.0 / (settings.gate * scale) ** 2
    S, K = np.zeros((3, 3)), np.zeros((3, 3))
    for k in range(3):
        S[k, k] = H[k, k] * H[k, k] if told[k] > 0.0 else 1e300  # sums of scores count by what they move the pose
    flatness = score_sums(rows, m, limit, reach, V, _SURFACE, np.zeros(3), S, K)
    units = np.array([1.0, 1.0, 1.0 / reach])
    bias, angles = settings.common * scale, np.empty(3)
    for k in range(3):
        for l in range(3):
            both = told[k] * told[l] * flatness * flatness / (H[k, k] * H[l, l])
            S[k, l] *= both
            K[k, l] *= both
        S[k, k] += bias * bias
    for k in range(3):
        if told[k] > 0.0:
            continue
        wide = 0.0
        for i in range(3):
            wide += V[i, k] * V[i, k] * free[i] / (units[i] * units[i])
        S[k, k] += wide
        lean(rows, m, limit, reach, H, V, k, angles)
        for l in range(3):
            S[l, l] += told[l] * wide * angles[l]
    for i in range(3):
        for j in range(3):
            covariance[i, j] = shared[i, j] = 0.0
            for k in range(3):
                for l in range(3):
                    covariance[i, j] += units[i] * V[i, k] * S[k, l] * V[j, l] * units[j]
                    shared[i, j] += units[i] * V[i, k] * K[k, l] * V[j, l] * units[j]


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
