"""Compiled slip: learned from corrections of the pose, and the way that it makes.

What is known of a slip are rows (7, 3), by axis, in the order of the names below, and numbers: see `wheel_slip.Slip`.
"""

import math

from longreach.geometry._kernels import se2_between, se2_log
from longreach.kernels import kernel

RATE, VARIANCE, TOGETHER, ALONE, LAST, LAST_BUT_ONE, LEFT = range(7)
_LASTS = 1.0  # [s], time constant of the process: as long as a base takes to start or to stop
_MEMORY = 40.0  # corrections over which products are averaged; a second of a fast scanner
_CHANCE = 0.3  # correlation that may come by chance: two deviations
_FASTEST = 1.0  # [m/s, rad/s]: what is more is a bump
_GAP = 0.5  # [s] between corrections, after which the last has nothing to do with the next
_REGULAR = 0.1  # of the time between corrections, that stamps may be off by: rates over shorter times are noise


@kernel
def fading(t):
    """What is left of a rate after t [s]."""
    return math.exp(-t / _LASTS)


@kernel
def _lasting(rows, mean, off, i):
    """The variance of the process in axis i: none where corrections are as white as they may be by chance."""
    return 0.0 if off > _REGULAR * mean else max(rows[TOGETHER, i] - _CHANCE * rows[ALONE, i], 0.0)


@kernel
def correct(rows, seen, mean, off, r, before, after, stamp, coupled, out):
    """Take that the pose was off by r (3,) and moved from one pose (3,) to another for that; fills out (7, 3).

    mean, off [s]: time between corrections, and how far off it they are. Returns both as they are now.
    """
    dt = stamp - seen
    fade = fading(dt) if 0.0 < dt < math.inf else 0.0
    moved = se2_log(*se2_between(before[0], before[1], before[2], after[0], after[1], after[2]))
    for i in range(3):
        out[RATE, i], out[LEFT, i], out[LAST, i], out[LAST_BUT_ONE, i] = fade * rows[RATE, i], r[i] - moved[i], 0.0, 0.0
        for row in (VARIANCE, TOGETHER, ALONE):
            out[row, i] = rows[row, i]
    if not 0.0 < dt <= _GAP:
        return mean, off
    mean, off = mean + (dt - mean) / _MEMORY, off + (abs(dt - mean) - off) / _MEMORY
    lasts = False
    for i in range(3):
        rate = min(max(coupled[i] * ((r[i] - rows[LEFT, i]) / dt + out[RATE, i]), -_FASTEST), _FASTEST)
        out[TOGETHER, i] += (rate * rows[LAST_BUT_ONE, i] - rows[TOGETHER, i]) / _MEMORY
        out[ALONE, i] += (rate * rate - rows[ALONE, i]) / _MEMORY
        out[LAST_BUT_ONE, i], out[LAST, i] = rows[LAST, i], rate
        lasts = lasts or _lasting(out, mean, off, i) > 0.0
    for i in range(3):
        lasting, alone, gain = _lasting(out, mean, off, i), out[ALONE, i], 0.0
        variance = fade * fade * rows[VARIANCE, i] + (1.0 - fade * fade) * lasting if lasts else 0.0
        if lasting > 0.0:
            gain = variance / (variance + max(alone - max(out[TOGETHER, i], 0.0), 0.01 * alone))
        out[RATE, i] = out[RATE, i] + gain * (out[LAST, i] - out[RATE, i]) if lasting > 0.0 else 0.0
        out[VARIANCE, i] = (1.0 - gain) * variance
    return mean, off


@kernel
def possible(rows, speed):
    """The part of the rate that a base slips by that drives at a speed [m/s]: one that stands does not."""
    most = math.hypot(rows[RATE, 0], rows[RATE, 1])
    return min(1.0, speed / most) if most > 0.0 else 1.0


@kernel
def way(rows, seen, mean, off, speed, begin, end, xi, variance):
    """Fill ξ (3,), that is slipped from one time to another [s], and its variance (3,), which grows with time."""
    t0, t1, part = max(begin - seen, 0.0), max(end - seen, 0.0), possible(rows, speed)
    for i in range(3):
        xi[i], variance[i] = _LASTS * (fading(t0) - fading(t1)) * (part * rows[RATE, i]), 0.0
        for sign, t in ((1.0, t1), (-1.0, t0)):
            rate = rows[VARIANCE, i] + _lasting(rows, mean, off, i) * min(1.0, 2.0 * t / _LASTS)
            variance[i] += sign * (rate * t * t / (1.0 + 0.5 * t / _LASTS))
