"""Kernels of a serial chain T = F[0] · J_0(q_0) · F[1] · J_1(q_1) ⋯ F[k] and of its Jacobian.

`fixed` (k+1, 4, 4) holds the F, `prismatic` (n,) whether J_i is Tz(q_i) or Rz(q_i), q (n,) and J (6, n) may be longer
than k: later joints do not move this frame, and their columns are zero. Nothing is checked here.
"""

import numpy as np

from longreach.kernels import kernel

# π/2 in three parts; the first two have zeros at their ends, so that multiples of them are exact.
_TURN_1 = 1.5707963267341256
_TURN_2 = 6.077100506303966e-11
_TURN_3 = 2.0222662487959506e-21
_FUSED = {"contract"}  # a · b + c in one instruction
_FAR = 1e5  # further out the reduction loses digits


@kernel(fastmath=_FUSED)
def sine_cosine(x):
    """Return sin x and cos x by Taylor's series about the nearest multiple of π/2, to 2e-16 where |x| < 1e5.

    Without a call or a branch, so that a loop over joints becomes vector instructions.
    """
    k = np.rint(x * (2 / np.pi))
    r = ((x - k * _TURN_1) - k * _TURN_2) - k * _TURN_3
    u = r * r
    s = -1 / 1307674368000.0
    s = 1 / 6227020800.0 + u * s
    s = -1 / 39916800.0 + u * s
    s = 1 / 362880.0 + u * s
    s = -1 / 5040.0 + u * s
    s = 1 / 120.0 + u * s
    s = -1 / 6.0 + u * s
    s = r + r * u * s
    c = 1 / 20922789888000.0
    c = -1 / 87178291200.0 + u * c
    c = 1 / 479001600.0 + u * c
    c = -1 / 3628800.0 + u * c
    c = 1 / 40320.0 + u * c
    c = -1 / 720.0 + u * c
    c = 1 / 24.0 + u * c
    c = 1.0 - u * (0.5 - u * c)
    m = k - 4.0 * np.floor(0.25 * k)  # the quadrant
    odd = m == 1.0 or m == 3.0
    a = c if odd else s
    b = s if odd else c
    return (-a if m >= 2.0 else a), (-b if m == 1.0 or m == 2.0 else b)


@kernel(fastmath=_FUSED)
def _sines_and_cosines(q, k, J):
    """Put the sines of q[:k] into J[0] and the cosines into J[1], where they wait until they are used."""
    near = True
    for i in range(k):
        near &= abs(q[i]) < _FAR
    if near:
        for i in range(k):
            J[0, i], J[1, i] = sine_cosine(q[i])
    else:
        for i in range(k):
            J[0, i], J[1, i] = np.sin(q[i]), np.cos(q[i])


@kernel(fastmath=_FUSED)
def _times(a, b, c, F):
    """Return the row (a, b, c) times the rotation of F, with fewer products for the turns that robots are made of."""
    if F[0, 0] == 1.0:  # about x, between most joints
        if F[1, 1] == 1.0:
            return a, b, c
        return a, b * F[1, 1] + c * F[2, 1], b * F[1, 2] + c * F[2, 2]
    if F[0, 2] == 1.0 and F[1, 0] == 1.0:  # x onto y onto z onto x, between the joints of a planar base
        return b, c, a
    if F[2, 2] == 1.0:  # about z
        return a * F[0, 0] + b * F[1, 0], a * F[0, 1] + b * F[1, 1], c
    return (
        a * F[0, 0] + b * F[1, 0] + c * F[2, 0],
        a * F[0, 1] + b * F[1, 1] + c * F[2, 1],
        a * F[0, 2] + b * F[1, 2] + c * F[2, 2],
    )


@kernel(fastmath=_FUSED)
def _columns(prismatic, k, px, py, pz, J):
    """Turn the joints' positions J[:3] and axes J[3:] into columns of the Jacobian at the point p."""
    for i in range(k):
        zx, zy, zz = J[3, i], J[4, i], J[5, i]
        rx, ry, rz = px - J[0, i], py - J[1, i], pz - J[2, i]
        slides = prismatic[i] != 0
        J[0, i] = zx if slides else zy * rz - zz * ry  # (3.14)
        J[1, i] = zy if slides else zz * rx - zx * rz
        J[2, i] = zz if slides else zx * ry - zy * rx
        J[3, i] = 0.0 if slides else zx  # (3.13)
        J[4, i] = 0.0 if slides else zy
        J[5, i] = 0.0 if slides else zz
    for row in range(6):
        for i in range(k, J.shape[1]):
            J[row, i] = 0.0


@kernel(fastmath=_FUSED)
def forward_jacobian(fixed, prismatic, q, T, J):
    """Fill T (4, 4) and the geometric Jacobian J (6, n) = [v; ω], world-aligned at the end; (3.8), (3.12)-(3.15)."""
    k = fixed.shape[0] - 1
    _sines_and_cosines(q, k, J)
    F = fixed[0]
    xx, yx, zx, px = F[0, 0], F[0, 1], F[0, 2], F[0, 3]
    xy, yy, zy, py = F[1, 0], F[1, 1], F[1, 2], F[1, 3]
    xz, yz, zz, pz = F[2, 0], F[2, 1], F[2, 2], F[2, 3]
    for i in range(k):
        s, c = J[0, i], J[1, i]
        J[0, i], J[1, i], J[2, i] = px, py, pz
        J[3, i], J[4, i], J[5, i] = zx, zy, zz
        if prismatic[i] != 0:
            px, py, pz = px + q[i] * zx, py + q[i] * zy, pz + q[i] * zz
        else:
            xx, yx = c * xx + s * yx, c * yx - s * xx
            xy, yy = c * xy + s * yy, c * yy - s * xy
            xz, yz = c * xz + s * yz, c * yz - s * xz
        F = fixed[i + 1]
        px += F[0, 3] * xx + F[1, 3] * yx + F[2, 3] * zx
        py += F[0, 3] * xy + F[1, 3] * yy + F[2, 3] * zy
        pz += F[0, 3] * xz + F[1, 3] * yz + F[2, 3] * zz
        xx, yx, zx = _times(xx, yx, zx, F)
        xy, yy, zy = _times(xy, yy, zy, F)
        xz, yz, zz = _times(xz, yz, zz, F)
    T[0, 0], T[0, 1], T[0, 2], T[0, 3] = xx, yx, zx, px
    T[1, 0], T[1, 1], T[1, 2], T[1, 3] = xy, yy, zy, py
    T[2, 0], T[2, 1], T[2, 2], T[2, 3] = xz, yz, zz, pz
    T[3, 0], T[3, 1], T[3, 2], T[3, 3] = 0.0, 0.0, 0.0, 1.0
    _columns(prismatic, k, px, py, pz, J)


@kernel(entry=True)
def checked(model, q, T, J):
    """Fill T and J as `forward_jacobian` does, or return False where a shape does not fit or q is not finite.

    `model` is `fixed` with `prismatic` in model[:k, 3, 0] and n in model[k, 3, 0]: one array less costs 70 ns less.
    """
    n = J.shape[1]
    if n != model[model.shape[0] - 1, 3, 0] or q.shape[0] != n or J.shape[0] != 6:
        return False
    if T.shape[0] != 4 or T.shape[1] != 4:
        return False
    forward_jacobian(model, model[:, 3, 0], q, T, J)
    total = 0.0
    for i in range(n):
        total += 0.0 * q[i]
    return total == 0.0


@kernel(fastmath=_FUSED)
def forward_jacobian_batch(fixed, prismatic, Q, T, J):
    """Fill T (m, 4, 4) and J (m, 6, n) for the rows of Q (m, n)."""
    for i in range(Q.shape[0]):
        forward_jacobian(fixed, prismatic, Q[i], T[i], J[i])


@kernel(fastmath=_FUSED)
def forward(fixed, prismatic, q, T):
    """Fill T (4, 4) alone; (3.8)."""
    J = np.empty((6, fixed.shape[0] - 1))
    forward_jacobian(fixed, prismatic, q, T, J)


@kernel(fastmath=_FUSED)
def forward_batch(fixed, prismatic, Q, T):
    """Fill T (m, 4, 4) for the rows of Q (m, n)."""
    J = np.empty((6, fixed.shape[0] - 1))
    for i in range(Q.shape[0]):
        forward_jacobian(fixed, prismatic, Q[i], T[i], J)


@kernel(fastmath=_FUSED)
def hessian(J, H):
    """Fill H (n, 6, n), H[j] = ∂J/∂q_j, world-aligned as J is, from the columns (v_i; ω_i) of J alone.

    For j ≤ i: H[j][:, i] = (ω_j × v_i; ω_j × ω_i); for j > i: (ω_i × v_j; 0). A prismatic joint has ω = 0.
    """
    n = J.shape[1]
    for j in range(n):
        wx, wy, wz = J[3, j], J[4, j], J[5, j]
        for i in range(j):  # joint i comes before j: it carries j's axis along
            ox, oy, oz = J[3, i], J[4, i], J[5, i]
            vx, vy, vz = J[0, j], J[1, j], J[2, j]
            H[j, 0, i], H[j, 1, i], H[j, 2, i] = oy * vz - oz * vy, oz * vx - ox * vz, ox * vy - oy * vx
            H[j, 3, i], H[j, 4, i], H[j, 5, i] = 0.0, 0.0, 0.0
        for i in range(j, n):
            vx, vy, vz = J[0, i], J[1, i], J[2, i]
            ox, oy, oz = J[3, i], J[4, i], J[5, i]
            H[j, 0, i], H[j, 1, i], H[j, 2, i] = wy * vz - wz * vy, wz * vx - wx * vz, wx * vy - wy * vx
            H[j, 3, i], H[j, 4, i], H[j, 5, i] = wy * oz - wz * oy, wz * ox - wx * oz, wx * oy - wy * ox
