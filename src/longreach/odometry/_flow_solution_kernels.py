"""Compiled robust least squares of range flow, with its covariance and the pull to what is expected.

Rows A (3, m), b (m,) of ρ = b + Aᵀ ξ. Weights are Cauchy's, 1/(1 + (kρ)²), or the truncated parabola's, 1 - (kρ)².
"""

import numpy as np

from longreach.geometry._eigen_kernels import solve_in_basis, symmetric_eigen
from longreach.kernels import kernel
from longreach.odometry._rank_kernels import smallest


@kernel(fastmath=True)
def normal_equations(A, b, m, xi, k, truncated, H):
    """Fill H with Σ w a aᵀ and return (-Σ w a b, Σ w ρ²) at the weights w of ξ. (3.25)"""
    x0, x1, x2 = xi[0], xi[1], xi[2]
    h00 = h01 = h02 = h11 = h12 = h22 = g0 = g1 = g2 = squares = 0.0
    k2 = k * k
    for i in range(m):
        a0, a1, a2, bi = A[0, i], A[1, i], A[2, i], b[i]
        residual = bi + a0 * x0 + a1 * x1 + a2 * x2
        z = k2 * residual * residual
        w = max(1.0 - z, 0.0) if truncated else 1.0 / (1.0 + z)
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
def robust_flow(A, b, m, iterations, xi, H, V):
    """Step 6: least squares, then Cauchy IRLS until ξ stands still; leave H diagonal in its eigenbasis V.

    k = 1/(2.385 σ), σ from the mean |ρ| of the first solution: 95 % efficient where the noise is Gaussian. The 2016
    code's k = 10/mean|R_t| looks at a tenth of the noise only: its solution is a mode, three times as noisy here.
    Returns σ², the variance of a weighted residual at the solution, and k.
    """
    k = 0.0
    squares = 0.0
    for i in range(3):
        xi[i] = 0.0
    for iteration in range(iterations + 1):
        g0, g1, g2, squares = normal_equations(A, b, m, xi, k, False, H)
        symmetric_eigen(H, V)
        b0, b1, b2 = xi[0], xi[1], xi[2]
        solve_in_basis(H, V, g0, g1, g2, xi)
        change = abs(xi[0] - b0) + abs(xi[1] - b1) + abs(xi[2] - b2)
        size = abs(xi[0]) + abs(xi[1]) + abs(xi[2])
        if iteration == 0:
            total = 0.0
            for i in range(m):
                total += abs(b[i] + A[0, i] * xi[0] + A[1, i] * xi[1] + A[2, i] * xi[2])
            k = 1.0 / (2.385 * 1.2533 * max(total / m, 1e-9))
        elif change < 1e-3 * size + 1e-6:
            break
    _, _, _, squares = normal_equations(A, b, m, xi, k, False, H)
    symmetric_eigen(H, V)
    return squares / max(m - 3, 1), k


@kernel(fastmath=True)
def truncated_energy(A, b, m, xi, k):
    """Return Σ of the smooth truncated parabola of each ρ, in units of where it ends: z (1 - z/2), and 1/2 beyond."""
    total = 0.0
    for i in range(m):
        residual = k * (b[i] + A[0, i] * xi[0] + A[1, i] * xi[1] + A[2, i] * xi[2])
        z = min(residual * residual, 1.0)
        total += z * (1.0 - 0.5 * z)
    return total


@kernel
def truncated_flow(A, b, m, iterations, xi, H, V, space):
    """Least squares, then IRLS with the truncated parabola until its energy falls by less than 0.5 %. (SRF 2018)

    It ends at four times the median |ρ| of the first solution. Leaves H diagonal in its eigenbasis V.
    Returns the variance of a weighted residual at the solution, and k, 1 over where the parabola ends.
    """
    xi[:] = 0.0
    k = energy = squares = 0.0
    for iteration in range(iterations + 1):
        g0, g1, g2, squares = normal_equations(A, b, m, xi, k, True, H)
        symmetric_eigen(H, V)
        solve_in_basis(H, V, g0, g1, g2, xi)
        if iteration == 0:
            step, n = max(m // 300, 1), 0
            for i in range(0, m, step):
                space[n] = abs(b[i] + A[0, i] * xi[0] + A[1, i] * xi[1] + A[2, i] * xi[2])
                n += 1
            k = 1.0 / max(4.0 * smallest(space[:n], n // 2), 1e-6)
        last, energy = energy, truncated_energy(A, b, m, xi, k)
        if iteration > 0 and energy > 0.995 * last:
            break
    _, _, _, squares = normal_equations(A, b, m, xi, k, True, H)
    symmetric_eigen(H, V)
    return squares / max(m - 3, 1), k


@kernel(fastmath=True)
def flow_covariance(A, b, m, xi, k, truncated, lags, H, V, scores, covariance):
    """Fill covariance (3, 3) of ξ from what the residuals are, not from what they should be.

    The sandwich H⁻¹ S H⁻¹, with S the long-run covariance of the scores w ρ a over `lags` neighbouring rows (Bartlett
    window, Newey & West 1987): smoothing and surfaces make neighbours err together, and rows differ in noise.
    H counts w where the curvature of the cost is w (2w - 1), or 3w - 2; `steepness` makes up for it.
    """
    k2 = k * k
    curvature = weights = 0.0
    for i in range(m):
        residual = b[i] + A[0, i] * xi[0] + A[1, i] * xi[1] + A[2, i] * xi[2]
        z = k2 * residual * residual
        share = max(1.0 - z, 0.0) if truncated else 1.0 / (1.0 + z)
        if share > 0.0:
            curvature += 3.0 * share - 2.0 if truncated else share * (2.0 * share - 1.0)
        weights += share
        w = residual * share
        for j in range(3):
            scores[j, i] = w * (A[0, i] * V[0, j] + A[1, i] * V[1, j] + A[2, i] * V[2, j])
    steepness = weights / max(curvature, 0.1 * weights)
    S = np.zeros((3, 3))
    for p in range(3):
        for q in range(p, 3):
            total = 0.0
            for i in range(m):
                total += scores[p, i] * scores[q, i]
            for lag in range(1, min(lags, m - 1) + 1):
                part = 0.0
                for i in range(m - lag):
                    part += scores[p, i] * scores[q, i + lag] + scores[p, i + lag] * scores[q, i]
                total += part * (1.0 - lag / (lags + 1.0))
            S[p, q] = S[q, p] = total * m / max(m - 3.0, 1.0) * steepness * steepness
    floor = 1e-12 * max(H[0, 0], max(H[1, 1], H[2, 2])) + 1e-300
    for i in range(3):
        for j in range(3):
            S[i, j] /= max(H[i, i], floor) * max(H[j, j], floor)
    for i in range(3):
        for j in range(3):
            total = 0.0
            for p in range(3):
                for q in range(3):
                    total += V[i, p] * S[p, q] * V[j, q]
            covariance[i, j] = total


@kernel
def blend(xi, H, V, variance, expected, c, d, covariance):
    """Step 8: in the covariance's eigenbasis draw ξ to the expected one, the more the less the data say.

    What the pull moved is added to the covariance, squared: it may be wrong by as much.
    """
    floor = 1e-12 * max(H[0, 0], max(H[1, 1], H[2, 2])) + 1e-300
    m0, m1, m2 = xi[0], xi[1], xi[2]
    for j in range(3):
        xi[j] = 0.0
    for i in range(3):
        pull = c * variance / max(H[i, i], floor) + d
        found = V[0, i] * m0 + V[1, i] * m1 + V[2, i] * m2
        prior = V[0, i] * expected[0] + V[1, i] * expected[1] + V[2, i] * expected[2]
        along = (found + pull * prior) / (1.0 + pull)
        moved = along - found
        for j in range(3):
            xi[j] += V[j, i] * along
            for l in range(3):
                covariance[j, l] += V[j, i] * V[l, i] * moved * moved
