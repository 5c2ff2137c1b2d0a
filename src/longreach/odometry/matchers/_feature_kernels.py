"""Compiled features of a scan: its points in the base's frame, and the direction of the surface at each of them.

Features are rows of an array (FEATURES, m), one column a return, counter-clockwise:
0, 1: point x, y; 2, 3: unit vector of the beam; 4: range; 5, 6: unit normal of the surface, towards the laser (0, 0:
none was found); 7: variance of its direction over the variance of a range; 8: spacing of the returns on the surface.
"""

import math

import numpy as np

from longreach.geometry._kernels import se2_exp
from longreach.kernels import kernel

FEATURES = 9
_HALF = 12  # beams on either side that a normal is fitted to, at most
_RADIUS = 0.4  # [m] from the point, beyond two beams on either side
_ROUGH = 0.15  # variance across a surface over that along it, above which it has no direction
_GAP = 3.5  # spacings of beams on a surface seen head-on, between two returns of one surface
_SMALLEST_GAP = 0.15  # [m]
_SMALLEST_NOISE = 1e-3  # [m]: ranges that are rounded may show none, and a prior is not exact


@kernel
def smallest(values, k):
    """The number that k others of `values` precede in order (Hoare 1961). Shuffles them; numpy's compiles for long."""
    low, high = 0, len(values) - 1
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if j < k:
            low = i
        if k < i:
            high = j
    return values[k]


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
def _surface_ends(x, y, r, increment, first, last):
    """Fill first and last (n,) with the beams at which the surface that each beam sees begins and ends."""
    n = len(r)
    for u in range(n):
        first[u] = u
        if u > 0 and r[u] > 0.0 and r[u - 1] > 0.0:
            gap, dx, dy = max(_SMALLEST_GAP, _GAP * increment * r[u]), x[u] - x[u - 1], y[u] - y[u - 1]
            if dx * dx + dy * dy <= gap * gap:
                first[u] = first[u - 1]
    for u in range(n - 1, -1, -1):
        last[u] = last[u + 1] if u < n - 1 and first[u + 1] <= u else u


@kernel
def _window(x, y, u, step, end):
    """Return the last beam on one side of u (step ±1), not beyond `end`, that is near enough for its normal."""
    v = u + step * min(abs(end - u), _HALF)
    while abs(v - u) > 2:
        dx, dy = x[v] - x[u], y[v] - y[u]
        if dx * dx + dy * dy <= _RADIUS * _RADIUS:
            break
        v -= step
    return v


@kernel
def _prefix_sums(x, y, sums):
    """Fill sums (5, n + 1) of x, y, x², xy, y² over the beams before each."""
    sums[:, 0] = 0.0
    for u in range(len(x)):
        for k, value in enumerate((x[u], y[u], x[u] * x[u], x[u] * y[u], y[u] * y[u])):
            sums[k, u + 1] = sums[k, u] + value


@kernel
def _surface_direction(sums, lo, hi):
    """Total least squares line through beams lo..hi: normal, variance of the points across the line and along it."""
    m = hi - lo + 1
    sx, sy = (sums[0, hi + 1] - sums[0, lo]) / m, (sums[1, hi + 1] - sums[1, lo]) / m
    cxx = (sums[2, hi + 1] - sums[2, lo]) / m - sx * sx
    cxy = (sums[3, hi + 1] - sums[3, lo]) / m - sx * sy
    cyy = (sums[4, hi + 1] - sums[4, lo]) / m - sy * sy
    half = 0.5 * (cxx - cyy)
    root = math.sqrt(half * half + cxy * cxy)
    across, along = 0.5 * (cxx + cyy) - root, 0.5 * (cxx + cyy) + root
    nx, ny = (cxy, -half - root) if half > 0.0 else (half - root, cxy)  # of the two rows that are normal, the longer
    size = math.sqrt(nx * nx + ny * ny)
    if size == 0.0:
        return 1.0, 0.0, 1.0, 1.0
    return nx / size, ny / size, max(across, 0.0), max(along, 0.0)


@kernel
def scan_features(ranges, low, high, flipped, cos, sin, increment, mount, motion, share, features):
    """Fill features (FEATURES, n); return how many columns are used, σ̂ of the ranges and their median [m].

    mount (3,): the laser in the base. motion, share: as of `scan_points`, in the laser's frame.
    """
    n = len(ranges)
    x, y, r, space = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    m = scan_points(ranges, low, high, flipped, cos, sin, motion, share, x, y, r)
    noise = max(range_noise(x, y, r, space), _SMALLEST_NOISE)
    first, last, sums = np.empty(n, np.int64), np.empty(n, np.int64), np.empty((5, n + 1))
    _surface_ends(x, y, r, increment, first, last)
    _prefix_sums(x, y, sums)
    c, s, k = math.cos(mount[2]), math.sin(mount[2]), 0
    for u in range(n):
        if r[u] <= 0.0:
            continue
        lo, hi = _window(x, y, u, -1, first[u]), _window(x, y, u, 1, last[u])
        nx = ny = 0.0
        tilt, facing = math.inf, 1.0
        if hi - lo >= 2:
            nx, ny, across, along = _surface_direction(sums, lo, hi)
            if across > _ROUGH * along:
                nx = ny = 0.0
            else:
                facing = -(nx * x[u] + ny * y[u]) / r[u]
                if facing < 0.0:
                    nx, ny, facing = -nx, -ny, -facing
                tilt = max(across, noise * noise) / ((hi - lo + 1) * max(along, 1e-9) * noise * noise)
        dx, dy = x[u] / r[u], y[u] / r[u]
        features[0, k], features[1, k] = mount[0] + c * x[u] - s * y[u], mount[1] + s * x[u] + c * y[u]
        features[2, k], features[3, k] = c * dx - s * dy, s * dx + c * dy
        features[4, k] = space[k] = r[u]
        features[5, k], features[6, k] = c * nx - s * ny, s * nx + c * ny
        features[7, k] = tilt
        features[8, k] = r[u] * increment / max(facing, 0.15)
        k += 1
    return m, noise, smallest(space[:m], m // 2) if m > 0 else 1.0
