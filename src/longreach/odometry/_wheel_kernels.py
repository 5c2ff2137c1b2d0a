"""Compiled wheel odometry: records one after the other, each into a step ξ with its covariance."""

import math
from typing import NamedTuple

import numpy as np

from longreach.geometry._kernels import se2_between, se2_exp, se2_log
from longreach.kernels import kernel
from longreach.odometry._dead_reckoning_kernels import add_transformed

COUNTS, RATES, POSES = 0, 1, 2  # how the numbers of two records become a motion
_TOLERANCE = 1e-6  # [s] that stamps may be rounded by
_AVERAGED = 50.0  # intervals that the mean interval is taken over; 10 to 1000 make no difference on the Intel log


class Model(NamedTuple):
    """How the records of one stream become steps. Arrays are read-only.

    signal: COUNTS, RATES or POSES. ranges (k,): after which counts may start again, looked for where `wrap` is 0.
    fastest: of a wheel [counts/s]. forward (3, w): twist from wheel speeds. residual (w,), or (0,) where slip cannot be
    observed: slip speed [m/s] from wheel speeds. wheelbase: where the last
    number is a steering angle [m], else 0. unit: [rad] of one count. wrap: counts after which an encoder starts
    again, 0 if never. bounds (3,): fastest possible twist [m/s, m/s, rad/s]. longest_gap [s]. slip_window [s].
    growing: whether the covariance is the growing one. noise (7,): as in `WheelNoise`. lever [m]: at which a wheel
    turns the base. constant (3,): variance a second of (3.23). rounding (3,): variance of a reading [m², m², rad²].
    """

    signal: int
    forward: np.ndarray
    residual: np.ndarray
    wheelbase: float
    unit: float
    wrap: float
    ranges: np.ndarray
    fastest: float
    bounds: np.ndarray
    longest_gap: float
    slip_window: float
    growing: bool
    noise: np.ndarray
    lever: float
    constant: np.ndarray
    rounding: np.ndarray


@kernel
def _finite(values):
    total = 0.0
    for value in values:
        total += 0.0 * value
    return total == 0.0


@kernel
def _range(model, before, after, longest, seen):
    """Return the range after which counts start again: as stated, or as found, or 0 where they do not.

    It is found where all counts lie in a range, signed or not, and a step is larger than half of it, but what is left
    of it is no more than a wheel turns in `longest` [s]. seen (4,): least and greatest count, the range, and how often
    wheels started again.
    """
    if len(model.ranges) == 0:
        return model.wrap
    for wheel in range(len(after)):
        seen[0] = min(seen[0], before[wheel], after[wheel])
        seen[1] = max(seen[1], before[wheel], after[wheel])
    found = 0.0
    for size in model.ranges:
        signed = seen[0] >= -0.5001 * size and seen[1] <= 0.5001 * size
        unsigned = seen[0] >= -1e-4 * size and seen[1] <= 1.0001 * size
        if not (signed or unsigned):
            continue
        if seen[2] == size:
            found = size
        if found == 0.0 and model.fastest * longest < 0.5 * size:
            for wheel in range(len(after)):
                jump = abs(after[wheel] - before[wheel])
                if jump > 0.5 * size and size - jump <= model.fastest * longest:
                    found = size
    seen[2] = found
    if found > 0.0:
        for wheel in range(len(after)):
            seen[3] += abs(after[wheel] - before[wheel]) > 0.5 * found
    return found


@kernel
def _displacement(model, before, after, dt, wrap, xi):
    """Fill ξ (3,) of a step between two records of values (w,), (3.21); return how far [m] the wheels disagree."""
    disagreement = 0.0
    if model.signal == POSES:
        x, y, t = se2_between(before[0], before[1], before[2], after[0], after[1], after[2])
        xi[0], xi[1], xi[2] = se2_log(x, y, t)
        return disagreement
    xi[:] = 0.0
    for wheel in range(len(before)):
        if model.signal == RATES:
            turned = 0.5 * (before[wheel] + after[wheel]) * dt
        else:
            turned = after[wheel] - before[wheel]
            if wrap > 0.0:
                turned -= wrap * np.rint(turned / wrap)
            turned *= model.unit
        for i in range(3):
            xi[i] += model.forward[i, wheel] * turned
        if len(model.residual) > 0:
            disagreement += model.residual[wheel] * turned
    if model.wheelbase > 0.0:
        xi[2] = xi[0] * math.tan(0.5 * (before[-1] + after[-1])) / model.wheelbase
    return disagreement


@kernel
def _possible(model, xi, dt, interval):
    """Whether a robot can move by ξ in dt, or in the mean interval [s] where a late message made dt short."""
    if model.signal == RATES and dt > model.longest_gap:
        return False
    longest = max(dt, interval)
    bounds = model.bounds
    return abs(xi[0]) <= longest * bounds[0] and abs(xi[1]) <= longest * bounds[1] and abs(xi[2]) <= longest * bounds[2]


@kernel
def _slip(stamps, disagreement, last, window):
    """Return the record that starts the window ending at record `last`, its length [s], and the slip speed [m/s]."""
    total, first = 0.0, last
    while True:
        total += disagreement[first]  # of the step that ends at a record; it starts at the record before
        first -= 1
        if first == 0 or stamps[first - 1] < stamps[last] - window - _TOLERANCE:
            break
    span = stamps[last] - stamps[first]
    return first, span, total / span


@kernel
def _add_noise(xi, dt, noise, Q):
    """Add the error that arises on a step ξ (3,) of dt [s], in the axes of the moving base; noise as `WheelNoise`."""
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
def _spread(xi, Q, A, out):
    """∫₀¹ Ad(exp(-sξ)) Q Ad(exp(-sξ))ᵀ ds by Simpson's rule: exact on a straight line."""
    for i in range(3):
        for j in range(3):
            out[i, j] = 1.0 / 6.0 * Q[i, j]
    for s, weight in ((-0.5, 4.0 / 6.0), (-1.0, 1.0 / 6.0)):
        x, y, t = se2_exp(s * xi[0], s * xi[1], s * xi[2])
        add_transformed(x, y, t, weight, Q, A, out)


@kernel
def _covariance(model, xi, dt, slip, span, work, Q):
    """Fill Q (3, 3) of a step: its noise, and in each slip window ρ² for x, y and (ρ/k)² for θ, ρ = slip · span."""
    arising = work[0]
    arising[:] = 0.0
    if model.growing:
        _add_noise(xi, dt, model.noise, arising)
        if span > 0.0:
            variance = (slip * span) ** 2 * dt / span
            arising[0, 0] += variance
            arising[1, 1] += variance
            arising[2, 2] += variance / (model.lever * model.lever)
    else:
        for i in range(3):
            arising[i, i] = dt * model.constant[i]  # (3.23)
    _spread(xi, arising, work[1], Q)


@kernel
def _reading(xi, before, rounding, R):
    """Fill R (3, 3): the mean of ξξᵀ/3 over this step and the one before, and the rounding (3,)."""
    for i in range(3):
        for j in range(3):
            R[i, j] = xi[i] * xi[j] / 6.0 + before[i] * before[j] / 6.0
        R[i, i] += rounding[i]


@kernel
def advance(model, known, stamps, disagreement, values, before, seen, interval, intervals, ends, poses, Q, R, slip):
    """Take the records in rows `known` and following; fill the steps that they end, and compact what is remembered.

    stamps (m,), disagreement (m,): on entry `known` rows of used records, then the new ones; on return the used ones.
    values (1 + new, w): row 0 is the newest used record. before (3,): ξ of the last step, 0 where it was a break.
    seen (4,): as of `_range`.
    interval: mean interval [s] of `intervals` so far. ends (2, new), poses (new, 3), Q, R (new, 3, 3), slip (new,).
    Returns steps, first remembered row, last one, interval, intervals, and how many were refused, late, breaks.
    """
    xi, work = np.empty(3), np.empty((2, 3, 3))
    steps, first, last, refused, late, breaks = 0, 0, known - 1, 0, 0, 0
    for n in range(1, len(values)):
        stamp = stamps[known + n - 1]
        if not _finite(values[n]):
            refused += 1
            continue
        if last >= 0 and stamp <= stamps[last]:
            late += stamp < stamps[last]
            continue
        last += 1
        stamps[last], disagreement[last] = stamp, 0.0
        if last > 0:
            dt = stamp - stamps[last - 1]
            intervals += 1
            interval += (min(dt, model.longest_gap) - interval) / min(float(intervals), _AVERAGED)
            longest = max(dt, interval)
            wrap = _range(model, values[0], values[n], longest, seen)
            apart = _displacement(model, values[0], values[n], dt, wrap, xi)
            good = _possible(model, xi, dt, interval)
            if len(model.ranges) > 0 and wrap > 0.0 and model.fastest * longest >= 0.5 * wrap:
                good = False  # a wheel may have turned by more than half of its range
            if good:
                disagreement[last] = apart
            else:
                breaks += 1
                xi[:] = 0.0
            if intervals == 1:
                before[:] = xi
            span, first = 0.0, last
            if len(model.residual) > 0:
                first, span, slip[steps] = _slip(stamps, disagreement, last, model.slip_window)
            if good:
                ends[0, steps], ends[1, steps] = stamps[last - 1], stamp
                poses[steps, 0], poses[steps, 1], poses[steps, 2] = se2_exp(xi[0], xi[1], xi[2])
                _covariance(model, xi, dt, slip[steps], span, work, Q[steps])
                _reading(xi, before, model.rounding, R[steps])
                steps += 1
            before[:] = xi
        values[0] = values[n]
    return steps, first, last, interval, intervals, refused, late, breaks
