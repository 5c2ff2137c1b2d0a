"""Compiled ray tracing: which cells of a grid beams end in, and which they pass through."""

import math

from longreach.kernels import kernel


@kernel
def trace(starts, ends, hit, hits, passes):
    """Count in hits and passes (rows, columns) the cells of beams from starts to ends (k, 2) [cells].

    A beam passes through all cells before the one that it ends in, and there it has a hit where hit (k,) says so;
    where not, it passes through that one, too. Cells outside of the grid are left out.
    Source: Amanatides & Woo 1987, "A fast voxel traversal algorithm for ray tracing".
    """
    rows, columns = hits.shape
    for k in range(len(starts)):
        x, y = starts[k, 0], starts[k, 1]
        dx, dy = ends[k, 0] - x, ends[k, 1] - y
        c, r = math.floor(x), math.floor(y)
        last_c, last_r = math.floor(ends[k, 0]), math.floor(ends[k, 1])
        step_c, step_r = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        # When the beam, of length 1, meets the next border of a column or a row, and how long it takes through one.
        t_c = ((c + (dx > 0)) - x) / dx if dx != 0 else math.inf
        t_r = ((r + (dy > 0)) - y) / dy if dy != 0 else math.inf
        each_c, each_r = abs(1.0 / dx) if dx != 0 else math.inf, abs(1.0 / dy) if dy != 0 else math.inf
        for _ in range(abs(last_c - c) + abs(last_r - r)):
            if 0 <= r < rows and 0 <= c < columns:
                passes[r, c] += 1
            if (t_c < t_r and c != last_c) or r == last_r:
                c, t_c = c + step_c, t_c + each_c
            else:
                r, t_r = r + step_r, t_r + each_r
        if 0 <= last_r < rows and 0 <= last_c < columns:
            if hit[k]:
                hits[last_r, last_c] += 1
            else:
                passes[last_r, last_c] += 1


@kernel
def cast(origins, directions, occupied, free, farthest, ranges):
    """Fill ranges (k, b) [cells] from origins (k, 2) along unit vectors (b, 2) to the middle of the way through the
    first cell (rows, columns) that is occupied; infinite where none is, or behind more than two that are unknown: so
    many lie before a wall that not all beams end in.
    """
    rows, columns = occupied.shape
    for k in range(len(origins)):
        for b in range(len(directions)):
            x, y, dx, dy = origins[k, 0], origins[k, 1], directions[b, 0], directions[b, 1]
            c, r = math.floor(x), math.floor(y)
            step_c, step_r = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
            t_c = ((c + (dx > 0)) - x) / dx if dx != 0 else math.inf
            t_r = ((r + (dy > 0)) - y) / dy if dy != 0 else math.inf
            each_c, each_r = abs(1.0 / dx) if dx != 0 else math.inf, abs(1.0 / dy) if dy != 0 else math.inf
            t, ranges[k, b], unknown = 0.0, math.inf, 0
            while t < farthest and 0 <= r < rows and 0 <= c < columns:
                leaves = min(t_c, t_r)
                if occupied[r, c]:
                    ranges[k, b] = 0.5 * (t + leaves)
                    break
                unknown = 0 if free[r, c] else unknown + 1
                if unknown > 2:
                    break
                t = leaves
                if t_c < t_r:
                    c, t_c = c + step_c, t_c + each_c
                else:
                    r, t_r = r + step_r, t_r + each_r
