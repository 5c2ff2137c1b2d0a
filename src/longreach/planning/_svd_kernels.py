"""Compiled singular values of a small matrix by Jacobi's rotations from one side.

The rows of [J | I] are rotated pairwise until those of J are at right angles: then row i is [σ_i v_iᵀ | u_iᵀ]. It finds
small singular values and their directions to full relative precision, which the eigenvalues of J Jᵀ cannot, and its
directions are orthonormal to the last digit, which makes I - Σ v vᵀ a projector.

Source: Hestenes 1958; Golub & Van Loan, "Matrix Computations", 4th edition, section 8.6.3; the order of de Rijk 1989.
"""

import math

from longreach.kernels import kernel

_ORTHOGONAL = 4e-15  # cosine between two rows that counts as none
_NOTHING = 1e-30  # squared length of a row, as a part of all rows', that is rounding
_SWEEPS = 30  # 4 to 6 are used


@kernel(fastmath={"contract", "reassoc"})
def _dot(A, i, j, n):
    total = 0.0
    for k in range(n):
        total += A[i, k] * A[j, k]
    return total


@kernel(fastmath={"contract", "reassoc"})
def _swap(A, s, p, q):
    s[p], s[q] = s[q], s[p]
    for k in range(A.shape[1]):
        A[p, k], A[q, k] = A[q, k], A[p, k]


@kernel(fastmath={"contract", "reassoc"})
def _rotate(A, s, p, q, g):
    """Turn rows p and q, s[p] >= s[q] their squared lengths and g their product, to a right angle."""
    ratio = (s[p] - s[q]) / (2.0 * g)
    t = math.copysign(1.0, g) / (abs(ratio) + math.sqrt(1.0 + ratio * ratio))
    c = 1.0 / math.sqrt(1.0 + t * t)
    z = c * t
    for k in range(A.shape[1]):
        a, b = A[p, k], A[q, k]
        A[p, k] = c * a + z * b
        A[q, k] = c * b - z * a
    s[p] += t * g
    s[q] -= t * g


@kernel(fastmath={"contract", "reassoc"})
def svd(J, A, s):
    """J (m, n) = Σ σ u vᵀ: rows of A (m, n + m) become [σ_i v_iᵀ | u_iᵀ], s (m,) the σ in descending order."""
    m, n = J.shape
    total = 0.0
    for i in range(m):
        for k in range(n):
            A[i, k] = J[i, k]
        for k in range(m):
            A[i, n + k] = 1.0 if k == i else 0.0
        s[i] = _dot(A, i, i, n)
        total += s[i]
    for _ in range(_SWEEPS):
        turned = False
        for p in range(m - 1):
            for q in range(p + 1, m):
                if s[q] > s[p]:
                    _swap(A, s, p, q)
                g = _dot(A, p, q, n)
                if s[q] > _NOTHING * total and g * g > _ORTHOGONAL * _ORTHOGONAL * s[p] * s[q]:
                    _rotate(A, s, p, q, g)
                    turned = True
        if not turned:
            break
        for i in range(m):
            s[i] = _dot(A, i, i, n)
    for i in range(m):
        s[i] = math.sqrt(_dot(A, i, i, n))
