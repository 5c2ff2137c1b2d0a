"""Compiled scan pyramid: smoothing, subsampling, and the warp of a scan into another pose.

A pyramid is one flat array; level l occupies [start[l], start[l + 1]). Ranges are metres, 0 is null.
Loops over beams run with fastmath, so nothing infinite or NaN may enter (the face replaces them by 0).
"""

import math

from longreach.geometry._kernels import se2_exp
from longreach.kernels import kernel


@kernel
def clean(ranges, low, high, flipped, out):
    """Fill out (n,) with the ranges in counter-clockwise order, 0 where there was no return (REP-117)."""
    n = len(ranges)
    for u in range(n):
        r = ranges[n - 1 - u] if flipped else ranges[u]
        out[u] = r if r > 0.0 and r >= low and r <= high and r < math.inf else 0.0


@kernel(fastmath=True)
def _smooth_beam(r, u, n, reach):
    """Bilateral mask [1 4 6 4 1] · (reach - |Δr|): neighbours across an edge have no part in the mean."""
    centre = r[u]
    weight = 6.0 * reach
    total = weight * centre
    for step in range(1, 3):
        mask = 4.0 if step == 1 else 1.0
        if u >= step:
            w = mask * max(0.0, reach - abs(r[u - step] - centre))
            weight += w
            total += w * r[u - step]
        if u + step < n:
            w = mask * max(0.0, reach - abs(r[u + step] - centre))
            weight += w
            total += w * r[u + step]
    return total / weight


@kernel(fastmath=True)
def build_pyramid(ranges, start, reach, out):
    """Step 1: smooth each level, then keep every second beam for the next."""
    n = len(ranges)
    source = ranges
    for level in range(len(start) - 1):
        target = out[start[level] : start[level + 1]]
        if level == 0:
            for u in range(n):
                target[u] = _smooth_beam(source, u, n, reach) if source[u] > 0.0 else 0.0
        else:
            for u in range(len(target)):
                target[u] = _smooth_beam(source, 2 * u, n, reach) if source[2 * u] > 0.0 else 0.0
        source = target
        n = len(target)


@kernel(fastmath=True)
def _atan_ratio(y, x):
    """atan2(y, x), by its series to 1e-9 where the angle is small, which it nearly always is between two scans."""
    if x > 0.0 and abs(y) < 0.2 * x:
        z = y / x
        z2 = z * z
        return z * (1.0 - z2 * (1 / 3 - z2 * (1 / 5 - z2 * (1 / 7 - z2 * (1 / 9 - z2 / 11)))))
    return math.atan2(y, x)


@kernel(fastmath=True)
def warp(r, cos, sin, increment, x, y, theta, warped, weight):
    """Step 2: carry the new scan by the motion (x, y, θ) into the old one's beams.

    Each point gives its range to its two neighbouring beams, weighted by nearness. (Nearness squared, as in the 2016
    code, hides rotations of less than a beam: its heading error at 1081 beams is four times larger.)
    """
    n = len(r)
    ct, st = math.cos(theta), math.sin(theta)
    for u in range(n):
        warped[u] = 0.0
        weight[u] = 0.0
    for u in range(n):
        if r[u] <= 0.0:
            continue
        px, py = r[u] * cos[u], r[u] * sin[u]
        qx, qy = ct * px - st * py + x, st * px + ct * py + y
        position = u + _atan_ratio(cos[u] * qy - sin[u] * qx, cos[u] * qx + sin[u] * qy) / increment
        if position < 0.0 or position > n - 1:
            continue
        distance = math.sqrt(qx * qx + qy * qy)
        left = min(int(position), n - 2)
        to_left = position - left
        w = 1.0 - to_left
        warped[left] += w * distance
        weight[left] += w
        w = to_left
        warped[left + 1] += w * distance
        weight[left + 1] += w
    for u in range(n):
        warped[u] = warped[u] / weight[u] if weight[u] > 1e-3 else 0.0


@kernel(fastmath=True)
def deskew(r, cos, sin, increment, motion, share, flipped, out, weight):
    """Fill out (n,) with the ranges as they would be seen from where the sweep began.

    motion (3,): the sensor's twist from scan to scan; share: the part of it that goes by from beam to beam.
    """
    n = len(r)
    for u in range(n):
        out[u] = 0.0
        weight[u] = 0.0
    for u in range(n):
        if r[u] <= 0.0:
            continue
        part = share * (n - 1 - u if flipped else u)
        x, y, t = se2_exp(part * motion[0], part * motion[1], part * motion[2])
        c, s = math.cos(t), math.sin(t)
        px, py = r[u] * cos[u], r[u] * sin[u]
        qx, qy = c * px - s * py + x, s * px + c * py + y
        position = u + _atan_ratio(cos[u] * qy - sin[u] * qx, cos[u] * qx + sin[u] * qy) / increment
        distance = math.sqrt(qx * qx + qy * qy)
        left = math.floor(position)
        for v in range(left, left + 2):
            if v >= 0 and v < n:
                w = 1.0 - abs(position - v)
                if weight[v] > 0.0 and abs(out[v] / weight[v] - distance) > 0.3:  # two surfaces: the nearer hides
                    if distance < out[v] / weight[v]:
                        out[v], weight[v] = w * distance, w
                    continue
                out[v] += w * distance
                weight[v] += w
    for u in range(n):
        out[u] = out[u] / weight[u] if weight[u] > 1e-3 else 0.0


@kernel
def sampling_error(ranges, increment, x, y, theta, share):
    """Deviation [m] of a translation because two scans sample a surface at other points.

    A share of the distance between points, or of what they moved where that is less: at rest the same points are seen.
    """
    total, n = 0.0, 0
    for r in ranges:
        if r > 0.0:
            total += r
            n += 1
    distance = total / max(n, 1)
    return share * min(distance * increment, math.hypot(x, y) + distance * abs(theta))
