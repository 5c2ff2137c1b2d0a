"""Compiled correlative search: where in a window a scan agrees best with the likelihood field of a local map.

Two resolutions (Olson 2009): every pose of a coarse grid on a field of maxima, then the best of them on the fine one.
"""

import math

import numpy as np

from longreach.kernels import kernel
from longreach.odometry._local_map_kernels import BLOCKS, CELL, COARSE, FINE, SIDE

_FEW = 60  # beams that take part
_KEPT = 12  # coarse poses that are looked at finely
_FARTHEST = 6.0  # [m]: beyond, a step of the angle may move a point by more than a cell
_PRIOR = 0.02  # of the agreement, that a pose one deviation from the prior loses
_THROUGH = 0.5  # of the agreement, that a pose loses if every beam passes through a surface
_CLEAR = 0.3  # [m] before a return, in which a beam may graze its own surface


@kernel
def _value(field, blocks, x, y, pooled):
    """Return the field (0 to 1) at a point in fine cells from the origin; pooled: the maximum about it."""
    side = FINE * SIDE
    if x < 0.0 or y < 0.0:
        return 0.0
    i, k = int(x), int(y)
    bi, bk = i // side, k // side
    if bi >= BLOCKS or bk >= BLOCKS or blocks[bi, bk] < 0:
        return 0.0
    if pooled:
        return field[blocks[bi, bk], (i % side) // COARSE, (k % side) // COARSE] / 255.0
    return field[blocks[bi, bk], i % side, k % side] / 255.0


@kernel
def _score(points, m, stride, x, y, t, origin, blocks, field, pooled):
    """Return the mean agreement of a scan's points at a pose."""
    scale = FINE / CELL
    c, s, total, n = math.cos(t) * scale, math.sin(t) * scale, 0.0, 0
    px, py = (x - origin[0]) * scale, (y - origin[1]) * scale
    for u in range(0, m, stride):
        total += _value(
            field, blocks, px + c * points[0, u] - s * points[1, u], py + s * points[0, u] + c * points[1, u], pooled
        )
        n += 1
    return total / n


@kernel
def _through(points, m, stride, x, y, t, origin, blocks, field):
    """Return the share of beams that pass through a surface of the map on their way."""
    scale = FINE / CELL
    c, s, through, n = math.cos(t), math.sin(t), 0, 0
    for u in range(0, m, stride):
        n += 1
        length = points[4, u] - _CLEAR
        hx, hy = x + c * points[0, u] - s * points[1, u], y + s * points[0, u] + c * points[1, u]
        dx, dy = c * points[2, u] - s * points[3, u], s * points[2, u] + c * points[3, u]
        back = _CLEAR
        while back < length:
            value = _value(
                field, blocks, (hx - back * dx - origin[0]) * scale, (hy - back * dy - origin[1]) * scale, False
            )
            if value > 0.6:
                through += 1
                break
            back += CELL
    return through / n


@kernel
def search(points, m, guess, sigma, window, origin, blocks, field, pooled, best):
    """Fill best (3,) with the pose about a guess (3,) at which the scan agrees best, and return how well, 0 to 1.

    Where that is only at the edge of the window, best stays as it is.

    sigma (3,): deviations of the guess [m, m, rad], along its own axes; window: how many of them are searched.
    """
    stride = max(m // _FEW, 1)
    farthest = 0.5
    for u in range(0, m, stride):
        farthest = max(farthest, min(math.hypot(points[0, u], points[1, u]), _FARTHEST))
    fine = CELL / FINE
    coarse, turn = COARSE * fine, COARSE * fine / farthest
    nx, ny = math.ceil(window * sigma[0] / coarse), math.ceil(window * sigma[1] / coarse)
    nt = math.ceil(window * sigma[2] / turn)
    cg, sg = math.cos(guess[2]), math.sin(guess[2])
    kept, at = np.full(_KEPT, -math.inf), np.zeros((_KEPT, 3))
    for it in range(-nt, nt + 1):
        for ix in range(-nx, nx + 1):
            for iy in range(-ny, ny + 1):
                off = (ix * coarse / sigma[0]) ** 2 + (iy * coarse / sigma[1]) ** 2 + (it * turn / sigma[2]) ** 2
                if off > (window + 1.0) ** 2:
                    continue
                x = guess[0] + (cg * ix - sg * iy) * coarse
                y = guess[1] + (sg * ix + cg * iy) * coarse
                value = _score(points, m, stride, x, y, guess[2] + it * turn, origin, blocks, pooled, True)
                value -= _PRIOR * off
                if value > kept[_KEPT - 1]:
                    k = _KEPT - 1
                    while k > 0 and kept[k - 1] < value:
                        kept[k] = kept[k - 1]
                        at[k] = at[k - 1]
                        k -= 1
                    kept[k] = value
                    at[k, 0], at[k, 1], at[k, 2] = ix, iy, it
    top = -math.inf
    tops, poses = np.full(_KEPT, -math.inf), np.zeros((_KEPT, 3))
    for k in range(_KEPT):
        if kept[k] <= max(top, -1e300):
            break  # the maxima bound what is below them
        for it in range(-2, 3):
            for ix in range(-2, 3):
                for iy in range(-2, 3):
                    fx, fy, ft = at[k, 0] + 0.25 * ix, at[k, 1] + 0.25 * iy, at[k, 2] + 0.25 * it
                    off = (fx * coarse / sigma[0]) ** 2 + (fy * coarse / sigma[1]) ** 2 + (ft * turn / sigma[2]) ** 2
                    x = guess[0] + (cg * fx - sg * fy) * coarse
                    y = guess[1] + (sg * fx + cg * fy) * coarse
                    t = guess[2] + ft * turn
                    value = _score(points, m, stride, x, y, t, origin, blocks, field, False) - _PRIOR * off
                    if value > tops[k]:
                        tops[k] = value
                        poses[k, 0], poses[k, 1], poses[k, 2] = x, y, t
        top = max(top, tops[k])
    final = -math.inf
    for k in range(_KEPT):
        edge = abs(at[k, 2]) >= nt or abs(at[k, 0]) >= max(nx, 2) or abs(at[k, 1]) >= max(ny, 2)
        if tops[k] == -math.inf or tops[k] < 0.8 * top or edge:
            continue  # what is best at the edge of the window may be better beyond
        x, y, t = poses[k]
        value = tops[k] - _THROUGH * _through(points, m, stride, x, y, t, origin, blocks, field)
        if value > final:
            final = value
            best[0], best[1], best[2] = x, y, t
    return top
