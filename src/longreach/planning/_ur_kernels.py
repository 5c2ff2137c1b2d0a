"""Compiled closed form of arms like the UR: axes 2, 3 and 4 parallel, 1 ⟂ 2, 4 ⟂ 5 ⟂ 6, and 1-2, 4-5, 5-6 meeting.

Such an arm is T = before · A(q) · after with A the product of Table B.1's arm rows, sign_i q_i + offset_i in the place
of q_i, and d1 and d6 moved into `before` and `after`. In the frame 0 of `before` W = before⁻¹ T after⁻¹ is the wrist:
its origin is where axes 5 and 6 meet, its z axis 6, and n = (sin q1, -cos q1, 0) the direction of axes 2, 3 and 4.

    W's origin · n = d4                         two q1 (shoulder)
    axis 6 · n = cos q5                         two q5 (wrist); what is left of axis 6 gives q2 + q3 + q4; then q6
    two links a2, a3 in the plane ⟂ n           two q3 (elbow), then q2 and q4

Where a cosine would exceed 1 it is taken as 1: a start for a search, `miss` [m] away from closing the chain.
Source: Hawkins 2013, "Analytic inverse kinematics for the Universal Robots UR-5/UR-10 arms", for the idea.
"""

import math

from longreach.kernels import kernel

_ALIGNED = 1e-9  # sin q5 below which axes 4 and 6 are parallel, and only q4 ± q6 matters


@kernel
def _wrist(W, s1, c1, sign, q6):
    """q5, q6 and the direction (x, z) of link 5's x axis in the plane ⟂ n, for the wrist turned to one side (±1)."""
    cos = s1 * W[0, 2] - c1 * W[1, 2]
    x, z = c1 * W[0, 2] + s1 * W[1, 2], W[2, 2]  # axis 6 in the plane: -sin q5 · x4
    sin = math.sqrt(x * x + z * z)
    if sin > _ALIGNED:
        x4, z4 = -sign * x / sin, -sign * z / sin
        s5, c5 = sign * sin, cos
    else:  # q6 stays, and x5 = ± x4
        cx, sx = math.cos(q6), math.sin(q6)
        x5, y5, z5 = (cx * W[0, 0] - sx * W[0, 1], cx * W[1, 0] - sx * W[1, 1], cx * W[2, 0] - sx * W[2, 1])
        x4, z4 = c1 * x5 + s1 * y5, z5
        length = math.copysign(math.sqrt(x4 * x4 + z4 * z4), cos)
        x4, z4 = x4 / length, z4 / length
        s5, c5 = 0.0, math.copysign(1.0, cos)
    # in (x1, n, z0): x4 = (x4, 0, z4), axis 5 = x4 × n = (z4, 0, -x4), x5 = cos q5 x4 + sin q5 n
    wx, wn, wz = c1 * W[0, 0] + s1 * W[1, 0], s1 * W[0, 0] - c1 * W[1, 0], W[2, 0]
    along = c5 * (x4 * wx + z4 * wz) + s5 * wn
    return math.atan2(s5, c5), math.atan2(x4 * wz - z4 * wx, along), x4, z4


@kernel
def arm_postures(shape, W, q6, Q, miss):
    """Fill Q (8, 6) with joints and miss (8,) [m] for the wrist pose W; q6: what to take where axes 4 and 6 align."""
    signs, offsets = shape[0], shape[1]
    a2, a3, d4, d5 = shape[2, 0], shape[2, 1], shape[2, 2], shape[2, 3]
    px, py, pz = W[0, 3], W[1, 3], W[2, 3]
    rho = math.sqrt(px * px + py * py)
    short = max(abs(d4) - rho, 0.0)  # the wrist too near to axis 1
    tilt = math.asin(min(max(d4 / rho, -1.0), 1.0)) if rho > 0.0 else math.copysign(0.5 * math.pi, d4)
    row = 0
    for shoulder in range(2):
        q1 = math.atan2(py, px) + (tilt if shoulder == 0 else math.pi - tilt)
        s1, c1 = math.sin(q1), math.cos(q1)
        for wrist in range(2):
            q5, q6_found, x4, z4 = _wrist(W, s1, c1, 1.0 if wrist == 0 else -1.0, signs[5] * q6 + offsets[5])
            vx, vz = c1 * px + s1 * py - d5 * z4, pz + d5 * x4  # where axes 4 and 5 meet
            r2 = vx * vx + vz * vz
            cos = (r2 - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
            r = math.sqrt(r2)
            gap = max(r - (a2 + a3), abs(a2 - a3) - r, 0.0)
            cos = min(max(cos, -1.0), 1.0)
            sin = math.sqrt(1.0 - cos * cos)
            bend = math.atan2(sin, cos)
            towards, q234 = math.atan2(vz, vx), math.atan2(z4, x4)
            lean = math.atan2(a3 * sin, a2 + a3 * cos)
            for elbow in range(2):
                q3 = bend if elbow == 0 else -bend
                q2 = towards - (lean if elbow == 0 else -lean)
                Q[row, 0], Q[row, 1], Q[row, 2] = q1, q2, q3
                Q[row, 3], Q[row, 4], Q[row, 5] = q234 - q2 - q3, q5, q6_found
                miss[row] = short + gap
                for i in range(6):
                    Q[row, i] = signs[i] * (Q[row, i] - offsets[i])
                row += 1


@kernel
def _product(A, B, out):
    """out = A B of rigid motions."""
    for i in range(3):
        for j in range(4):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
        out[i, 3] += A[i, 3]


@kernel
def _inverse_product(A, B, out):
    """out = A⁻¹ B."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[0, i] * B[0, j] + A[1, i] * B[1, j] + A[2, i] * B[2, j]
        x, y, z = B[0, 3] - A[0, 3], B[1, 3] - A[1, 3], B[2, 3] - A[2, 3]
        out[i, 3] = A[0, i] * x + A[1, i] * y + A[2, i] * z


@kernel
def wrist_pose(ends, T_root, T, M, W):
    """W = before⁻¹ T_root⁻¹ T after⁻¹, ends (2, 4, 4) = before and after⁻¹; M (4, 4) is room to work in."""
    _inverse_product(T_root, T, M)
    _inverse_product(ends[0], M, W)
    for i in range(3):
        for j in range(4):
            M[i, j] = W[i, j]
    _product(M, ends[1], W)
