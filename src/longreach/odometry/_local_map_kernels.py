"""Compiled local map: the surfaces that recent keyframes saw, merged into cells, and found again by where they are.

An element is a short piece of surface, a row of (k, ELEMENT): 0, 1: its middle; 2, 3: unit normal, towards the laser
that saw it; 4: how many returns it is the mean of; 5: information of its direction times the variance of a range.
Cells are kept in blocks, which exist only where there is a surface.
"""

import math
from collections import namedtuple

import numpy as np

from longreach.kernels import kernel

# The map's corner (2,); blocks (B, B): the number of each, -1 none; cells (b, C, C, 2): the elements of a cell, one for
# either side of a thin wall, -1 none; elements (m, ELEMENT).
Surfaces = namedtuple("Surfaces", "origin blocks cells elements")

ELEMENT = 6
CELL = 0.1  # [m]
SIDE = 16  # cells along a block
BLOCKS = 64  # along the map, which is 102 m wide
FINE = 2  # cells of the likelihood field along one of the map
COARSE = 4  # of those along one of the field of maxima
_PIECE = 0.04  # [m], length of the pieces of a keyframe
_SAME_SIDE = 0.3  # cosine of the angle between normals above which surfaces in a cell are one
_LONGEST = 1.0  # [m] of surface that one return stands for at most
PIECES = 10  # elements of a return at most: _LONGEST over CELL
_BLUR = 0.06  # [m], deviation of the likelihood about a surface


@kernel
def keyframe_elements(features, m, elements):
    """Fill elements (…, ELEMENT) with the surface of a scan: neighbouring returns merged, gaps between them filled.

    Returns how many there are. A return that is far from the next stands for the surface half way to it, in pieces.
    """
    k = 0
    x = y = nx = ny = count = info = begin_x = begin_y = 0.0
    for u in range(m + 1):
        far = u == m or features[7, u] == math.inf
        size = math.hypot(nx, ny)
        if count > 0.0 and (
            far
            or math.hypot(features[0, u] - begin_x, features[1, u] - begin_y) > _PIECE
            or nx * features[5, u] + ny * features[6, u] < _SAME_SIDE * size
        ):
            elements[k, 0], elements[k, 1] = x / count, y / count
            elements[k, 2], elements[k, 3] = nx / size, ny / size
            elements[k, 4], elements[k, 5] = count, info
            k += 1
            x = y = nx = ny = count = info = 0.0
        if far or k >= len(elements) - 1:
            continue
        pieces = max(int(min(features[8, u], _LONGEST) / CELL + 0.5), 1)
        if pieces > 1:
            length = min(features[8, u], _LONGEST)
            for i in range(pieces):
                if k >= len(elements) - 1:
                    break
                along = ((i + 0.5) / pieces - 0.5) * length
                elements[k, 0] = features[0, u] - along * features[6, u]
                elements[k, 1] = features[1, u] + along * features[5, u]
                elements[k, 2], elements[k, 3] = features[5, u], features[6, u]
                elements[k, 4], elements[k, 5] = 1.0 / pieces, 1.0 / (pieces * features[7, u])
                k += 1
            continue
        if count == 0.0:
            begin_x, begin_y = features[0, u], features[1, u]
        x += features[0, u]
        y += features[1, u]
        nx += features[5, u]
        ny += features[6, u]
        count += 1.0
        info += 1.0 / features[7, u]
    return k


@kernel
def find_blocks(seen, origin, blocks, at):
    """Fill at (k, 2) with the cell of each element, -1 outside the map, and number the blocks that have any."""
    count = 0
    for i in range(len(seen)):
        ix, iy = math.floor((seen[i, 0] - origin[0]) / CELL), math.floor((seen[i, 1] - origin[1]) / CELL)
        if ix < 0 or iy < 0 or ix >= SIDE * BLOCKS or iy >= SIDE * BLOCKS:
            at[i, 0] = -1
            continue
        at[i, 0], at[i, 1] = ix, iy
        if blocks[ix // SIDE, iy // SIDE] < 0:
            blocks[ix // SIDE, iy // SIDE] = count
            count += 1
    return count


@kernel
def merge(seen, at, surfaces):
    """Merge elements (k, ELEMENT) of keyframes, in the map's frame, by cells `at` (k, 2); return how many remain."""
    _, blocks, cells, merged = surfaces
    n = 0
    for i in range(len(seen)):
        ix, iy = at[i, 0], at[i, 1]
        if ix < 0:
            continue
        b, u, v = blocks[ix // SIDE, iy // SIDE], ix % SIDE, iy % SIDE
        w, nx, ny = seen[i, 4], seen[i, 2], seen[i, 3]
        for layer in range(2):
            j = cells[b, u, v, layer]
            if j < 0:
                j = cells[b, u, v, layer] = n
                n += 1
                merged[j] = 0.0
            elif merged[j, 2] * nx + merged[j, 3] * ny <= _SAME_SIDE * math.sqrt(merged[j, 2] ** 2 + merged[j, 3] ** 2):
                continue
            for c in range(4):
                merged[j, c] += w * seen[i, c]
            merged[j, 4] += w
            merged[j, 5] += seen[i, 5]
            break
    for j in range(n):  # sums become means
        w, size = merged[j, 4], math.hypot(merged[j, 2], merged[j, 3])
        merged[j, 0] /= w
        merged[j, 1] /= w
        merged[j, 2] /= size
        merged[j, 3] /= size
    return n


@kernel
def likelihood_field(elements, origin, first, field, pooled):
    """Fill field, 0 to 255: how near the middle of a fine cell is to a surface; and pooled: the maximum about it.

    first (2,): the fine cell of the map at which the field begins. A coarse cell knows of two fine ones beside it.
    """
    fine, reach = CELL / FINE, 2
    along, across = np.empty(2 * reach + 1), np.empty(2 * reach + 1)
    for j in range(len(elements)):
        x, y = (elements[j, 0] - origin[0]) / fine - first[0], (elements[j, 1] - origin[1]) / fine - first[1]
        ix, iy = int(x) - reach, int(y) - reach
        for i in range(2 * reach + 1):
            along[i] = 255.0 * math.exp(-0.5 * ((ix + i + 0.5 - x) * fine / _BLUR) ** 2)
            across[i] = math.exp(-0.5 * ((iy + i + 0.5 - y) * fine / _BLUR) ** 2)
        for i in range(ix, ix + 2 * reach + 1):
            for k in range(iy, iy + 2 * reach + 1):
                value = np.uint8(along[i - ix] * across[k - iy])
                if value <= field[i, k]:
                    continue
                field[i, k] = value
                for u in ((i - 2) // COARSE, (i + 2) // COARSE):
                    for v in ((k - 2) // COARSE, (k + 2) // COARSE):
                        pooled[u, v] = max(pooled[u, v], value)


@kernel
def surface_rows(points, m, stride, pose, surfaces, radius, grazing, rows):
    """Fill rows (8, …) with the returns of a scan that see a surface of the map, every `stride`th; return how many.

    pose (3,): of the base in the map. The surface at a point is the implicit moving least squares mean of the elements
    within `radius` that face the laser (Kolluri 2008). A row is the derivative a (3,) of the distance e from it, e, its
    weight 1/variance over σ², the map's share of the noise over the scan's own, the lever about the surface's direction
    and the variance of that over σ².
    """
    n, reach = 0, max(int(radius / CELL), 1)
    origin, blocks, cells, elements = surfaces
    c, s, narrow = math.cos(pose[2]), math.sin(pose[2]), 1.0 / (radius * radius)
    for u in range(0, m, stride):
        rx, ry = c * points[0, u] - s * points[1, u], s * points[0, u] + c * points[1, u]
        qx, qy = rx + pose[0], ry + pose[1]
        dx, dy = c * points[2, u] - s * points[3, u], s * points[2, u] + c * points[3, u]
        px, py = c * points[5, u] - s * points[6, u], s * points[5, u] + c * points[6, u]
        has_normal = points[7, u] < math.inf
        ix, iy = math.floor((qx - origin[0]) / CELL), math.floor((qy - origin[1]) / CELL)
        if ix < reach or iy < reach or ix >= SIDE * BLOCKS - reach or iy >= SIDE * BLOCKS - reach:
            continue
        weight = distance = nx = ny = info = 0.0
        for i in range(ix - reach, ix + reach + 1):
            for k in range(iy - reach, iy + reach + 1):
                b = blocks[i // SIDE, k // SIDE]
                if b < 0:
                    continue
                for layer in range(2):
                    j = cells[b, i % SIDE, k % SIDE, layer]
                    if j < 0:
                        break
                    ex, ey = qx - elements[j, 0], qy - elements[j, 1]
                    d2 = ex * ex + ey * ey
                    near = 1.0 - d2 * narrow
                    if near <= 0.0 or elements[j, 2] * dx + elements[j, 3] * dy > 0.0:
                        continue
                    if has_normal and elements[j, 2] * px + elements[j, 3] * py < 0.5:
                        continue
                    near *= near * near
                    w = near * elements[j, 4]
                    weight += w
                    distance += w * (elements[j, 2] * ex + elements[j, 3] * ey)
                    nx += w * elements[j, 2]
                    ny += w * elements[j, 3]
                    info += near * elements[j, 5]
        size = math.sqrt(nx * nx + ny * ny)
        if weight < 1e-3 or size < 0.9 * weight:
            continue
        nx /= size
        ny /= size
        facing = nx * dx + ny * dy
        density = weight / (0.914 * radius)  # returns a metre: the integral of (1 - s²/radius²)³ is 32/35 radius
        rows[0, n] = nx * c + ny * s
        rows[1, n] = ny * c - nx * s
        rows[2, n] = ny * rx - nx * ry
        rows[3, n] = distance / weight
        rows[4, n] = 1.0 / ((facing * facing + grazing * grazing) * (1.0 + 1.0 / max(weight, 0.1)))
        rows[5, n] = 1.0 / (points[8, u] * max(density, 1e-3))
        rows[6, n] = nx * rx + ny * ry
        rows[7, n] = 1.0 / max(info, 1e-12)
        n += 1
    return n
