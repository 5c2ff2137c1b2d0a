"""Compiled look at the beams of a scan at a place of a map: which of them the map explains, and which contradict it."""

import math

from longreach.kernels import kernel
from longreach.odometry._local_map_kernels import BLOCKS, CELL, SIDE

UNKNOWN, FREE, OCCUPIED = 0, 1, 2  # cells of a grid
_STEP = 0.05  # [m] along a beam
_CLEAR = 0.3  # [m] before a return, that may lie in front of its own surface
_HEAD_ON = 0.3  # cosine between beam and normal: below it, an error of the heading makes a beam graze a wall
_ASIDE = 0.06  # [m] along a surface from its middle in a cell, which are 0.1 m apart: beyond it there is a gap
_RETURNS = 3.0  # of a surface: fewer may be somebody who walked by


@kernel
def _cell(x, y, corner, grid):
    """Return a cell (UNKNOWN, …) of a grid of which the first begins at a corner (2,)."""
    i, k = math.floor((x - corner[0]) / CELL), math.floor((y - corner[1]) / CELL)
    return grid[i, k] if 0 <= i < grid.shape[0] and 0 <= k < grid.shape[1] else UNKNOWN


@kernel
def judge_beams(points, m, tolerance, pose, surfaces, on_map, corner, grid, verdicts):
    """Fill verdicts (m,) with 1 where a beam ends on a surface, -1 where it passes one or ends in free space, else 0.

    points: the features of a scan, in the frame of a base at a pose (3,) in a local map, and `on_map` (3,) in the grid.
    Space is free where the cells about it are, too.
    """
    origin, blocks, cells, elements = surfaces
    c, s, limit = math.cos(pose[2]), math.sin(pose[2]), SIDE * BLOCKS
    gc, gs = math.cos(on_map[2]), math.sin(on_map[2])
    for u in range(m):
        hx, hy = pose[0] + c * points[0, u] - s * points[1, u], pose[1] + s * points[0, u] + c * points[1, u]
        dx, dy = c * points[2, u] - s * points[3, u], s * points[2, u] + c * points[3, u]
        back, through, explained = _CLEAR, False, False
        while back < points[4, u] - _CLEAR and not through:
            i = math.floor((hx - back * dx - origin[0]) / CELL)
            k = math.floor((hy - back * dy - origin[1]) / CELL)
            back += _STEP
            if i < 0 or k < 0 or i >= limit or k >= limit or blocks[i // SIDE, k // SIDE] < 0:
                continue
            for layer in range(2):
                j = cells[blocks[i // SIDE, k // SIDE], i % SIDE, k % SIDE, layer]
                if j < 0 or elements[j, 4] < _RETURNS:
                    continue
                facing = dx * elements[j, 2] + dy * elements[j, 3]
                aside = dx * (elements[j, 1] - hy) - dy * (elements[j, 0] - hx)
                through = through or (abs(facing) > _HEAD_ON and abs(aside) < _ASIDE * abs(facing))
        verdicts[u] = -1
        if through:
            continue
        ix, iy = math.floor((hx - origin[0]) / CELL), math.floor((hy - origin[1]) / CELL)
        for i in range(max(ix - 2, 0), min(ix + 3, limit)):
            for k in range(max(iy - 2, 0), min(iy + 3, limit)):
                if explained or blocks[i // SIDE, k // SIDE] < 0:
                    continue
                for layer in range(2):
                    j = cells[blocks[i // SIDE, k // SIDE], i % SIDE, k % SIDE, layer]
                    if j < 0 or dx * elements[j, 2] + dy * elements[j, 3] > 0.0:
                        continue
                    ex, ey = hx - elements[j, 0], hy - elements[j, 1]
                    off = elements[j, 2] * ex + elements[j, 3] * ey
                    explained = explained or (abs(off) < tolerance and ex * ex + ey * ey < 4.0 * CELL * CELL)
        if explained:
            verdicts[u] = 1
            continue
        hx, hy = on_map[0] + gc * points[0, u] - gs * points[1, u], on_map[1] + gs * points[0, u] + gc * points[1, u]
        clear = True
        for i in range(-1, 2):
            for k in range(-1, 2):
                clear = clear and _cell(hx + i * CELL, hy + k * CELL, corner, grid) == FREE
        verdicts[u] = -1 if clear else 0


@kernel
def count_beams(verdicts, run):
    """Return how many beams (m,) are explained, and how many contradict, so many neighbours in a row or more."""
    explained, against, length = 0, 0, 0
    for u in range(len(verdicts)):
        explained += verdicts[u] > 0
        length = length + 1 if verdicts[u] < 0 else 0
        against += run if length == run else 1 if length > run else 0
    return explained, against
