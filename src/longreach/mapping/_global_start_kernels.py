"""Compiled branch and bound over a whole map: all places where many points agree with it, apart from each other.

As `_loop_closure_kernels.descend`, which gives one place in a window: Hess et al. 2016, (6)-(17).
"""

import math

import numpy as np

from longreach.kernels import kernel
from longreach.mapping._loop_closure_kernels import LEVELS, _bound


@kernel
def turned_cells(points, cell, cells):
    """Fill cells (t, 2, m) with how many cells each point (2, m) is from the base, for t turns about the circle."""
    for a in range(len(cells)):
        t = 2.0 * math.pi * a / len(cells)
        c, s = math.cos(t), math.sin(t)
        for p in range(points.shape[1]):
            cells[a, 0, p] = math.floor((c * points[0, p] - s * points[1, p]) / cell + 0.5)
            cells[a, 1, p] = math.floor((s * points[0, p] + c * points[1, p]) / cell + 0.5)


@kernel
def square_bounds(level, cells, width, squares, bounds):
    """Fill bounds (t, q) with those of squares (q, 2) of `width` cells, by their first cells."""
    for a in range(len(cells)):
        for q in range(len(squares)):
            bounds[a, q] = _bound(level, cells, a, squares[q, 0], squares[q, 1], width)


@kernel
def _is_covered(found, count, i, k, a, width, value, apart, turns, circle):
    """Whether a place that is found already is better than all of a square of cells, and no further than `apart`."""
    half = 0.5 * (width - 1)
    for h in range(count):
        if value > found[h, 3]:
            continue
        turn = abs(found[h, 2] - a)
        near = math.hypot(i + half - found[h, 0], k + half - found[h, 1]) + 1.5 * half <= apart
        if near and min(turn, circle - turn) <= turns:
            return True
    return False


@kernel
def _taken(found, count, i, k, a, value, apart, turns, circle):
    """Take a place among those found, in place of worse ones that are near it, or of the worst; return how many."""
    kept = 0
    for h in range(count):
        turn = abs(found[h, 2] - a)
        near = math.hypot(i - found[h, 0], k - found[h, 1]) <= apart and min(turn, circle - turn) <= turns
        if not near:
            found[kept] = found[h]
            kept += 1
    at = kept
    if kept == len(found):
        at = int(np.argmin(found[:, 3]))
        if found[at, 3] >= value:
            return kept
    found[at, 0], found[at, 1], found[at, 2], found[at, 3] = i, k, a, value
    return max(kept, at + 1)


@kernel
def places(levels, cells, top, squares, bounds, order, apart, turns, part, least, found):
    """Fill found (n, 4) with cell, turn and agreement of the best places, apart from each other; return how many.

    bounds (t, q): of squares (q, 2), by `order` best first. apart, turns: in cells and turns, within which two places
    are one. part: of the best agreement that a place has at least, which is `least` or more, of 255 a point.
    """
    circle, count, best = len(cells), 0, 0.0
    stack, value = np.empty((4 * LEVELS + 4, 4), np.int64), np.empty(4 * LEVELS + 4)
    flat = bounds.ravel()
    for r in order:
        limit = max(least, part * best)
        if flat[r] <= limit:
            break
        a, q = r // len(squares), r % len(squares)
        stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = a, squares[q, 0], squares[q, 1], top
        value[0], size = flat[r], 1
        while size > 0:
            size -= 1
            a, i, k, h = stack[size, 0], stack[size, 1], stack[size, 2], stack[size, 3]
            v = value[size]
            if v <= max(least, part * best):
                continue
            if _is_covered(found, count, i, k, a, 1 << h, v, apart, turns, circle):
                continue
            if h == 0:
                count = _taken(found, count, i, k, a, v, apart, turns, circle)
                best = max(best, v)
                continue
            half = 1 << (h - 1)
            for w in range(4):
                ci, ck = i + half * (w // 2), k + half * (w % 2)
                bound = _bound(levels[h - 1], cells, a, ci, ck, half)
                if bound > max(least, part * best):
                    at = size  # the best child is put on the stack last
                    while at > 0 and stack[at - 1, 3] == h - 1 and value[at - 1] > bound and at > size - w:
                        at -= 1
                    for move in range(size, at, -1):
                        stack[move] = stack[move - 1]
                        value[move] = value[move - 1]
                    stack[at, 0], stack[at, 1], stack[at, 2], stack[at, 3] = a, ci, ck, h - 1
                    value[at] = bound
                    size += 1
    return count
