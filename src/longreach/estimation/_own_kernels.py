"""Compiled split of a match's covariance: what is its own beside what it has in common with others."""

import numpy as np

from longreach.estimation._cholesky_kernels import cholesky
from longreach.geometry._eigen_kernels import symmetric_eigen
from longreach.geometry._kernels import se2_adjoint, se2_between
from longreach.kernels import kernel


@kernel
def own_part(C, pose, shared, least, out):
    """Fill out (3, 3) with C - Ad(pose⁻¹) shared Ad(pose⁻¹)ᵀ, but in every direction at least the part `least` of C.

    In the basis where C is the identity both are diagonal: the generalised eigenvalues w of what is taken off become
    max(1 - w, least). Returns False where C is not positive definite.
    """
    A, L, V = np.empty((3, 3)), np.zeros((3, 3)), np.empty((3, 3))
    if not cholesky(C, L):
        return False
    x, y, t = se2_between(pose[0], pose[1], pose[2], 0.0, 0.0, 0.0)
    se2_adjoint(x, y, t, A)
    for j in range(3):  # A := L⁻¹ A
        for i in range(3):
            for k in range(i):
                A[i, j] -= L[i, k] * A[k, j]
            A[i, j] /= L[i, i]
    W = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for l in range(3):
                    W[i, j] += A[i, k] * shared[k, l] * A[j, l]
    symmetric_eigen(W, V)
    out[:] = 0.0
    for k in range(3):
        part = max(1.0 - W[k, k], least)
        for i in range(3):
            for j in range(3):
                a = b = 0.0
                for l in range(3):
                    a += L[i, l] * V[l, k]
                    b += L[j, l] * V[l, k]
                out[i, j] += part * a * b
    return True
