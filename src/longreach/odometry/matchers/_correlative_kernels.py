"""Compiled correlative search: where in a window a scan agrees best with the likelihood field of a local map.

Two resolutions (Olson 2009): every pose of a coarse grid on a field of maxima, then the best of them on the fine one.
"""

import math

import numpy as np

from longreach.kernels import kernel
from longreach.odometry._local_map_kernels import CELL, COARSE, FINE

_FEW = 60  # beams that take part
_KEPT = 12  # coarse poses that are looked at finely
_FARTHEST = 6.0  # [m]: beyond, a step of the angle may move a point by more than a cell
_PRIOR = 0.02  # of the agreement, that a pose one deviation from the prior loses
_THROUGH = 0.5  # of the agreement, that a pose loses if every beam passes through a surface
_SURFACE = 153  # of 255, above which the field is that of a surface
_CLEAR = 0.3  # [m] before a return, in which a beam may graze its own surface


@kernel
def _turn(points, m, stride, t, scale, turned):
    """Fill turned (2, n) with every `stride`th point at a heading, in cells of 1/scale [m]; return n."""
    c, s, n = math.cos(t) * scale, math.sin(t) * scale, 0
    for u in range(0, m, stride):
        turned[0, n], turned[1, n] = c * points[0, u] - s * points[1, u], s * points[0, u] + c * points[1, u]
        n += 1
    return n


@kernel
def _score(turned, n, x, y, field, least):
    """Return the mean agreement of turned points at a position in the field's cells, or less if it is not `least`."""
    total, spare = 0.0, n * (1.0 - least) + 1e-6
    for u in range(n):
        i, k = int(x + turned[0, u]), int(y + turned[1, u])  # the field begins with zeros, so that -0.5 may be 0
        if i >= 0 and k >= 0 and i < field.shape[0] and k < field.shape[1]:
            total += field[i, k] / 255.0
        if total + spare < u + 1:
            break
    return total / n


@kernel
def _through(points, m, stride, x, y, t, origin, first, field):
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
            i = int((hx - back * dx - origin[0]) * scale - first[0])
            k = int((hy - back * dy - origin[1]) * scale - first[1])
            if i >= 0 and k >= 0 and i < field.shape[0] and k < field.shape[1] and field[i, k] > _SURFACE:
                through += 1
                break
            back += CELL
    return through / n


@kernel
def search(points, m, guess, sigma, window, origin, first, field, pooled, best):
    """Fill best (3,) with the pose about a guess (3,) at which the scan agrees best, and return how well, 0 to 1.

    Where that is only at the edge of the window, best stays as it is.
    sigma (3,): deviations of the guess [m, m, rad], along its own axes; window: how many of them are searched.
    origin, first, field, pooled: of a map, as of `likelihood_field`.
    """
    stride = max(m // _FEW, 1)
    farthest = 0.5
    for u in range(0, m, stride):
        farthest = max(farthest, min(math.hypot(points[0, u], points[1, u]), _FARTHEST))
    fine = CELL / FINE
    coarse, turn = COARSE * fine, COARSE * fine / farthest
    nx, ny = math.ceil(window * sigma[0] / coarse), math.ceil(window * sigma[1] / coarse)
    nt = math.ceil(window * sigma[2] / turn)
    turned, corner = np.empty((2, m)), (origin[0] + first[0] * fine, origin[1] + first[1] * fine)
    cg, sg = math.cos(guess[2]), math.sin(guess[2])
    kept, at = np.full(_KEPT, -math.inf), np.zeros((_KEPT, 3))
    for it in range(-nt, nt + 1):
        n = _turn(points, m, stride, guess[2] + it * turn, 1.0 / coarse, turned)
        for ix in range(-nx, nx + 1):
            for iy in range(-ny, ny + 1):
                off = (ix * coarse / sigma[0]) ** 2 + (iy * coarse / sigma[1]) ** 2 + (it * turn / sigma[2]) ** 2
                if off > (window + 1.0) ** 2:
                    continue
                x, y = guess[0] + (cg * ix - sg * iy) * coarse, guess[1] + (sg * ix + cg * iy) * coarse
                x, y, loss = (x - corner[0]) / coarse, (y - corner[1]) / coarse, _PRIOR * off
                value = _score(turned, n, x, y, pooled, kept[_KEPT - 1] + loss) - loss
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
            ft = at[k, 2] + 0.25 * it
            t = guess[2] + ft * turn
            n = _turn(points, m, stride, t, 1.0 / fine, turned)
            for ix in range(-2, 3):
                for iy in range(-2, 3):
                    fx, fy = at[k, 0] + 0.25 * ix, at[k, 1] + 0.25 * iy
                    off = (fx * coarse / sigma[0]) ** 2 + (fy * coarse / sigma[1]) ** 2 + (ft * turn / sigma[2]) ** 2
                    x, y = guess[0] + (cg * fx - sg * fy) * coarse, guess[1] + (sg * fx + cg * fy) * coarse
                    u, v, loss = (x - corner[0]) / fine, (y - corner[1]) / fine, _PRIOR * off
                    value = _score(turned, n, u, v, field, tops[k] + loss) - loss
                    if value > tops[k]:
                        tops[k] = value
                        poses[k, 0], poses[k, 1], poses[k, 2] = x, y, t
        top = max(top, tops[k])
    final = -math.inf
    for k in range(_KEPT):
        edge = abs(at[k, 2]) >= nt or abs(at[k, 0]) >= max(nx, 2) or abs(at[k, 1]) >= max(ny, 2)
        if tops[k] <= final or tops[k] < 0.8 * top or edge:
            continue  # what is best at the edge of the window may be better beyond
        x, y, t = poses[k]
        value = tops[k] - _THROUGH * _through(points, m, stride, x, y, t, origin, first, field)
        if value > final:
            final = value
            best[0], best[1], best[2] = x, y, t
    return top
