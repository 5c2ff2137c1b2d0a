"""Compiled 15-state filter in space: prediction, extended and unscented, correction, and the run over a recording.

Layout of the mean: x y z, roll pitch yaw, body velocity, body rates, body acceleration. In a step of dt

    ρ_m = ρ + lead · dt E(ρ) ω,   p ← p + R(ρ_m) (v dt + a dt²/2),   ρ ← ρ + dt E(ρ_m) ω,   v ← v + a dt

with R = Rz Ry Rx and E from body rates to the rates of the angles. lead is 1/2 (midpoint rule) or 0 (Euler's rule).
Near a pitch of ±90° the angles are no coordinates; E is bounded there. Observations are linear in the state, or nearly
so; for these the unscented correction is the extended one.

Tuples that go through the functions here:
    model    Q (15, 15), lead, as_is, unscented, α, κ, dynamic, planar
    control  stamps (m,), commands (m, 6), on (6,), limits (4, 6): up, gain up, down, gain down; timeout [s]
    row      start, k, gate, gravity, z (6,), H (6, 6), R (6, 6), lever (3,)
    table    stamps (n,), and arrays of what is in a row
    room     what `work_room` makes, once, for the kernels make no arrays
start says what is measured: 0 the pose, 6 the twist, 12 an acceleration at `lever` [m] from the base. as_is: as
robot_localization does it, lever arm and ω × v left out of the Jacobian, the latter altogether.
"""

import math

import numpy as np

from longreach.geometry._kernels import wrap
from longreach.kernels import kernel

N = 15
USED, GATED, REFUSED = 1, 2, 3
_STEEP = 1e-3  # |cos(pitch)| is taken to be no less than this in E
_PLANAR = np.array([2, 3, 4, 8, 9, 10, 14])  # what two_d_mode holds at zero
_PLANAR_ROWS = np.eye(N)[_PLANAR], 1e-6 * np.eye(7)  # H, and R as in robot_localization
_UNKNOWN = 1e6  # times the variance of what is measured first


def work_room():
    """Room to work in: for the prediction; for the correction; for what is compared, and for two_d_mode's rows."""
    prediction = ((N, N), (N, N), N, (3, 3), (6, 12), N, N)
    correction = ((7, N), (7, N), (7, 7), (7, 7), (7, N))
    comparison = (7, (7, 12), (6, 6), (6, 6))
    a, b, c = (tuple(np.zeros(shape) for shape in part) for part in (prediction, correction, comparison))
    return a, b, (*c, *_PLANAR_ROWS)


@kernel(entry=True)
def copy(A, out):
    """A (15, 15) into out; a slice would do, and take seconds to compile."""
    for i in range(N):
        for j in range(N):
            out[i, j] = A[i, j]


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
    sr, cr, tp, ip = angle_terms(roll, pitch)
    sp, cp, sy, cy = math.sin(pitch), math.cos(pitch), math.sin(yaw), math.cos(yaw)
    s, c = sr * x[10] + cr * x[11], cr * x[10] - sr * x[11]
    R[0, 0], R[0, 1], R[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    R[1, 0], R[1, 1], R[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    R[2, 0], R[2, 1], R[2, 2] = -sp, cp * sr, cp * cr
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
def cholesky(S, n, least, L):
    """L Lᵀ = S for the first n rows; whether S is positive definite and finite.

    A direction in which S has less than `least` of its variance left gives a column of zeros.
    """
    definite = True
    for i in range(n):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j], L[j, i] = total / L[j, j] if L[j, j] > 0.0 else 0.0, 0.0
            elif total > least * S[i, i]:
                L[i, i] = math.sqrt(total)
            else:
                L[i, i], definite = 0.0, False
    return definite


@kernel(entry=True)
def _predict_unscented(x, P, dt, lead, alpha, kappa, room):
    """Move the sigma points x ± γ L_i with L Lᵀ = P and γ² = α² (15 + κ), in the room for a prediction.

    The mean of the moved points is taken on SE(3), where it is the central one: log(exp(ξ) T) is odd in ξ. The mean of
    their coordinates would not be: with a heading uncertain by 1 rad it goes half as far as the robot. Sums run over
    differences to the central point, which a small α would otherwise drown in rounding.
    """
    _, L, D, R, _, centre, point = room
    cholesky(P, N, 1e-14, L)
    gamma = alpha * math.sqrt(N + kappa)
    weight = 0.5 / (gamma * gamma)
    position = (x[0], x[1], x[2])
    x[0] = x[1] = x[2] = 0.0  # where it is has no say in how it moves, and would cost digits
    move(x, dt, lead, R, centre)
    for i in range(N):
        for j in range(N):
            P[i, j] = 0.0
    for c in range(N):
        for sign in range(2):
            if sign == 0 or c < 12:  # the motion is linear in the accelerations
                step = gamma - 2.0 * sign * gamma
                for i in range(N):
                    point[i] = x[i] + step * L[i, c]
                move(point, dt, lead, R, D)
                for i in range(N):
                    D[i] -= centre[i]
            for i in range(N):
                f = weight * D[i]
                for j in range(i + 1):
                    P[i, j] += f * D[j]
    for i in range(N):
        x[i] = centre[i] + (position[i] if i < 3 else 0.0)
        for j in range(i):
            P[j, i] = P[i, j]


@kernel(entry=True)
def _steer(x, t, dt, control):
    """Let the last command before t set the accelerations, as far as it is on; none, or an old one, means to stop."""
    stamps, commands, on, limits, timeout = control
    last = np.searchsorted(stamps, t, side="right") - 1
    for i in range(6):
        if on[i]:
            wanted = commands[last, i] if last >= 0 and t - stamps[last] < timeout else 0.0
            error = wanted - x[6 + i]
            aim = wanted if abs(error) <= abs(wanted) + 0.01 else 0.0  # through zero if it has the other sign
            down = 2 if abs(aim) < abs(x[6 + i]) else 0
            a = min(max(limits[down + 1, i] * (aim - x[6 + i]), -limits[down, i]), limits[down, i])
            if i < 3:
                x[12 + i] = a
            else:
                x[6 + i] += a * dt


@kernel(entry=True)
def advance(x, P, t, dt, model, control, room):
    """Predict dt ahead to t, in place."""
    Q, lead, as_is, unscented, alpha, kappa, dynamic, _ = model
    bare, square, moved, R, J, _, _ = room[0]
    speed = 1.0
    if dynamic:  # the noise of the pose grows with its square
        speed = 0.0
        for i in range(6, 12):
            speed += x[i] * x[i]
        speed = math.sqrt(speed)
    _steer(x, t, dt, control)
    if unscented and not as_is:
        _predict_unscented(x, P, dt, lead, alpha, kappa, room[0])
    else:
        move(x, dt, lead, R, moved)
        jacobian(x, dt, lead, R, J)
        if unscented:  # robot_localization's sigma points all move along the mean's orientation
            for i in range(6):
                J[i, 0] = J[i, 1] = J[i, 2] = 0.0
        propagate(J, dt, P, square)
        if unscented:
            copy(P, bare)
        for i in range(N):
            x[i] = moved[i]
    wrap_angles(x)
    for i in range(N):
        for j in range(N):
            P[i, j] += (dt * speed * speed if i < 6 and j < 6 else dt) * Q[i, j]


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
    if not cholesky(S, k, 0.0, L):
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
        for i in range(N):
            for j in range(N):
                P[i, j] -= K[a, i] * D[a, j]


@kernel(entry=True)
def _specific_force(x, P, row, turning, as_is, r, A, C, noise):
    """z - H f and A over (ρ, v, ω, a), f = a + ω × v + α × l + ω × (ω × l) and, where it is to be removed, gravity.

    The rates and velocities in f are taken as they are, and their uncertainty as noise, through C over (v, ω): were
    they corrected by it too, a turn and an acceleration could hold each other up, for one l ω² looks like the other.
    """
    _, k, _, gravity, z, H, R, l = row
    wx, wy, wz, vx, vy, vz = x[9], x[10], x[11], x[6], x[7], x[8]
    wl, ww = wx * l[0] + wy * l[1] + wz * l[2], wx * wx + wy * wy + wz * wz
    sr, cr, sp, cp = math.sin(x[3]), math.cos(x[3]), math.sin(x[4]), math.cos(x[4])
    f0 = x[12] + turning[1] * l[2] - turning[2] * l[1] + wx * wl - l[0] * ww - gravity * sp
    f1 = x[13] + turning[2] * l[0] - turning[0] * l[2] + wy * wl - l[1] * ww + gravity * cp * sr
    f2 = x[14] + turning[0] * l[1] - turning[1] * l[0] + wz * wl - l[2] * ww + gravity * cp * cr
    if not as_is:
        f0, f1, f2 = f0 + wy * vz - wz * vy, f1 + wz * vx - wx * vz, f2 + wx * vy - wy * vx
    for a in range(k):
        h0, h1, h2 = H[a, 0], H[a, 1], H[a, 2]
        r[a] = z[a] - h0 * f0 - h1 * f1 - h2 * f2
        for c in range(9):
            A[a, c] = 0.0
        A[a, 9], A[a, 10], A[a, 11] = h0, h1, h2
        if not as_is:
            A[a, 0] = gravity * (h1 * cp * cr - h2 * cp * sr)
            A[a, 1] = -gravity * (h0 * cp + h1 * sp * sr + h2 * sp * cr)
            hw, hl = h0 * wx + h1 * wy + h2 * wz, h0 * l[0] + h1 * l[1] + h2 * l[2]
            C[a, 0], C[a, 1], C[a, 2] = h1 * wz - h2 * wy, h2 * wx - h0 * wz, h0 * wy - h1 * wx
            C[a, 3] = h2 * vy - h1 * vz + h0 * wl + hw * l[0] - 2.0 * hl * wx
            C[a, 4] = h0 * vz - h2 * vx + h1 * wl + hw * l[1] - 2.0 * hl * wy
            C[a, 5] = h1 * vx - h0 * vy + h2 * wl + hw * l[2] - 2.0 * hl * wz
    for a in range(k):
        for b in range(a + 1):
            total = R[a, b]
            if not as_is:
                for i in range(6):
                    for j in range(6):
                        total += C[a, i] * P[6 + i, 6 + j] * C[b, j]
            noise[a, b] = noise[b, a] = total


@kernel(entry=True)
def observe(x, P, row, turning, as_is, room):
    """Fill the room's innovation; returns where the Jacobian's columns start, their number, the Jacobian, the noise."""
    start, k, _, _, z, H, R, lever = row
    r, A, noise, C, _, _ = room[2]
    if start == 12:
        _specific_force(x, P, row, turning, as_is, r, A, C, noise)
        return 3, 12, A, noise
    d = A[6]  # a row of room that is not needed here
    for i in range(6):
        d[i] = z[i] - x[start + i]
    if start == 0:
        for i in range(3, 6):
            d[i] = wrap(d[i])
    elif as_is:  # without as_is, the lever arm stands in H
        d[0] += lever[1] * x[11] - lever[2] * x[10]
        d[1] += lever[2] * x[9] - lever[0] * x[11]
        d[2] += lever[0] * x[10] - lever[1] * x[9]
    for a in range(k):
        total = 0.0
        for c in range(6):
            total += H[a, c] * d[c]
        r[a] = total
    return start, 6, H, R


@kernel(entry=True)
def step(x, P, last, t, row, turning, model, control, room):
    """Predict from the last measurement to one at t and take it, in place: what became of it, and its NIS.

    The first one, after -inf, sets what it sees, whatever its gate and the initial state are.
    """
    start, k, gate, _, _, H, R, _ = row
    as_is, unscented, planar = model[2], model[3], model[7]
    bare, (r, _, _, _, rows, still) = room[0][0], room[2]
    if last == -np.inf:
        gate, variance = np.inf, 0.0
        for a in range(k):
            variance = max(variance, _UNKNOWN * R[a, a])
        for c in range(6):
            for a in range(k):
                if H[a, c] != 0.0:
                    for i in range(N):
                        P[start + c, i] = P[i, start + c] = 0.0
                    P[start + c, start + c] = variance
        copy(P, bare)
    elif t > last:
        advance(x, P, t, t - last, model, control, room)
    first, width, A, noise = observe(x, P, row, turning, as_is, room)
    barely = as_is and unscented
    nis = correct(x, P, bare if barely else P, barely, k, first, width, r, A, noise, gate, room[1])
    if planar:
        for a in range(7):
            r[a] = -x[_PLANAR[a]]
        correct(x, P, P, False, 7, 0, N, r, rows, still, np.inf, room[1])
    if barely and nis < gate:
        copy(P, bare)
    return (REFUSED if nis == np.inf else USED if nis < gate else GATED), nis


@kernel(entry=True)
def run(x, P, table, ticks, model, control, timeout, always, out, room):
    """Take all rows of the table, and note the state at each tick: its stamp, mean and covariance of the pose.

    A tick without a measurement predicts up to itself once `timeout` [s] has passed since the last, or `always`.
    out: status (n,), nis (n,), stamps (m,), means (m, 15), covariances (m, 6, 6), angular acceleration (3,), the
    rates at the last tick (3,).
    """
    stamps, starts, ks, gates, gravities, z, H, R, levers = table
    status, nis, out_stamps, means, covariances, turning, rates = out
    since, now, i, n = stamps[0], -np.inf, 0, len(stamps)
    for m in range(len(ticks)):
        before = i
        while i < n and stamps[i] <= ticks[m]:
            row = (starts[i], ks[i], gates[i], gravities[i], z[i], H[i], R[i], levers[i])
            status[i], nis[i] = step(x, P, now, stamps[i], row, turning, model, control, room)
            now = max(now, stamps[i])
            i += 1
        if ticks[m] > now and (always or (i == before and ticks[m] - now >= timeout)):
            advance(x, P, ticks[m], ticks[m] - now, model, control, room)
            now = ticks[m]
        if now > since:
            for a in range(3):  # differenced at this rate: from message to message it would be noise
                turning[a] = (x[9 + a] - rates[a]) / (now - since)
                rates[a] = x[9 + a]
            since = now
        out_stamps[m] = now
        for a in range(N):
            means[m, a] = x[a]
        for a in range(6):
            for b in range(6):
                covariances[m, a, b] = P[a, b]
