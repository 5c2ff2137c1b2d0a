"""Compiled SO(3), SE(2) and SE(3): scalars for SE(2), small arrays for the others, and loops over batches of them.

Series below the `_SMALL` angle keep every coefficient at full precision where the closed form divides 0 by 0.
"""

import math

import numpy as np

from longreach.kernels import kernel

_SMALL = 1e-2  # [rad]; the series below are good to 1e-17 there


@kernel
def wrap(angle):
    """Angle in (-π, π]."""
    wrapped = angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
    return math.pi if wrapped <= -math.pi else wrapped  # below it by rounding, too


@kernel
def sinc_terms(t):
    """sin(t)/t and (1 - cos(t))/t."""
    if abs(t) < _SMALL:
        t2 = t * t
        return 1.0 - t2 / 6.0 * (1.0 - t2 / 20.0 * (1.0 - t2 / 42.0)), t * (
            0.5 - t2 / 24.0 * (1.0 - t2 / 30.0 * (1.0 - t2 / 56.0))
        )
    return math.sin(t) / t, (1.0 - math.cos(t)) / t


@kernel
def half_cot(t):
    """(t/2) cot(t/2) for |t| <= π, exactly 0 at π."""
    if abs(t) < _SMALL:
        t2 = t * t
        return 1.0 - t2 / 12.0 - t2 * t2 / 720.0 - t2 * t2 * t2 / 30240.0
    return 0.5 * t * math.cos(0.5 * t) / math.sin(0.5 * t)


@kernel
def se2_compose(ax, ay, at, bx, by, bt):
    c, s = math.cos(at), math.sin(at)
    return ax + c * bx - s * by, ay + s * bx + c * by, wrap(at + bt)


@kernel
def se2_between(ax, ay, at, bx, by, bt):
    """a⁻¹ b."""
    c, s = math.cos(at), math.sin(at)
    dx, dy = bx - ax, by - ay
    return c * dx + s * dy, -s * dx + c * dy, wrap(bt - at)


@kernel
def se2_exp(vx, vy, w):
    s, c = sinc_terms(w)
    return s * vx - c * vy, c * vx + s * vy, wrap(w)


@kernel
def se2_log(x, y, t):
    t = wrap(t)
    a = half_cot(t)
    b = 0.5 * t
    return a * x + b * y, -b * x + a * y, t


@kernel
def _right_jacobian_terms(t):
    """(t - sin t)/t² and (1 - cos t)/t², the entries of the last column."""
    if abs(t) < _SMALL:
        t2 = t * t
        return t / 6.0 * (1.0 - t2 / 20.0 * (1.0 - t2 / 42.0)), 0.5 - t2 / 24.0 * (1.0 - t2 / 30.0 * (1.0 - t2 / 56.0))
    return (t - math.sin(t)) / (t * t), (1.0 - math.cos(t)) / (t * t)


@kernel
def se2_right_jacobian(vx, vy, w, out):
    """exp(ξ + δ) = exp(ξ) exp(J_r δ) to first order."""
    s, c = sinc_terms(w)
    a, b = _right_jacobian_terms(w)
    out[0, 0], out[0, 1], out[0, 2] = s, c, a * vx - b * vy
    out[1, 0], out[1, 1], out[1, 2] = -c, s, b * vx + a * vy
    out[2, 0], out[2, 1], out[2, 2] = 0.0, 0.0, 1.0


@kernel
def se2_right_jacobian_inverse(vx, vy, w, out):
    s, c = sinc_terms(w)
    a, b = _right_jacobian_terms(w)
    d = s * s + c * c
    i, j = s / d, -c / d
    e, f = a * vx - b * vy, b * vx + a * vy
    out[0, 0], out[0, 1], out[0, 2] = i, j, -(i * e + j * f)
    out[1, 0], out[1, 1], out[1, 2] = -j, i, -(-j * e + i * f)
    out[2, 0], out[2, 1], out[2, 2] = 0.0, 0.0, 1.0


@kernel
def se2_adjoint(x, y, t, out):
    c, s = math.cos(t), math.sin(t)
    out[0, 0], out[0, 1], out[0, 2] = c, -s, y
    out[1, 0], out[1, 1], out[1, 2] = s, c, -x
    out[2, 0], out[2, 1], out[2, 2] = 0.0, 0.0, 1.0


@kernel
def se2_compose_all(a, b, out):
    for i in range(len(out)):
        out[i, 0], out[i, 1], out[i, 2] = se2_compose(a[i, 0], a[i, 1], a[i, 2], b[i, 0], b[i, 1], b[i, 2])


@kernel
def se2_between_all(a, b, out):
    for i in range(len(out)):
        out[i, 0], out[i, 1], out[i, 2] = se2_between(a[i, 0], a[i, 1], a[i, 2], b[i, 0], b[i, 1], b[i, 2])


@kernel
def se2_exp_all(xi, out):
    for i in range(len(out)):
        out[i, 0], out[i, 1], out[i, 2] = se2_exp(xi[i, 0], xi[i, 1], xi[i, 2])


@kernel
def se2_log_all(pose, out):
    for i in range(len(out)):
        out[i, 0], out[i, 1], out[i, 2] = se2_log(pose[i, 0], pose[i, 1], pose[i, 2])


@kernel
def so3_exp(wx, wy, wz, out):
    t = math.sqrt(wx * wx + wy * wy + wz * wz)
    s, c = sinc_terms(t)  # sin(t)/t, (1 - cos t)/t
    b = c / t if t > _SMALL else 0.5 - t * t / 24.0 * (1.0 - t * t / 30.0 * (1.0 - t * t / 56.0))
    cos = 1.0 - b * t * t
    out[0, 0], out[0, 1], out[0, 2] = cos + b * wx * wx, b * wx * wy - s * wz, b * wx * wz + s * wy
    out[1, 0], out[1, 1], out[1, 2] = b * wx * wy + s * wz, cos + b * wy * wy, b * wy * wz - s * wx
    out[2, 0], out[2, 1], out[2, 2] = b * wx * wz - s * wy, b * wy * wz + s * wx, cos + b * wz * wz


@kernel
def so3_log(R):
    """Rotation vector, |ω| <= π, through the largest quaternion component, so that it is exact near 0 and near π."""
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace >= R[0, 0] and trace >= R[1, 1] and trace >= R[2, 2]:
        w = 1.0 + trace
        x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    elif R[0, 0] >= R[1, 1] and R[0, 0] >= R[2, 2]:
        w = R[2, 1] - R[1, 2]
        x, y, z = 1.0 + 2.0 * R[0, 0] - trace, R[1, 0] + R[0, 1], R[0, 2] + R[2, 0]
    elif R[1, 1] >= R[2, 2]:
        w = R[0, 2] - R[2, 0]
        x, y, z = R[1, 0] + R[0, 1], 1.0 + 2.0 * R[1, 1] - trace, R[2, 1] + R[1, 2]
    else:
        w = R[1, 0] - R[0, 1]
        x, y, z = R[0, 2] + R[2, 0], R[2, 1] + R[1, 2], 1.0 + 2.0 * R[2, 2] - trace
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    n = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 * math.atan2(n, w) / n if n > 1e-150 else 2.0 / w
    return scale * x, scale * y, scale * z


@kernel
def _so3_v_terms(t):
    """b = (1 - cos t)/t², a = (t - sin t)/t³ and e = (1 - t/2 cot(t/2))/t²."""
    if t < 0.1:
        t2 = t * t
        b = 0.5 - t2 / 24.0 * (1.0 - t2 / 30.0 * (1.0 - t2 / 56.0 * (1.0 - t2 / 90.0)))
        a = (1.0 - t2 / 20.0 * (1.0 - t2 / 42.0 * (1.0 - t2 / 72.0 * (1.0 - t2 / 110.0)))) / 6.0
        e = 1.0 / 12.0 + t2 / 720.0 + t2 * t2 / 30240.0 + t2 * t2 * t2 / 1209600.0 + t2**4 / 47900160.0
        return b, a, e
    return (1.0 - math.cos(t)) / (t * t), (t - math.sin(t)) / (t * t * t), (1.0 - half_cot(t)) / (t * t)


@kernel
def _identity_plus(p, q, wx, wy, wz, out):
    """I + p [ω]× + q [ω]×²."""
    t2 = wx * wx + wy * wy + wz * wz
    out[0, 0] = 1.0 + q * (wx * wx - t2)
    out[1, 1] = 1.0 + q * (wy * wy - t2)
    out[2, 2] = 1.0 + q * (wz * wz - t2)
    out[0, 1], out[1, 0] = q * wx * wy - p * wz, q * wx * wy + p * wz
    out[0, 2], out[2, 0] = q * wx * wz + p * wy, q * wx * wz - p * wy
    out[1, 2], out[2, 1] = q * wy * wz - p * wx, q * wy * wz + p * wx


@kernel
def so3_left_jacobian(wx, wy, wz, out):
    """V(ω): exp of a twist has the translation V v; the right Jacobian is V(-ω)."""
    b, a, _ = _so3_v_terms(math.sqrt(wx * wx + wy * wy + wz * wz))
    _identity_plus(b, a, wx, wy, wz, out)


@kernel
def so3_left_jacobian_inverse(wx, wy, wz, out):
    _, _, e = _so3_v_terms(math.sqrt(wx * wx + wy * wy + wz * wz))
    _identity_plus(-0.5, e, wx, wy, wz, out)


@kernel
def se3_exp(xi, out):
    """xi = [v; ω]."""
    V = np.empty((3, 3))
    so3_left_jacobian(xi[3], xi[4], xi[5], V)
    so3_exp(xi[3], xi[4], xi[5], out)
    for i in range(3):
        out[i, 3] = V[i, 0] * xi[0] + V[i, 1] * xi[1] + V[i, 2] * xi[2]
        out[3, i] = 0.0
    out[3, 3] = 1.0


@kernel
def se3_log(T, out):
    wx, wy, wz = so3_log(T)
    V = np.empty((3, 3))
    so3_left_jacobian_inverse(wx, wy, wz, V)
    for i in range(3):
        out[i] = V[i, 0] * T[0, 3] + V[i, 1] * T[1, 3] + V[i, 2] * T[2, 3]
    out[3], out[4], out[5] = wx, wy, wz


@kernel
def se3_exp_all(xi, out):
    for i in range(len(xi)):
        se3_exp(xi[i], out[i])


@kernel
def se3_log_all(T, out):
    for i in range(len(T)):
        se3_log(T[i], out[i])


@kernel
def so3_exp_all(w, out):
    for i in range(len(w)):
        so3_exp(w[i, 0], w[i, 1], w[i, 2], out[i])


@kernel
def so3_log_all(R, out):
    for i in range(len(R)):
        out[i, 0], out[i, 1], out[i, 2] = so3_log(R[i])
