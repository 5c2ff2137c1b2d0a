"""Compiled errors of a tool pose against its target, with their derivatives with respect to the joints.

T_rel = T_target⁻¹ T is how the tool stands as seen from its target; δ = [Rᵀ; Rᵀ] J dq moves it in its own frame. With
w = log R_rel, p its translation and A(w) = J_r⁻¹ of SO(3), the error is e = [ρ; w], ρ = V⁻¹(w) p, and

    dρ = A Rᵀ J_v dq + D A Rᵀ J_ω dq,    dw = A Rᵀ J_ω dq,    D = ∂(V⁻¹(w) p)/∂w,

which is J_r⁻¹(e) of SE(3) without its matrices.
"""

import math

import numpy as np

from longreach.geometry._kernels import so3_log
from longreach.kernels import kernel

_SMALL = 0.3  # [rad]; the series below are good to 1e-16 there


@kernel
def _v_inverse_terms(t2):
    """E of V⁻¹(w) = I - ½[w] + E [w]² and E'(|w|)/|w|, from |w|²."""
    if t2 < _SMALL * _SMALL:  # |B_2k| t^(2k-2) / (2k)!
        E = 1 / 12 + t2 * (1 / 720 + t2 * (1 / 30240 + t2 * (1 / 1209600 + t2 * (1 / 47900160 + t2 * 5.28419e-10))))
        slope = 1 / 360 + t2 * (1 / 7560 + t2 * (1 / 201600 + t2 * (1 / 5987520 + t2 * (5.28419e-9))))
        return E, slope
    t = math.sqrt(t2)
    cot, sin = 1.0 / math.tan(0.5 * t), math.sin(0.5 * t)
    E = (1.0 - 0.5 * t * cot) / t2
    return E, (0.5 * t * cot + 0.25 * t2 / (sin * sin) - 2.0) / (t2 * t2)


@kernel
def _relative(T_target, T, R, p):
    """R (3, 3) and p (3,) of T_target⁻¹ T."""
    for i in range(3):
        p[i] = 0.0
        for k in range(3):
            p[i] += T_target[k, i] * (T[k, 3] - T_target[k, 3])
        for j in range(3):
            R[i, j] = T_target[0, i] * T[0, j] + T_target[1, i] * T[1, j] + T_target[2, i] * T[2, j]


@kernel
def pose_error(T_target, T, e):
    """e (6,) = log(T_target⁻¹ T) (4.28)."""
    room = np.empty((4, 3))
    R, p = room[:3], room[3]
    _relative(T_target, T, R, p)
    wx, wy, wz = so3_log(R)
    t2 = wx * wx + wy * wy + wz * wz
    E, _ = _v_inverse_terms(t2)
    along = wx * p[0] + wy * p[1] + wz * p[2]
    e[0] = (1.0 - E * t2) * p[0] - 0.5 * (wy * p[2] - wz * p[1]) + E * along * wx
    e[1] = (1.0 - E * t2) * p[1] - 0.5 * (wz * p[0] - wx * p[2]) + E * along * wy
    e[2] = (1.0 - E * t2) * p[2] - 0.5 * (wx * p[1] - wy * p[0]) + E * along * wz
    e[3], e[4], e[5] = wx, wy, wz


@kernel
def _plus_cross(diagonal, scale, x, y, z, out):
    """out = diagonal · I + scale · [x y z]×."""
    out[0, 0], out[0, 1], out[0, 2] = diagonal, -scale * z, scale * y
    out[1, 0], out[1, 1], out[1, 2] = scale * z, diagonal, -scale * x
    out[2, 0], out[2, 1], out[2, 2] = -scale * y, scale * x, diagonal


@kernel
def _times(A, B, transposed, out):
    """out = A B, or A Bᵀ with B a larger matrix's first three rows and columns."""
    for i in range(3):
        for j in range(3):
            if transposed:
                out[i, j] = A[i, 0] * B[j, 0] + A[i, 1] * B[j, 1] + A[i, 2] * B[j, 2]
            else:
                out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@kernel
def _carry(A, B, T, J, M, N, J_e):
    """J_e = [[A, B], [0, A]] blkdiag(Rᵀ, Rᵀ) J, R the rotation of T; M and N (3, 3) are room."""
    _times(A, T, True, M)
    _times(B, T, True, N)
    for i in range(3):
        for k in range(J.shape[1]):
            J_e[i, k] = (
                M[i, 0] * J[0, k] + M[i, 1] * J[1, k] + M[i, 2] * J[2, k]
                + N[i, 0] * J[3, k] + N[i, 1] * J[4, k] + N[i, 2] * J[5, k]
            )  # fmt: skip
            J_e[3 + i, k] = M[i, 0] * J[3, k] + M[i, 1] * J[4, k] + M[i, 2] * J[5, k]


@kernel
def pose_error_and_jacobian(T_target, T, J, e, J_e):
    """e (6,) = log(T_target⁻¹ T) and its derivative."""
    pose_error(T_target, T, e)
    pose_jacobian(T_target, T, J, e, J_e)


@kernel
def pose_jacobian(T_target, T, J, e, J_e):
    """J_e (6, n) = J_r⁻¹(e) blkdiag(Rᵀ, Rᵀ) J at the error e, J (6, n) the world-aligned Jacobian."""
    room = np.empty((6, 3, 3))
    A, D, DA, R, p = room[0], room[1], room[2], room[3], room[4, 0]
    _relative(T_target, T, R, p)
    w = e[3:]
    t2 = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    E, slope = _v_inverse_terms(t2)
    along = w[0] * p[0] + w[1] * p[1] + w[2] * p[2]
    _plus_cross(1.0 - E * t2, 0.5, w[0], w[1], w[2], A)
    _plus_cross(E * along, 0.5, p[0], p[1], p[2], D)
    for i in range(3):
        f = slope * (along * w[i] - t2 * p[i]) - 2.0 * E * p[i]
        for j in range(3):
            A[i, j] += E * w[i] * w[j]
            D[i, j] += E * w[i] * p[j] + f * w[j]
    _times(D, A, False, DA)
    _carry(A, DA, T, J, R, room[5], J_e)


@kernel
def cross_error_and_jacobian(T_target, T, J, e, J_e):
    """The same with e = [R_targetᵀ (p - p_target); tan φ · axis] of (3.17), (3.18)."""
    R, p = np.empty((3, 3)), np.empty(3)
    A = np.empty((3, 3))
    _relative(T_target, T, R, p)
    cos = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    w = e[3:]  # sin φ · axis until it is divided by cos φ
    w[0], w[1], w[2] = 0.5 * (R[2, 1] - R[1, 2]), 0.5 * (R[0, 2] - R[2, 0]), 0.5 * (R[1, 0] - R[0, 1])
    for i in range(3):
        for j in range(3):
            trace = 2.0 * cos + 1.0 if i == j else 0.0
            A[i, j] = (0.5 * (trace - R[j, i]) + w[i] * w[j] / cos) / cos
    for i in range(3):
        e[i], w[i] = p[i], w[i] / cos
    M, N = np.empty((3, 3)), np.empty((3, 3))
    _times(R, T, True, M)
    _times(A, T, True, N)
    for i in range(3):
        for k in range(J.shape[1]):
            J_e[i, k] = M[i, 0] * J[0, k] + M[i, 1] * J[1, k] + M[i, 2] * J[2, k]
            J_e[3 + i, k] = N[i, 0] * J[3, k] + N[i, 1] * J[4, k] + N[i, 2] * J[5, k]
