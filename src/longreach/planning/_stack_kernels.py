"""Compiled errors and Jacobians of the common tasks, one below the other.

A task is a kind and a target, rows of four numbers: a pose (4, 4), or [x, y, θ] or a configuration one number after the
other. T (4, 4) and J (6, n) are those of the tool. A base's q starts with x, y, θ.
"""

import numpy as np

from longreach.geometry import _kernels as geometry
from longreach.kernels import kernel
from longreach.planning import _task_kernels

TOOL_POSE, TOOL_POSITION, TOOL_ORIENTATION, BASE_POSE, BASE_POSITION, BASE_HEADING, POSTURE = range(7)
_FUSED = {"contract"}


@kernel
def rows_of(kind, n):
    """How many rows a task of this kind has."""
    if kind == TOOL_POSE:
        return 6
    if kind == BASE_POSITION:
        return 2
    if kind == BASE_HEADING:
        return 1
    return n if kind == POSTURE else 3


@kernel(fastmath=_FUSED)
def _orientation_error(T_target, T, e):
    """e (3,) = log(R_targetᵀ R)."""
    R = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            R[i, j] = T_target[0, i] * T[0, j] + T_target[1, i] * T[1, j] + T_target[2, i] * T[2, j]
    e[0], e[1], e[2] = geometry.so3_log(R)


@kernel(fastmath=_FUSED)
def _orientation_jacobian(T, J, e, A):
    """A (3, n) = J_r⁻¹(e) Rᵀ J_ω."""
    R, M = np.empty((3, 3)), np.empty((3, 3))
    geometry.so3_left_jacobian_inverse(-e[0], -e[1], -e[2], R)
    for i in range(3):
        for j in range(3):
            M[i, j] = R[i, 0] * T[j, 0] + R[i, 1] * T[j, 1] + R[i, 2] * T[j, 2]
        for k in range(J.shape[1]):
            A[i, k] = M[i, 0] * J[3, k] + M[i, 1] * J[4, k] + M[i, 2] * J[5, k]


@kernel(fastmath=_FUSED)
def _base_jacobian(q, e, A):
    """A (3, n) = J_r⁻¹(e) blkdiag(Rᵀ, 1) of the first three joints, e = log(target⁻¹ base) in SE(2)."""
    geometry.se2_right_jacobian_inverse(e[0], e[1], e[2], A)
    c, s = np.cos(q[2]), np.sin(q[2])
    for i in range(3):
        A[i, 0], A[i, 1] = A[i, 0] * c - A[i, 1] * s, A[i, 0] * s + A[i, 1] * c


@kernel(fastmath=_FUSED)
def errors(kinds, targets, q, T, e):
    """Fill e (M,) with the tasks' errors; targets (tasks, rows, 4)."""
    n, row = len(q), 0
    for i in range(len(kinds)):
        kind, target = kinds[i], targets[i]
        m = rows_of(kind, n)
        if kind == TOOL_POSE:
            _task_kernels.pose_error(target, T, e[row : row + m])
        elif kind == TOOL_POSITION:
            for j in range(3):
                e[row + j] = T[j, 3] - target[j, 3]
        elif kind == TOOL_ORIENTATION:
            _orientation_error(target, T, e[row : row + m])
        elif kind == BASE_POSE:
            x, y, t = geometry.se2_between(target[0, 0], target[0, 1], target[0, 2], q[0], q[1], q[2])
            e[row], e[row + 1], e[row + 2] = geometry.se2_log(x, y, t)
        elif kind == BASE_HEADING:
            e[row] = geometry.wrap(q[2] - target[0, 2])
        else:
            for j in range(m):
                e[row + j] = q[j] - target[j // 4, j % 4]
        row += m


@kernel(fastmath=_FUSED)
def jacobians(kinds, targets, q, T, J, e, A):
    """Fill A (M, n) with the derivatives of the errors e; what is 0 at all times must be 0 already."""
    n, row = len(q), 0
    for i in range(len(kinds)):
        kind = kinds[i]
        m = rows_of(kind, n)
        if kind == TOOL_POSE:
            _task_kernels.pose_jacobian(targets[i], T, J, e[row : row + m], A[row : row + m])
        elif kind == TOOL_POSITION:
            for j in range(3):
                for k in range(n):
                    A[row + j, k] = J[j, k]
        elif kind == TOOL_ORIENTATION:
            _orientation_jacobian(T, J, e[row : row + m], A[row : row + m])
        elif kind == BASE_POSE:
            _base_jacobian(q, e[row : row + m], A[row : row + m])
        elif kind == BASE_HEADING:
            A[row, 2] = 1.0
        else:
            for j in range(m):
                A[row + j, j] = 1.0
        row += m
