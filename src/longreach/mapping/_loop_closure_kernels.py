"""Compiled branch and bound: where in a window many points agree best with the likelihood field of a local map.

Source: Hess et al. 2016, "Real-time loop closure in 2D LIDAR SLAM", (6)-(17). A level h of the pyramid holds the
maximum over 2^h × 2^h cells from each cell on, so that the agreement there bounds that of all poses below it.
"""

import math

import numpy as np

from longreach.kernels import kernel
from longreach.odometry._local_map_kernels import BLOCKS, CELL, SIDE

LEVELS = 6  # 0 to 5: a cell of the last is 32 wide
_STEP = 0.05  # [m] along a beam
_CLEAR = 0.3  # [m] before a return, that may lie in front of its own surface
_HEAD_ON = 0.3  # cosine between beam and normal: below it, an error of the heading makes a beam graze a wall
_RETURNS = 3.0  # of a surface: fewer may be somebody who walked by


@kernel
def pyramid(field, levels):
    """Fill levels (LEVELS, n, m) with maxima over 2^h cells of a field (2n, 2m), whose cells are half as wide."""
    n, m = levels.shape[1], levels.shape[2]
    for i in range(n):
        for k in range(m):
            a, b = max(field[2 * i, 2 * k], field[2 * i, 2 * k + 1]), field[2 * i + 1, 2 * k]
            levels[0, i, k] = max(a, max(b, field[2 * i + 1, 2 * k + 1]))
    for h in range(1, len(levels)):
        step = 1 << (h - 1)
        for i in range(n):
            low = min(i + step, n - 1)
            for k in range(m):
                right = min(k + step, m - 1)
                a, b = max(levels[h - 1, i, k], levels[h - 1, i, right]), levels[h - 1, low, k]
                levels[h, i, k] = max(a, max(b, levels[h - 1, low, right]))


@kernel
def _bound(level, cells, angle, i, k, first):
    """Return the sum of a level over the points of an angle, moved by (i, k) cells.

    What lies before the field's first cell is read at it as far as the 2^h cells (`first`) reach into the field.
    """
    n, m, total = level.shape[0], level.shape[1], 0
    for p in range(cells.shape[2]):
        u, v = cells[angle, 0, p] + i, cells[angle, 1, p] + k
        if u > -first and v > -first and u < n and v < m:
            total += level[max(u, 0), max(v, 0)]
    return total


@kernel
def _is_allowed(x, y, t, information, limit, apart, found, along):
    """Whether a motion from the window's middle is in the ellipse, and further than `apart` from the pose found."""
    e = information
    off = x * (e[0, 0] * x + 2.0 * e[0, 1] * y + 2.0 * e[0, 2] * t) + y * (e[1, 1] * y + 2.0 * e[1, 2] * t)
    if off + t * t * e[2, 2] > limit:
        return False
    dx, dy, dt = x - found[0], y - found[1], t - found[2]
    free = dx * along[0] + dy * along[1]
    return math.hypot(dx - free * along[0], dy - free * along[1]) > apart or abs(dt) > apart / 3.0


@kernel
def place_points(points, corner, cell, middle, sizes, turn, cells):
    """Fill cells (2 nt + 1, 2, m) with the cell of each point (2, m) for each turn about the window's middle (3,)."""
    for a in range(len(cells)):
        t = middle[2] + (a - sizes[2]) * turn
        c, s = math.cos(t), math.sin(t)
        for p in range(points.shape[1]):
            x, y = c * points[0, p] - s * points[1, p] + middle[0], s * points[0, p] + c * points[1, p] + middle[1]
            cells[a, 0, p] = math.floor((x - corner[0]) / cell)
            cells[a, 1, p] = math.floor((y - corner[1]) / cell)


@kernel
def root_bounds(level, cells, width, sizes, roots):
    """Fill roots (2 nt + 1, rx, ry) with the bounds of squares of `width` cells that cover the window."""
    for a in range(roots.shape[0]):
        for i in range(roots.shape[1]):
            for k in range(roots.shape[2]):
                roots[a, i, k] = _bound(level, cells, a, i * width - sizes[0], k * width - sizes[1], width)


@kernel
def descend(levels, cells, top, sizes, roots, order, steps, information, limit, apart, found, along, least, at):
    """Fill at (3,) with the motion from the window's middle that agrees best; return how well, 0 to 1: above `least`.

    roots (r,): bounds, by `order` best first. steps (2,): a cell [m] and a turn [rad]. information (3, 3), limit: of
    the ellipse in the window. apart [m]: of motions that do not count, about a motion `found` (3,); a distance along
    the unit vector `along` (2,) has no part in it.
    """
    nx, ny, nt = sizes
    whole, width = 255.0 * cells.shape[2], 1 << top
    rx, ry = (2 * nx) // width + 1, (2 * ny) // width + 1
    best = least * whole
    stack, value = np.empty((4 * LEVELS + 4, 4), np.int64), np.empty(4 * LEVELS + 4)
    bounds, rows = np.empty(4), np.empty((4, 2), np.int64)
    for r in order:
        if roots[r] <= best:
            break
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = r // (rx * ry), (r // ry) % rx * width, r % ry * width, top
        value[0], size = roots[r], 1
        while size > 0:
            size -= 1
            if value[size] <= best:
                continue
            a, i, k, h = stack[size, 0], stack[size, 1], stack[size, 2], stack[size, 3]
            if h == 0:
                x, y, t = (i - nx) * steps[0], (k - ny) * steps[0], (a - nt) * steps[1]
                if i <= 2 * nx and k <= 2 * ny and _is_allowed(x, y, t, information, limit, apart, found, along):
                    best = value[size]
                    at[0], at[1], at[2] = x, y, t
                continue
            half = 1 << (h - 1)
            for q in range(4):
                rows[q, 0], rows[q, 1] = i + half * (q // 2), k + half * (q % 2)
                bounds[q] = _bound(levels[h - 1], cells, a, rows[q, 0] - nx, rows[q, 1] - ny, half)
            for _ in range(4):  # the best child is put on the stack last
                q = 0
                for w in range(1, 4):
                    if bounds[w] < bounds[q]:
                        q = w
                if bounds[q] > best and bounds[q] < math.inf:
                    stack[size, 0], stack[size, 1], stack[size, 2], stack[size, 3] = a, rows[q, 0], rows[q, 1], h - 1
                    value[size] = bounds[q]
                    size += 1
                bounds[q] = math.inf
    return best / whole


@kernel
def seen_through(points, m, stride, pose, surfaces):
    """Return the share of every `stride`th of m beams that passes through a surface, not grazing it, on its way.

    points: the features of a scan, in the frame of a base at a pose (3,) in the map.
    """
    origin, blocks, cells, elements = surfaces
    c, s, through, n = math.cos(pose[2]), math.sin(pose[2]), 0, 0
    for u in range(0, m, stride):
        n += 1
        hx, hy = pose[0] + c * points[0, u] - s * points[1, u], pose[1] + s * points[0, u] + c * points[1, u]
        dx, dy = c * points[2, u] - s * points[3, u], s * points[2, u] + c * points[3, u]
        back, found = _CLEAR, False
        while back < points[4, u] - _CLEAR and not found:
            i = math.floor((hx - back * dx - origin[0]) / CELL)
            k = math.floor((hy - back * dy - origin[1]) / CELL)
            back += _STEP
            if i < 0 or k < 0 or i >= SIDE * BLOCKS or k >= SIDE * BLOCKS or blocks[i // SIDE, k // SIDE] < 0:
                continue
            for layer in range(2):
                j = cells[blocks[i // SIDE, k // SIDE], i % SIDE, k % SIDE, layer]
                if j >= 0 and elements[j, 4] >= _RETURNS:
                    found = found or abs(dx * elements[j, 2] + dy * elements[j, 3]) > _HEAD_ON
        through += found
    return through / n
