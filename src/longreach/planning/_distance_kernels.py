"""Compiled distances between a segment and a segment, and between a segment and a box.

Each gives the signed distance and the two nearest points: `out` is [near point on the segment, near point on the other,
unit vector from the other to the segment]. A capsule is a segment with a radius, a disc on the floor an endless upright
one, so that these two are all that is needed.
Source: Ericson, "Real-Time Collision Detection" (2005), section 5.1.9; the distance to a box is convex along a segment.
"""

import math

import numpy as np

from longreach.kernels import kernel

_NONE = 1e-12  # [m]
_HALVINGS = 60


@kernel
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def _between(x, least, most):
    return min(max(x, least), most)


@kernel
def _put(a, u, s, b, v, t, normal, out):
    """Fill out from the points a + s u and b + t v; return their distance. `normal` serves where they coincide."""
    square = 0.0
    for i in range(3):
        out[0, i], out[1, i] = a[i] + s * u[i], b[i] + t * v[i]
        out[2, i] = out[0, i] - out[1, i]
        square += out[2, i] ** 2
    distance = math.sqrt(square)
    for i in range(3):
        out[2, i] = out[2, i] / distance if distance > _NONE else normal[i]
    return distance


@kernel
def segment_segment(a, b, c, d, out):
    """Distance [m] of the segments ab and cd."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv, uw, vw = _dot(u, u), _dot(v, v), _dot(u, v), _dot(u, w), _dot(v, w)
    s, t = 0.0, 0.0
    if uu > _NONE**2:
        area = uu * vv - uv * uv
        if area > 1e-14 * uu * vv:
            s = _between((uv * vw - uw * vv) / area, 0.0, 1.0)
        elif vv > _NONE**2:  # parallel: the middle of where they overlap
            first, last = -uw / uu, (uv - uw) / uu
            low, high = max(min(first, last), 0.0), min(max(first, last), 1.0)
            s = _between(0.5 * (low + high), 0.0, 1.0)
    if vv > _NONE**2:
        t = (vw + s * uv) / vv
        if t < 0.0 or t > 1.0:
            t = _between(t, 0.0, 1.0)
            if uu > _NONE**2:
                s = _between((t * uv - uw) / uu, 0.0, 1.0)
    elif uu > _NONE**2:
        s = _between(-uw / uu, 0.0, 1.0)
    normal = np.array([u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]])
    size = math.sqrt(_dot(normal, normal))
    normal = normal / size if size > _NONE else np.array([1.0, 0.0, 0.0])
    return _put(a, u, s, c, v, t, normal, out)


@kernel
def _slope(a, u, half, s):
    """Derivative along the segment of half the squared distance to the box."""
    total = 0.0
    for i in range(3):
        x = a[i] + s * u[i]
        total += (x - _between(x, -half[i], half[i])) * u[i]
    return total


@kernel
def _way_out(a, u, half, out):
    """Fill out for the shortest push along an axis that frees the segment from the box; return minus its length."""
    enter, leave = 0.0, 1.0
    for i in range(3):
        if abs(u[i]) > _NONE:
            first, last = (-half[i] - a[i]) / u[i], (half[i] - a[i]) / u[i]
            enter, leave = max(enter, min(first, last)), min(leave, max(first, last))
    best, s, axis, side = np.inf, 0.0, 0, 1.0
    for i in range(3):
        for sign in (-1.0, 1.0):
            x, y = sign * (a[i] + enter * u[i]), sign * (a[i] + leave * u[i])
            depth = half[i] - min(x, y)
            if depth < best:
                best, axis, side = depth, i, sign
                s = enter if x < y else leave
                if abs(x - y) < 1e-9:
                    s = 0.5 * (enter + leave)
    for i in range(3):
        out[0, i] = out[1, i] = a[i] + s * u[i]
        out[2, i] = side if i == axis else 0.0
    out[1, axis] = side * half[axis]
    return -best


@kernel
def segment_box(a, b, half, out):
    """Signed distance [m] of the segment ab and the box of these half sizes about the origin, negative inside."""
    u = b - a
    low, high = 0.0, 1.0
    if _slope(a, u, half, 0.0) >= 0.0:
        high = 0.0
    elif _slope(a, u, half, 1.0) <= 0.0:
        low = 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if _slope(a, u, half, middle) < 0.0:
            low = middle
        else:
            high = middle
    s = 0.5 * (low + high)
    near = np.empty(3)
    for i in range(3):
        near[i] = _between(a[i] + s * u[i], -half[i], half[i])
    distance = _put(a, u, s, near, u, 0.0, u, out)
    return _way_out(a, u, half, out) if distance <= _NONE else distance
