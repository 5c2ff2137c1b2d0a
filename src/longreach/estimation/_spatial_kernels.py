"""Compiled 15-state filter in space: motion with its Jacobian, the extended prediction, and the correction.

Layout of the mean: x y z, roll pitch yaw, body velocity, body rates, body acceleration. In a step of dt

    ρ_m = ρ + lead · dt E(ρ) ω,   p ← p + R(ρ_m) (v dt + a dt²/2),   ρ ← ρ + dt E(ρ_m) ω,   v ← v + a dt

with R = Rz Ry Rx and E from body rates to the rates of the angles. lead is 1/2 (midpoint rule) or 0 (Euler's rule).
Near a pitch of ±90° the angles are no coordinates; E is bounded there.
"""

import math

import numpy as np

from longreach.geometry._kernels import wrap
from longreach.kernels import kernel

N = 15
_STEEP = 1e-3  # |cos(pitch)| is taken to be no less than this in E


@kernel(entry=True)
def copy(A, out):
    """A (15, 15) into out; a slice would do, and take seconds to compile."""
    for i in range(N):
        for j in range(N):
            out[i, j] = A[i, j]


@kernel(entry=True)
def rotation(roll, pitch, yaw, R):
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    sr, cr, sp, cp = math.sin(roll), math.cos(roll), math.sin(pitch), math.cos(pitch)
    sy, cy = math.sin(yaw), math.cos(yaw)
    R[0, 0], R[0, 1], R[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    R[1, 0], R[1, 1], R[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    R[2, 0], R[2, 1], R[2, 2] = -sp, cp * sr, cp * cr


@kernel(entry=True)
def angle_terms(roll, pitch):
    """sin and cos of the roll, tan and 1/cos of the pitch, away from its poles."""
    cp = math.cos(pitch)
    cp = math.copysign(max(abs(cp), _STEEP), cp)
    return math.sin(roll), math.cos(roll), math.sin(pitch) / cp, 1.0 / cp


@kernel(entry=True)
def move(x, dt, lead, R, out):
    """The mean after dt; leaves R(ρ_m) in R."""
    sr, cr, tp, ip = angle_terms(x[3], x[4])
    s, c = sr * x[10] + cr * x[11], cr * x[10] - sr * x[11]
    h = lead * dt
    roll, pitch, yaw = x[3] + h * (x[9] + s * tp), x[4] + h * c, x[5] + h * s * ip
    rotation(roll, pitch, yaw, R)
    if lead > 0.0:
        sr, cr, tp, ip = angle_terms(roll, pitch)
        s, c = sr * x[10] + cr * x[11], cr * x[10] - sr * x[11]
    half = 0.5 * dt * dt
    for i in range(3):
        out[i] = x[i]
        for k in range(3):
            out[i] += R[i, k] * (dt * x[6 + k] + half * x[12 + k])
        out[6 + i] = x[6 + i] + dt * x[12 + i]
        out[9 + i], out[12 + i] = x[9 + i], x[12 + i]
    out[3], out[4], out[5] = x[3] + dt * (x[9] + s * tp), x[4] + dt * c, x[5] + dt * s * ip


@kernel(entry=True)
def jacobian(x, dt, lead, R, J):
    """Rows of ∂(p, ρ) over (ρ, v, ω, a), less the identity: J (6, 12). R is R(ρ_m), as `move` leaves it."""
    sr, cr, tp, ip = angle_terms(x[3], x[4])
    s, c = sr * x[10] + cr * x[11], cr * x[10] - sr * x[11]
    h, half = lead * dt, 0.5 * dt * dt
    e01, e02, e11, e12, e21, e22 = sr * tp, cr * tp, cr, -sr, sr * ip, cr * ip  # E(ρ), whose first column is (1, 0, 0)
    g00, g10, g20 = 1.0 + h * c * tp, -h * s, h * c * ip  # ∂ρ_m/∂ρ, whose last column is (0, 0, 1)
    g01, g21 = h * s * ip * ip, h * s * tp * ip
    roll, pitch, yaw = x[3] + h * (x[9] + s * tp), x[4] + h * c, x[5] + h * s * ip
    sr, cr, tp, ip = angle_terms(roll, pitch)
    s, c = sr * x[10] + cr * x[11], cr * x[10] - sr * x[11]
    d0, d1, d2 = dt * x[6] + half * x[12], dt * x[7] + half * x[13], dt * x[8] + half * x[14]
    sp, cp, sy, cy = -R[2, 0], math.cos(pitch), math.sin(yaw), math.cos(yaw)
    uy, uz = cr * d1 - sr * d2, sr * d1 + cr * d2  # Rx d
    along, up, flat = cp * uz - sp * d0, -sp * uz - cp * d0, cp * d0 + sp * uz
    pitching, yawing = (cy * along, sy * along, up), (-sy * flat - cy * uy, cy * flat - sy * uy, 0.0)
    for i in range(3):  # the position: ∂(R d)/∂ρ_m times ∂ρ_m/∂ρ, and ∂ρ_m/∂ω = h E
        r, p, y = R[i, 2] * d1 - R[i, 1] * d2, pitching[i], yawing[i]
        J[i, 0], J[i, 1], J[i, 2] = r * g00 + p * g10 + y * g20, r * g01 + p + y * g21, y
        J[i, 6], J[i, 7], J[i, 8] = h * r, h * (r * e01 + p * e11 + y * e21), h * (r * e02 + p * e12 + y * e22)
        for k in range(3):
            J[i, 3 + k], J[i, 9 + k] = dt * R[i, k], half * R[i, k]
    rolls, pitches = (dt * c * tp, -dt * s, dt * c * ip), (dt * s * ip * ip, 0.0, dt * s * tp * ip)  # ∂(dt E ω)/∂ρ_m
    rates = ((dt, dt * sr * tp, dt * cr * tp), (0.0, dt * cr, -dt * sr), (0.0, dt * sr * ip, dt * cr * ip))
    for i in range(3):
        r, p = rolls[i], pitches[i]
        J[3 + i, 0], J[3 + i, 1], J[3 + i, 2] = r * g00 + p * g10, r * g01 + p, 0.0
        J[3 + i, 6] = rates[i][0] + h * r
        J[3 + i, 7] = rates[i][1] + h * (r * e01 + p * e11)
        J[3 + i, 8] = rates[i][2] + h * (r * e02 + p * e12)
        for k in range(3):
            J[3 + i, 3 + k] = J[3 + i, 9 + k] = 0.0


@kernel(entry=True)
def propagate(J, dt, P, A):
    """P ← F P Fᵀ for F = I + J and the velocity's dt, in place and exactly symmetric; A (15, 15) is room to work in.

    Only the first nine rows of A = F P differ from P, and of A Fᵀ only the pose's own block is not read off them.
    """
    for i in range(3):
        j0, j1, j2, j3, j4, j5 = J[i, 0], J[i, 1], J[i, 2], J[i, 3], J[i, 4], J[i, 5]
        j6, j7, j8, j9, j10, j11 = J[i, 6], J[i, 7], J[i, 8], J[i, 9], J[i, 10], J[i, 11]
        for j in range(N):
            A[i, j] = (
                (P[i, j] + j0 * P[3, j] + j1 * P[4, j] + j2 * P[5, j])
                + (j3 * P[6, j] + j4 * P[7, j] + j5 * P[8, j])
                + (j6 * P[9, j] + j7 * P[10, j] + j8 * P[11, j])
                + (j9 * P[12, j] + j10 * P[13, j] + j11 * P[14, j])
            )
    for i in range(3, 6):
        j0, j1, j2, j6, j7, j8 = J[i, 0], J[i, 1], J[i, 2], J[i, 6], J[i, 7], J[i, 8]
        for j in range(N):
            A[i, j] = (P[i, j] + j0 * P[3, j] + j1 * P[4, j] + j2 * P[5, j]) + (
                j6 * P[9, j] + j7 * P[10, j] + j8 * P[11, j]
            )
    for i in range(6):
        for j in range(i + 1):
            total = A[i, j]
            for c in range(12):
                total += J[j, c] * A[i, 3 + c]
            P[i, j] = P[j, i] = total
        for j in range(6, 9):
            P[i, j] = P[j, i] = A[i, j] + dt * A[i, j + 6]
        for j in range(9, N):
            P[i, j] = P[j, i] = A[i, j]
    for i in range(6, 9):
        for j in range(6, i + 1):
            P[i, j] = P[j, i] = P[i, j] + dt * (P[i + 6, j] + P[i, j + 6] + dt * P[i + 6, j + 6])
        for j in range(9, N):
            A[i, j] = P[i, j] + dt * P[i + 6, j]
    for i in range(6, 9):
        for j in range(9, N):
            P[i, j] = P[j, i] = A[i, j]


@kernel(entry=True)
def wrap_angles(x):
    for i in range(3, 6):
        if abs(x[i]) > math.pi:
            x[i] = wrap(x[i])


@kernel(entry=True)
def add_noise(Q, dt, speed, P):
    """P ← P + dt Q; where a speed ≥ 0 is given, the noise of the pose grows with its square."""
    pose = dt if speed < 0.0 else dt * speed * speed
    for i in range(N):
        for j in range(N):
            P[i, j] += (pose if i < 6 and j < 6 else dt) * Q[i, j]


@kernel(entry=True)
def predict(x, P, dt, lead, Q, speed, work, R, J, moved):
    """Extended prediction of dt, in place; work (15, 15), R (3, 3), J (6, 12) and moved (15,) are room to work in."""
    move(x, dt, lead, R, moved)
    jacobian(x, dt, lead, R, J)
    propagate(J, dt, P, work)
    add_noise(Q, dt, speed, P)
    for i in range(N):
        x[i] = moved[i]
    wrap_angles(x)


@kernel(entry=True)
def cholesky(S, n, L):
    """L Lᵀ = S for the first n rows; whether S is positive definite and finite."""
    for i in range(n):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            elif total > 0.0 and total < np.inf:
                L[i, i] = math.sqrt(total)
            else:
                return False
    return True


@kernel(entry=True)
def correct(x, P, M, barely, k, start, width, r, H, R, gate, room):
    """Take an innovation r (k,) = z - h(x) with ∂h/∂x = H over `width` columns from `start`, in place.

    Returns the NIS; it is infinite where its covariance is not positive definite. Above the gate nothing is taken.
    Joseph's form: (I - K H) P (I - K H)ᵀ + K R Kᵀ. M is P, but for `barely`, as robot_localization's UKF corrects:
    there the gain is from an M that lacks the last prediction's noise, and P ← P - K (H M Hᵀ) Kᵀ.
    """
    PHt, K, S, L, D = room
    for a in range(k):
        for i in range(N):
            PHt[a, i] = 0.0
        for c in range(width):
            h = H[a, c]
            if h != 0.0:
                for i in range(N):
                    PHt[a, i] += h * M[start + c, i]
    for a in range(k):
        for b in range(a + 1):
            total = R[a, b]
            for c in range(width):
                total += H[b, c] * PHt[a, start + c]
            S[a, b] = S[b, a] = total
    if not cholesky(S, k, L):
        return np.inf
    nis = 0.0
    for a in range(k):
        total = r[a]
        for b in range(a):
            total -= L[a, b] * D[0, b]
        D[0, a] = total / L[a, a]
        nis += D[0, a] * D[0, a]
    if not nis < gate:
        return nis if nis >= 0.0 else np.inf
    _gain(PHt, L, k, K)
    for a in range(k):
        for i in range(N):
            x[i] += K[a, i] * r[a]
    if barely:
        _without_noise(P, k, S, R, K, D)
    else:
        _joseph(P, k, S, PHt, K, D)
    wrap_angles(x)
    return nis


@kernel(entry=True)
def _gain(PHt, L, k, K):
    """K (k, 15), transposed: S⁻¹ H P."""
    for a in range(k):
        f = 1.0 / L[a, a]
        for i in range(N):
            K[a, i] = PHt[a, i] * f
        for b in range(a):
            g = L[a, b] * f
            for i in range(N):
                K[a, i] -= g * K[b, i]
    for a in range(k - 1, -1, -1):
        for b in range(a + 1, k):
            g = L[b, a]
            for i in range(N):
                K[a, i] -= g * K[b, i]
        f = 1.0 / L[a, a]
        for i in range(N):
            K[a, i] *= f


@kernel(entry=True)
def _joseph(P, k, S, PHt, K, D):
    """P ← P - K (H P) - D Kᵀ with D = P Hᵀ - K S: (I - K H) P (I - K H)ᵀ + K R Kᵀ multiplied out, for any K."""
    for a in range(k):
        for i in range(N):
            D[a, i] = PHt[a, i]
        for b in range(k):
            s = S[a, b]
            for i in range(N):
                D[a, i] -= s * K[b, i]
    for a in range(k):
        for i in range(N):
            f, g = K[a, i], D[a, i]
            for j in range(i + 1):
                P[i, j] -= f * PHt[a, j] + g * K[a, j]
    for i in range(N):
        for j in range(i):
            P[j, i] = P[i, j]


@kernel(entry=True)
def _without_noise(P, k, S, R, K, D):
    """P ← P - K (S - R) Kᵀ."""
    for a in range(k):
        for i in range(N):
            D[a, i] = 0.0
            for b in range(k):
                D[a, i] += (S[a, b] - R[a, b]) * K[b, i]
    for a in range(k):
        for i in range(N):
            for j in range(N):
                P[i, j] -= K[a, i] * D[a, j]
