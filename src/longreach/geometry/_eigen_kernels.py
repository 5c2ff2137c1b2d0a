"""Compiled eigenvectors of a symmetric 3 x 3 matrix, and the least-squares solution in their basis."""

import math

from longreach.kernels import kernel


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
def solve_in_basis(values, V, g0, g1, g2, xi):
    """ξ = Σ v (vᵀ g) / λ over the directions that the data determine."""
    floor = 1e-12 * max(values[0, 0], max(values[1, 1], values[2, 2]))
    for i in range(3):
        xi[i] = 0.0
    for i in range(3):
        if values[i, i] > floor:
            along = (V[0, i] * g0 + V[1, i] * g1 + V[2, i] * g2) / values[i, i]
            for j in range(3):
                xi[j] += V[j, i] * along
