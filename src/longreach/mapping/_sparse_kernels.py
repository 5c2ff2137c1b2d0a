"""Compiled sparse factorisation H = L D Lᵀ over 3 × 3 blocks, and what the factor is good for.

Poses are rows of H in the order of elimination. L is unit lower triangular by columns: those of column j are at
start[j]:start[j + 1] of `rows`, ascending. `diagonal` (n, 3, 3) and `blocks` (nnz, 3, 3) hold H, then the factor.
Source: Davis 2006, "Direct methods for sparse linear systems", chapter 4.
"""

import math

from longreach.kernels import kernel


@kernel
def tree(start_a, columns_a, parent, ancestor, mark, start):
    """Fill parent (n,) of the elimination tree, and start (n + 1,) of L; row k of H has columns_a[start_a[k]:...].

    parent, ancestor and mark (n,) come as -1, start as 0.
    """
    for k in range(len(parent)):
        for p in range(start_a[k], start_a[k + 1]):
            j = columns_a[p]
            while j != -1 and j < k:
                following = ancestor[j]
                ancestor[j] = k
                if following == -1:
                    parent[j] = k
                j = following
    for k in range(len(parent)):
        mark[k] = k
        for p in range(start_a[k], start_a[k + 1]):
            j = columns_a[p]
            while mark[j] != k:
                mark[j] = k
                start[j + 1] += 1
                j = parent[j]
    for k in range(len(parent)):
        start[k + 1] += start[k]


@kernel
def pattern(start_a, columns_a, parent, mark, fill, rows):
    """Fill rows (nnz,) of L; mark (n,) comes as -1, fill as where each column starts."""
    for k in range(len(parent)):
        mark[k] = k
        for p in range(start_a[k], start_a[k + 1]):
            j = columns_a[p]
            while mark[j] != k:
                mark[j] = k
                rows[fill[j]] = k
                fill[j] += 1
                j = parent[j]


@kernel
def _cholesky(D, k):
    """Overwrite D[k] (3, 3) with its lower factor; return whether it is positive definite."""
    a = D[k, 0, 0]
    if not a > 0.0:
        return False
    a = math.sqrt(a)
    b, d = D[k, 1, 0] / a, D[k, 2, 0] / a
    c = D[k, 1, 1] - b * b
    if not c > 1e-14 * D[k, 1, 1]:
        return False
    c = math.sqrt(c)
    e = (D[k, 2, 1] - d * b) / c
    f = D[k, 2, 2] - d * d - e * e
    if not f > 1e-14 * D[k, 2, 2]:
        return False
    D[k, 0, 0], D[k, 1, 0], D[k, 1, 1], D[k, 2, 0], D[k, 2, 1], D[k, 2, 2] = a, b, c, d, e, math.sqrt(f)
    return True


@kernel
def _divide(G, k, X, p):
    """X[p] ← X[p] G[k]⁻ᵀ with G[k] lower triangular."""
    for r in range(3):
        x = X[p, r, 0] / G[k, 0, 0]
        y = (X[p, r, 1] - x * G[k, 1, 0]) / G[k, 1, 1]
        X[p, r, 0], X[p, r, 1] = x, y
        X[p, r, 2] = (X[p, r, 2] - x * G[k, 2, 0] - y * G[k, 2, 1]) / G[k, 2, 2]


@kernel
def _subtract_square(A, a, out, o):
    """out[o] −= A[a] A[a]ᵀ."""
    for r in range(3):
        for c in range(3):
            out[o, r, c] -= A[a, r, 0] * A[a, c, 0] + A[a, r, 1] * A[a, c, 1] + A[a, r, 2] * A[a, c, 2]


@kernel
def _subtract_column(A, rows, place, p, end):
    """A[place of row q] −= A[q] A[p]ᵀ for the rows q of a column below p; A[p] in scalars: A may not be read again."""
    xx, xy, xt = A[p, 0, 0], A[p, 0, 1], A[p, 0, 2]
    yx, yy, yt = A[p, 1, 0], A[p, 1, 1], A[p, 1, 2]
    tx, ty, tt = A[p, 2, 0], A[p, 2, 1], A[p, 2, 2]
    for q in range(p + 1, end):
        o = place[rows[q]]
        for r in range(3):
            x, y, t = A[q, r, 0], A[q, r, 1], A[q, r, 2]
            A[o, r, 0] -= x * xx + y * xy + t * xt
            A[o, r, 1] -= x * yx + y * yy + t * yt
            A[o, r, 2] -= x * tx + y * ty + t * tt


@kernel
def factorize(start, rows, diagonal, blocks, waiting, following, at, place):
    """Overwrite H with Cholesky's factor G, H = G Gᵀ; return whether H is positive definite.

    Left-looking: waiting[k] heads a list of the columns whose next row to use is k.
    waiting (n,) comes as -1; following, at and place (n,) are room.
    """
    n = len(diagonal)
    for k in range(n):
        at[k] = start[k]
        for p in range(start[k], start[k + 1]):
            place[rows[p]] = p
        j = waiting[k]
        while j != -1:
            after, p = following[j], at[j]
            _subtract_square(blocks, p, diagonal, k)
            _subtract_column(blocks, rows, place, p, start[j + 1])
            at[j] = p + 1
            if p + 1 < start[j + 1]:
                following[j], waiting[rows[p + 1]] = waiting[rows[p + 1]], j
            j = after
        if not _cholesky(diagonal, k):
            return False
        for p in range(start[k], start[k + 1]):
            _divide(diagonal, k, blocks, p)
        if start[k] < start[k + 1]:
            following[k], waiting[rows[start[k]]] = waiting[rows[start[k]]], k
    return True


@kernel
def solve(start, rows, diagonal, blocks, y):
    """Overwrite y (n, 3) with H⁻¹ y, by Cholesky's factor G."""
    for j in range(len(y)):
        y[j, 0] /= diagonal[j, 0, 0]
        y[j, 1] = (y[j, 1] - diagonal[j, 1, 0] * y[j, 0]) / diagonal[j, 1, 1]
        y[j, 2] = (y[j, 2] - diagonal[j, 2, 0] * y[j, 0] - diagonal[j, 2, 1] * y[j, 1]) / diagonal[j, 2, 2]
        for p in range(start[j], start[j + 1]):
            for r in range(3):
                for s in range(3):
                    y[rows[p], r] -= blocks[p, r, s] * y[j, s]
    for j in range(len(y) - 1, -1, -1):
        for p in range(start[j], start[j + 1]):
            for r in range(3):
                for s in range(3):
                    y[j, s] -= blocks[p, r, s] * y[rows[p], r]
        y[j, 2] /= diagonal[j, 2, 2]
        y[j, 1] = (y[j, 1] - diagonal[j, 2, 1] * y[j, 2]) / diagonal[j, 1, 1]
        y[j, 0] = (y[j, 0] - diagonal[j, 1, 0] * y[j, 1] - diagonal[j, 2, 0] * y[j, 2]) / diagonal[j, 0, 0]


@kernel
def _subtract(A, a, B, b, out, o):
    """out[o] −= A[a] B[b]."""
    for r in range(3):
        x, y, t = A[a, r, 0], A[a, r, 1], A[a, r, 2]
        for c in range(3):
            out[o, r, c] -= x * B[b, 0, c] + y * B[b, 1, c] + t * B[b, 2, c]


@kernel
def _subtract_transposed(A, a, B, b, out, o):
    """out[o] −= A[a]ᵀ B[b]."""
    for r in range(3):
        x, y, t = A[a, 0, r], A[a, 1, r], A[a, 2, r]
        for c in range(3):
            out[o, r, c] -= x * B[b, 0, c] + y * B[b, 1, c] + t * B[b, 2, c]


@kernel
def marginals(start, rows, blocks, S, S_blocks, place):
    """Fill the blocks of S = H⁻¹ on the diagonal (n, 3, 3) and where L has some (nnz, 3, 3): Takahashi's recursion.

    From S = D⁻¹ L⁻¹ + (I − Lᵀ) S, columns last to first. S comes as D⁻¹, S_blocks as 0, place (n,) as -1.
    Source: Erisman & Tinney 1975.
    """
    for j in range(len(S) - 1, -1, -1):
        for p in range(start[j], start[j + 1]):
            place[rows[p]] = p
        for p in range(start[j], start[j + 1]):
            k = rows[p]
            _subtract(S, k, blocks, p, S_blocks, p)
            for q in range(start[k], start[k + 1]):
                at = place[rows[q]]
                if at >= 0:
                    _subtract(S_blocks, q, blocks, p, S_blocks, at)
                    _subtract_transposed(S_blocks, q, blocks, at, S_blocks, p)
        for p in range(start[j], start[j + 1]):
            _subtract_transposed(blocks, p, S_blocks, p, S, j)
            place[rows[p]] = -1


@kernel
def inverse_column(parent, start, rows, inverses, blocks, column, wanted, needed, X, Y):
    """Fill Y (n, 3, 3) with the blocks of −H⁻¹ in a column, in the rows `wanted` (w,) and those that they need.

    A row needs only the rows above it in the elimination tree, and so does the column.
    needed (n,) comes as False, X (n, 3, 3) as the column of the identity, Y as 0.
    """
    for w in range(len(wanted)):
        j = wanted[w]
        while j != -1 and not needed[j]:
            needed[j] = True
            j = parent[j]
    j = column
    while j != -1:  # L⁻¹ X
        for p in range(start[j], start[j + 1]):
            _subtract(blocks, p, X, j, X, rows[p])
        j = parent[j]
    for j in range(len(parent) - 1, -1, -1):  # −L⁻ᵀ D⁻¹ of it
        if needed[j]:
            _subtract(inverses, j, X, j, Y, j)
            for p in range(start[j], start[j + 1]):
                _subtract_transposed(blocks, p, Y, rows[p], Y, j)
