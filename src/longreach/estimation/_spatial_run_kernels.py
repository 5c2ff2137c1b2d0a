"""Compiled run of the 15-state filter over a table of measurements in the order of their stamps.

Tuples that go through all functions here:
    model    Q (15, 15), lead, as_is, unscented, α, κ, dynamic, planar
    control  stamps (m,), commands (m, 6), on (6,), limits (4, 6): up, gain up, down, gain down; timeout [s]
    row      start, k, z (6,), H (6, 6), R (6, 6), gate, lever (3,), gravity
    room     what `work_room` makes, once, for the kernels make no arrays
start says what is measured: 0 the pose, 6 the twist, 12 an acceleration at `lever` [m] from the base. as_is: as
robot_localization does it, lever arm and ω × v left out of the Jacobian, the latter altogether.
"""

import math

import numpy as np

from longreach.estimation import _spatial_kernels, _spatial_unscented_kernels
from longreach.estimation._spatial_kernels import N, copy
from longreach.geometry._kernels import wrap
from longreach.kernels import kernel

USED, GATED, REFUSED = 1, 2, 3
_PLANAR = np.array([2, 3, 4, 8, 9, 10, 14])  # what two_d_mode holds at zero
_PLANAR_VARIANCE = 1e-6  # as in robot_localization
_UNKNOWN = 1e6  # times the variance of what is measured first


@kernel
def work_room():
    """Room to work in: for the prediction; for the correction; for what is compared, and for two_d_mode's rows."""
    rows = np.zeros((7, N))
    for a in range(7):
        rows[a, _PLANAR[a]] = 1.0
    return (
        (
            np.zeros((N, N)),
            np.empty((N, N)),
            np.empty(N),
            np.empty((3, 3)),
            np.empty((6, 12)),
            np.empty(N),
            np.empty(N),
        ),
        (np.empty((7, N)), np.empty((7, N)), np.empty((7, 7)), np.empty((7, 7)), np.empty((7, N))),
        (np.empty(7), np.empty((7, 12)), np.empty((6, 6)), np.empty((6, 6)), rows, np.eye(7) * _PLANAR_VARIANCE),
    )


@kernel(entry=True)
def _push(error, wanted, state, limits, i):
    """Acceleration towards a commanded velocity, through zero if it has the other sign, within limits."""
    aim = wanted if abs(error) <= abs(wanted) + 0.01 else 0.0
    down = 2 if abs(aim) < abs(state) else 0
    return min(max(limits[down + 1, i] * (aim - state), -limits[down, i]), limits[down, i])


@kernel(entry=True)
def _steer(x, t, dt, control):
    """Let the last command before t set the accelerations, as far as it is on; none, or an old one, means to stop."""
    stamps, commands, on, limits, timeout = control
    last, after = -1, len(stamps)  # the last command at or before t
    while after - last > 1:
        middle = (last + after) // 2
        if stamps[middle] <= t:
            last = middle
        else:
            after = middle
    for i in range(6):
        if on[i]:
            wanted = commands[last, i] if last >= 0 and t - stamps[last] < timeout else 0.0
            a = _push(wanted - x[6 + i], wanted, x[6 + i], limits, i)
            if i < 3:
                x[12 + i] = a
            else:
                x[6 + i] += a * dt


@kernel(entry=True)
def advance(x, P, t, dt, model, control, room):
    """Predict dt ahead to t, in place."""
    Q, lead, as_is, unscented, alpha, kappa, dynamic, _ = model
    bare, square, moved, R, J, _, _ = room[0]
    speed = -1.0
    if dynamic:
        speed = 0.0
        for i in range(6, 12):
            speed += x[i] * x[i]
        speed = math.sqrt(speed)
    _steer(x, t, dt, control)
    if not unscented:
        _spatial_kernels.predict(x, P, dt, lead, Q, speed, square, R, J, moved)
    elif as_is:
        _spatial_unscented_kernels.predict_rigidly(x, P, dt, Q, speed, bare, square, R, J, moved)
    else:
        _spatial_unscented_kernels.predict(x, P, dt, lead, Q, speed, alpha, kappa, room[0])


@kernel(entry=True)
def _specific_force(x, P, row, turning, as_is, r, A, C, noise):
    """z - H f and A over (ρ, v, ω, a), f = a + ω × v + α × l + ω × (ω × l) and, where it is to be removed, gravity.

    The rates and velocities in f are taken as they are, and their uncertainty as noise, through C over (v, ω): were
    they corrected by it too, a turn and an acceleration could hold each other up, for one l ω² looks like the other.
    """
    _, k, z, H, R, _, l, gravity = row
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
    """Fill the room's innovation, Jacobian and noise; returns where the Jacobian's columns start, and their number."""
    start, k, z, H, R, _, lever, _ = row
    r, A, noise, C, _, _ = room[2]
    if start == 12:
        _specific_force(x, P, row, turning, as_is, r, A, C, noise)
        return 3, 12
    for a in range(k):
        for b in range(k):
            noise[a, b] = R[a, b]
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
            A[a, c] = H[a, c]
            total += H[a, c] * d[c]
        r[a] = total
    return start, 6


@kernel(entry=True)
def forget(P, row, bare):
    """Make what a measurement sees unknown, so that the first one sets it, whatever the initial state was."""
    start, k, _, H, R, _, _, _ = row
    variance = 0.0
    for a in range(k):
        variance = max(variance, _UNKNOWN * R[a, a])
    for c in range(6):
        for a in range(k):
            if H[a, c] != 0.0:
                for i in range(N):
                    P[start + c, i] = P[i, start + c] = 0.0
                P[start + c, start + c] = variance
    copy(P, bare)


@kernel(entry=True)
def take(x, P, row, turning, model, room):
    """Correct by one measurement, in place: what became of it, and its NIS."""
    k, gate = row[1], row[5]
    as_is, unscented, planar = model[2], model[3], model[7]
    r, A, noise, _, rows, still = room[2]
    first, width = observe(x, P, row, turning, as_is, room)
    barely, bare = as_is and unscented, room[0][0]
    nis = _spatial_kernels.correct(x, P, bare if barely else P, barely, k, first, width, r, A, noise, gate, room[1])
    if planar:
        for a in range(7):
            r[a] = -x[_PLANAR[a]]
        _spatial_kernels.correct(x, P, P, False, 7, 0, N, r, rows, still, np.inf, room[1])
    if barely and nis < gate:
        copy(P, bare)
    if nis == np.inf:
        return REFUSED, nis
    return (USED if nis < gate else GATED), nis


@kernel(entry=True)
def run(x, P, table, ticks, model, control, timeout, always, out, room):
    """Take all rows of the table, and note the state at each tick: its stamp, mean and covariance of the pose.

    A tick without a measurement predicts up to itself once `timeout` [s] has passed since the last, or `always`.
    out: status (n,), nis (n,), stamps (m,), means (m, 15), covariances (m, 6, 6), angular acceleration (3,), the
    rates at the last tick (3,).
    """
    stamps, starts, ks, z, H, R, gates, levers, gravities = table
    status, nis, out_stamps, means, covariances, turning, rates = out
    since, now, i, n = stamps[0], stamps[0], 0, len(stamps)
    for a in range(3):
        rates[a] = x[9 + a]
    for m in range(len(ticks)):
        before = i
        while i < n and stamps[i] <= ticks[m]:
            gate = gates[i] if i > 0 else np.inf
            row = (starts[i], ks[i], z[i], H[i], R[i], gate, levers[i], gravities[i])
            if i == 0:
                forget(P, row, room[0][0])
            if stamps[i] > now:
                advance(x, P, stamps[i], stamps[i] - now, model, control, room)
                now = stamps[i]
            status[i], nis[i] = take(x, P, row, turning, model, room)
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
