"""Compiled unscented prediction of the 15-state filter, and the two steps as robot_localization's UKF takes them.

Sigma points x ± γ L_i with L Lᵀ = P and γ² = α² (15 + κ). Sums run over differences to the central point, which a small
α would otherwise drown in rounding. Observations are linear in the state, or nearly so; for these the unscented
correction is the extended one.
"""

import math

from longreach.estimation._spatial_kernels import N, add_noise, copy, jacobian, move, propagate, wrap_angles
from longreach.kernels import kernel


@kernel(entry=True)
def _semidefinite_root(P, L):
    """L Lᵀ = P; a direction in which P is zero, or less by rounding, gives a column of zeros."""
    for i in range(N):
        for j in range(i):
            total = P[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j], L[j, i] = total / L[j, j] if L[j, j] > 0.0 else 0.0, 0.0
        total = P[i, i]
        for k in range(i):
            total -= L[i, k] * L[i, k]
        L[i, i] = math.sqrt(total) if total > 1e-14 * P[i, i] else 0.0


@kernel(entry=True)
def predict(x, P, dt, lead, Q, speed, alpha, kappa, room):
    """Unscented prediction of dt, in place, in the run's room for it.

    The mean of the moved points is taken on SE(3), where it is the central one: log(exp(ξ) T) is odd in ξ. The mean of
    their coordinates would not be: with a heading uncertain by 1 rad it goes half as far as the robot.
    """
    _, L, D, R, _, centre, point = room
    _semidefinite_root(P, L)
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
                D[i] -= centre[i] if sign == 0 or c < 12 else 0.0
            for i in range(N):
                f = weight * D[i]
                for j in range(i + 1):
                    P[i, j] += f * D[j]
    for i in range(N):
        x[i] = centre[i]
        for j in range(i):
            P[j, i] = P[i, j]
    for i in range(3):
        x[i] += position[i]
    wrap_angles(x)
    add_noise(Q, dt, speed, P)


@kernel(entry=True)
def predict_rigidly(x, P, dt, Q, speed, bare, work, R, J, moved):
    """Prediction with all sigma points moved along the mean's orientation; `bare` (15, 15) gets P without the noise."""
    move(x, dt, 0.0, R, moved)
    jacobian(x, dt, 0.0, R, J)
    for i in range(6):
        for k in range(3):
            J[i, k] = 0.0
    propagate(J, dt, P, work)
    copy(P, bare)
    add_noise(Q, dt, speed, P)
    for i in range(N):
        x[i] = moved[i]
    wrap_angles(x)
