"""Compiled errors of wheels' steps: what arises on the way, what a slip adds, and what a reading is wrong by."""

import math

import numpy as np

from longreach.kernels import kernel
from longreach.odometry._relative_kernels import spread

_TOLERANCE = 1e-6  # [s] that stamps may be rounded by


@kernel
def usable(stamps, values, use):
    """Fill use (n,): finite, and the last of one stamp. Return how many are not finite, and whether stamps run back."""
    refused, last, before = 0, -1, -np.inf
    for n in range(len(stamps)):
        if stamps[n] < before:
            return refused, True
        before = stamps[n]
        total = 0.0
        for value in values[n]:
            total += 0.0 * value
        use[n] = total == 0.0
        if not use[n]:
            refused += 1
        else:
            if last >= 0 and stamps[last] == stamps[n]:
                use[last] = False
            last = n
    return refused, False


@kernel
def _add_arising(xi, dt, noise, Q):
    """Add what arises on a step ξ (3,) of dt [s], in the axes of the moving base; noise (7,): as `WheelNoise`."""
    along, across, turning, heading_travel, heading_turning, rest, heading_rest = noise
    distance, angle = math.hypot(xi[0], xi[1]), abs(xi[2])
    everywhere = across * across * distance + turning * turning * angle + rest * rest * dt
    if distance > 0.0:
        ahead = (along * along - across * across) / distance
        for i in range(2):
            for j in range(2):
                Q[i, j] += ahead * xi[i] * xi[j]
    Q[0, 0] += everywhere
    Q[1, 1] += everywhere
    Q[2, 2] += heading_travel**2 * distance + heading_turning**2 * angle + heading_rest**2 * dt


@kernel
def slipped(residual, good, stamps, window, slip, span):
    """Fill slip (n,) [m/s], the wheels' disagreement over the window that ends with each step, and its length [s]."""
    for n in range(len(residual)):
        total, first = 0.0, n
        while True:
            if good[first]:
                total += residual[first]
            if first == 0 or stamps[first - 1] < stamps[n + 1] - window - _TOLERANCE:
                break
            first -= 1
        span[n] = stamps[n + 1] - stamps[first]
        slip[n] = total / span[n]


@kernel
def growing(xi, stamps, noise, slip, span, lever, Q):
    """Fill Q (n, 3, 3): what arises on each step, and ρ² for x, y and (ρ/k)² for θ a window, ρ = slip · span."""
    arising = np.empty((3, 3))
    for n in range(len(xi)):
        dt = stamps[n + 1] - stamps[n]
        arising[:] = 0.0
        _add_arising(xi[n], dt, noise, arising)
        if span[n] > 0.0:
            variance = (slip[n] * span[n]) ** 2 * dt / span[n]
            arising[0, 0] += variance
            arising[1, 1] += variance
            arising[2, 2] += variance / (lever * lever)
        spread(xi[n], arising, Q[n])


@kernel
def readings(xi, good, rounding, R):
    """Fill R (n, 3, 3): ξξᵀ/3 in the mean over the step to a reading and the one before, and the rounding (3,)."""
    for n in range(len(xi)):
        R[n] = 0.0
        for step in (n, max(n - 1, 0)):
            if good[step]:
                for i in range(3):
                    for j in range(3):
                        R[n, i, j] += xi[step, i] * xi[step, j] / 6.0
        for i in range(3):
            R[n, i, i] += rounding[i]
