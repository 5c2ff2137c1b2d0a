"""Compiled lines of a scan: a straight line through the neighbours of each beam, as long as the data allow.

On a straight line the inverse range is linear in the beam's direction, 1/r = m · d with m = n/ρ, and the noise of a
range stays on its own side of the equation: unlike a line through points, the fit does not lean with the noise.
"""

import math

import numpy as np

from longreach.geometry._kernels import se2_exp
from longreach.kernels import kernel
from longreach.odometry._rank_kernels import smallest

_WIDTHS = (16, 8, 4, 2, 1)  # half widths of the windows tried [beams]
_STEEPEST = 0.1  # variance of a line's direction [rad²] above which it is none


@kernel
def scan_points(ranges, low, high, flipped, cos, sin, motion, share, x, y, r):
    """Fill x, y, r (n,) with the points of a scan, counter-clockwise, r = 0 where there was no return (REP-117).

    motion (3,): the laser's twist from scan to scan, share: the part of it that goes by from beam to beam; a point is
    carried to where the sweep began. Returns the number of points.
    """
    n, found = len(ranges), 0
    for u in range(n):
        i = n - 1 - u if flipped else u
        value = float(ranges[i])
        if not (value > 0.0 and value >= low and value <= high and value < math.inf):
            x[u], y[u], r[u] = 0.0, 0.0, 0.0
            continue
        found += 1
        x[u], y[u], r[u] = value * cos[u], value * sin[u], value
        if share > 0.0:
            part = share * i
            dx, dy, dt = se2_exp(part * motion[0], part * motion[1], part * motion[2])
            c, s = math.cos(dt), math.sin(dt)
            x[u], y[u] = c * x[u] - s * y[u] + dx, s * x[u] + c * y[u] + dy
            r[u] = math.sqrt(x[u] * x[u] + y[u] * y[u])
    return found


@kernel
def range_noise(x, y, r, space):
    """Deviation σ̂ [m] of the ranges: how far a beam lies from the line through its two neighbours.

    By the lower third of these distances, 0.431 σ where the noise is Gaussian: as much as two thirds may be clutter.
    """
    n, m = len(r), 0
    for u in range(1, n - 1):
        if r[u - 1] <= 0.0 or r[u] <= 0.0 or r[u + 1] <= 0.0:
            continue
        # on a line the inverse range is what the neighbours' directions make of theirs: d_u = a d_{u-1} + b d_{u+1}
        whole = (x[u - 1] * y[u + 1] - y[u - 1] * x[u + 1]) / (r[u - 1] * r[u + 1])
        a = (x[u] * y[u + 1] - y[u] * x[u + 1]) / (r[u] * r[u + 1] * whole + 1e-300)
        b = (x[u - 1] * y[u] - y[u - 1] * x[u]) / (r[u - 1] * r[u] * whole + 1e-300)
        off = 1.0 / r[u] - a / r[u - 1] - b / r[u + 1]
        variance = 1.0 / r[u] ** 4 + a * a / r[u - 1] ** 4 + b * b / r[u + 1] ** 4
        space[m] = abs(off) / math.sqrt(variance)
        m += 1
    return smallest(space[:m], (m - 1) // 3) / 0.4307 if m > 0 else 0.0


@kernel
def _prefix_sums(x, y, r, sums):
    """Fill sums (11, n + 1) of what `_window` takes differences of."""
    sums[:, 0] = 0.0
    for u in range(len(r)):
        for k in range(11):
            sums[k, u + 1] = sums[k, u]
        if r[u] > 0.0:
            i = 1.0 / r[u]
            c, s, i4 = x[u] * i, y[u] * i, i**4
            sums[0, u + 1] += 1.0
            sums[1, u + 1] += c * c
            sums[2, u + 1] += c * s
            sums[3, u + 1] += s * s
            sums[4, u + 1] += i * c
            sums[5, u + 1] += i * s
            sums[6, u + 1] += i * i
            sums[7, u + 1] += i4
            sums[8, u + 1] += i4 * c * c
            sums[9, u + 1] += i4 * c * s
            sums[10, u + 1] += i4 * s * s


@kernel
def _window(sums, lo, hi):
    """Least squares 1/r = m · d over beams lo..hi-1: m (2,), the variance of a range as found, and the count."""
    count = sums[0, hi] - sums[0, lo]
    cc, cs, ss = sums[1, hi] - sums[1, lo], sums[2, hi] - sums[2, lo], sums[3, hi] - sums[3, lo]
    det = cc * ss - cs * cs
    if count < 3.0 or det <= 1e-12 * count * count:
        return 0.0, 0.0, math.inf, 0.0
    ic, si, ii = sums[4, hi] - sums[4, lo], sums[5, hi] - sums[5, lo], sums[6, hi] - sums[6, lo]
    mx, my = (ss * ic - cs * si) / det, (cc * si - cs * ic) / det
    expected = (sums[7, hi] - sums[7, lo]) * (count - 2.0) / count  # a range's deviation σ is σ/r² of its inverse
    return mx, my, max(ii - mx * ic - my * si, 0.0) / expected, count


@kernel
def _spread(sums, lo, hi, ax, ay):
    """Variance of a · m over σ², by the sandwich M⁻¹ (Σ d dᵀ / r⁴) M⁻¹."""
    cc, cs, ss = sums[1, hi] - sums[1, lo], sums[2, hi] - sums[2, lo], sums[3, hi] - sums[3, lo]
    det = cc * ss - cs * cs
    bx, by = (ss * ax - cs * ay) / det, (cc * ay - cs * ax) / det
    kk, kl, ll = sums[8, hi] - sums[8, lo], sums[9, hi] - sums[9, lo], sums[10, hi] - sums[10, lo]
    return bx * bx * kk + 2.0 * bx * by * kl + by * by * ll


@kernel
def _widest(sums, u, n, variance):
    """Return beams lo, hi of the widest window about beam u whose residuals are no larger than the noise; 0, 0: none.

    Windows are centred, or shifted by up to half their width; of equally wide ones that which fits best is taken, so
    that corners stay sharp.
    """
    for half in _WIDTHS:
        least, first = math.inf, -1
        step = max(half // 2, 1)
        for shift in range(-half, half + 1, step):
            lo, hi = u + shift - half, u + shift + half + 1
            if lo < 0 or hi > n:
                continue
            _, _, found, count = _window(sums, lo, hi)
            spread = math.sqrt(2.0 / max(count - 2.0, 1.0))
            score = found * (1.0 + (0.5 * spread if shift != 0 else 0.0))
            if count >= half + 2 and found <= variance * (1.0 + 2.0 * spread) and score < least:
                least, first = score, lo
        if first >= 0:
            return first, first + 2 * half + 1
    return 0, 0


@kernel
def fit_lines(x, y, r, sigma, lines):
    """Fill lines (n, 5): normal n_x, n_y, distance ρ (0: no line), and the variances of range and direction over σ²."""
    n = len(r)
    sums = np.empty((11, n + 1))
    _prefix_sums(x, y, r, sums)
    for u in range(n):
        lines[u, 2] = 0.0
        if r[u] <= 0.0:
            continue
        lo, hi = _widest(sums, u, n, sigma * sigma)
        if hi == 0:
            continue
        mx, my, _, _ = _window(sums, lo, hi)
        size = math.sqrt(mx * mx + my * my)
        if not size > 0.0:
            continue
        nx, ny = mx / size, my / size
        tilt = _spread(sums, lo, hi, -ny, nx) / (size * size)
        if tilt * sigma * sigma < _STEEPEST:
            lines[u, 0], lines[u, 1], lines[u, 2] = nx, ny, 1.0 / size
            lines[u, 3] = _spread(sums, lo, hi, x[u] / r[u], y[u] / r[u]) * r[u] ** 4
            lines[u, 4] = tilt


@kernel
def beams_by_direction(x, y, r, cos, sin, increment, beams):
    """Fill beams (n,): which point lies in the direction of each beam, as a sweep in motion sees them elsewhere."""
    n = len(r)
    for u in range(n):
        beams[u] = u
    for u in range(n):
        if r[u] <= 0.0:
            continue
        off = (cos[u] * y[u] - sin[u] * x[u]) / (r[u] * increment)  # in beams; small, so sine for angle
        v = math.floor(u + off + 0.5)
        if 0 <= v < n and v != u:
            beams[v] = u
