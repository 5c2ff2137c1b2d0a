"""Compiled step through all levels: strict priorities, ranges that bind only when they would be left, limits of a step.

The rows of all tasks stand one after the other: A (M, n) their Jacobian, a (M,) the speed each wants, `starts` where
each level begins. Rows of a range (`ranged`) take part only while `active`; then they want `goal`. A step dq keeps to
the range where floor <= A dq <= ceiling. `setting` (levels, 5) is method, λ, rank tolerance, σ0 and v of each level's
inverse, `reach` (levels, n) and `longest` (levels, blocks) its bounds where it is selective. Row 0 of low and high
(2, n) is the room for ranges and for the first level of equations, row 1 that for all below.
"""

import math

import numpy as np

from longreach.kernels import kernel
from longreach.planning._hierarchy_kernels import factor, level_step

SICILIANO_SLOTINE, CHIAVERINI = 0, 1
_ZERO = np.int64(0)  # numba compiles what it calls with a plain 0 once more for that number
_POOL = 6  # ranges whose 2^6 modes are tried; what else would be left just binds


@kernel
def workspace(M, n):
    """Room for `descend`: V, W (n, n), L (M, n), b, y (M,), M (M, M), x (n,), rows (M,)."""
    return (
        np.empty((n, n)), np.empty((n, n)), np.empty((M, n)), np.empty(M), np.empty(M), np.empty((M, M)),
        np.empty(n), np.empty(M, dtype=np.int64),
    )  # fmt: skip


@kernel(fastmath={"contract"})
def _add_share(x, low, high, dq):
    """dq += s x with the largest s <= 1 that keeps low <= dq <= high; return ‖s x‖."""
    share = 1.0
    for k in range(len(dq)):
        if x[k] > 0.0 and dq[k] + share * x[k] > high[k]:
            share = max((high[k] - dq[k]) / x[k], 0.0)
        elif x[k] < 0.0 and dq[k] + share * x[k] < low[k]:
            share = max((low[k] - dq[k]) / x[k], 0.0)
    square = 0.0
    for k in range(len(dq)):
        dq[k] += share * x[k]
        square += x[k] * x[k]
    return share * math.sqrt(square)


@kernel(fastmath={"contract"})
def _project(V, rank, x):
    """x becomes (I - VᵀV) x over the first `rank` rows."""
    n = len(x)
    for _ in range(2):
        for j in range(rank):
            along = 0.0
            for k in range(n):
                along += V[j, k] * x[k]
            for k in range(n):
                x[k] -= along * V[j, k]


@kernel(fastmath={"contract"})
def _along(A, row, dq):
    total = 0.0
    for k in range(len(dq)):
        total += A[row, k] * dq[k]
    return total


@kernel
def descend(A, a, starts, ranged, active, goal, scheme, setting, reach, longest, z, low, high, work, parts, dq):
    """dq (n,) of one choice of active ranges; parts (levels + 1,): how far each level's part of it goes."""
    V, W, L, b, y, M, x, rows = work
    rank, part = _ZERO, 0
    for k in range(len(dq)):
        dq[k] = 0.0
    for level in range(len(starts) - 1):
        m = _ZERO
        for r in range(starts[level], starts[level + 1]):
            if active[r] or not ranged[r]:
                rows[m] = r
                b[m] = goal[r] if ranged[r] else a[r]
                if scheme == SICILIANO_SLOTINE:
                    b[m] -= _along(A, r, dq)
                m += 1
        parts[level] = 0.0
        if m == 0:
            continue
        tolerance = setting[level, 2]
        inverse = (setting[level, 0], setting[level, 1], tolerance, setting[level, 3], setting[level, 4], reach[level],
                   longest[level])  # fmt: skip
        if scheme == SICILIANO_SLOTINE:
            basis, known = V, rank
        else:
            basis, known = W, _ZERO
        new = factor(A, rows, m, tolerance, basis, known, L)
        level_step(
            L, m, basis, known, new, inverse, b, (M, y), x
        )  # (4.16), any number of levels, or the second of (4.17)
        if scheme == CHIAVERINI or setting[level, 3] > 0.0:  # a filter moves along directions that are lost, too
            _project(V, rank, x)
        if scheme == CHIAVERINI:
            new = factor(A, rows, m, tolerance, V, rank, L)
        rank = new
        parts[level] = _add_share(x, low[part], high[part], dq)
        if not ranged[starts[level]]:
            part = 1
    for k in range(len(dq)):
        x[k] = z[k]
    _project(V, rank, x)  # (4.15)
    parts[len(starts) - 1] = _add_share(x, low[part], high[part], dq)


@kernel
def _leaving(A, ranged, active, floor, ceiling, dq, goal, pool, size):
    """Add to the pool the ranges that dq leaves and that do not bind; return its size and whether there was any."""
    any_left = False
    for r in range(len(ranged)):
        if not ranged[r] or active[r]:
            continue
        moved = _along(A, r, dq)
        slack = 1e-12 * (1.0 + abs(moved))
        if moved >= floor[r] - slack and moved <= ceiling[r] + slack:
            continue
        any_left = True
        known = False
        for i in range(size):
            known |= pool[i] == r
        if not known:
            goal[r] = floor[r] if moved < floor[r] else ceiling[r]
            pool[size] = r
            size += 1
    return size, any_left


@kernel
def _activate(active, pool, size, mode):
    """Of the pool's first few ranges those in the bits of `mode` bind, and of the others all."""
    for r in range(len(active)):
        active[r] = False
    for i in range(size):
        active[pool[i]] = i >= _POOL or ((mode >> i) & 1) == 1


@kernel
def _bits(mode):
    count = 0
    while mode:
        count += mode & 1
        mode >>= 1
    return count


@kernel
def step(A, a, starts, ranged, active, goal, floor, ceiling, scheme, setting, reach, longest, z, low, high, pool, work,
         parts, dq):  # fmt: skip
    """dq (n,) in the least restrictive mode in which every range that does not bind is kept (Moe et al. 2016).

    The ranges at stake are those that a mode before would have left; `active` tells which bind in the end.
    """
    size = _ZERO
    while True:
        before = size
        tried = min(size, _POOL)
        for count in range(tried + 1):
            if count == 0 and 0 < size <= _POOL:
                continue  # nothing binds: that was tried first
            for mode in range(1 << tried):
                if _bits(mode) != count:
                    continue
                _activate(active, pool, size, mode)
                descend(
                    A, a, starts, ranged, active, goal, scheme, setting, reach, longest, z, low, high, work, parts, dq
                )
                size, left = _leaving(A, ranged, active, floor, ceiling, dq, goal, pool, size)
                if not left:
                    return
                if size > before:
                    break
            if size > before:
                break
