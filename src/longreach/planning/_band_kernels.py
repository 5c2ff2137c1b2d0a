"""Compiled algebra of symmetric matrices with a narrow band, as neighbouring waypoints make them.

Of a matrix of width w, B[i, w - 1 - o] is the entry (i, i - o): each row of B ends on the diagonal.
"""

import math

from longreach.kernels import kernel


@kernel
def add_links(Z, coefficients, curvature, B):
    """Add to B (N p, w) what ½ Σ curvature · difference² has for second derivative in z, q = Z z, Z (N, n, p).

    coefficients (k, width) and curvature (k, n) are those of each difference between neighbours.
    """
    n, p, w = Z.shape[1], Z.shape[2], B.shape[1]
    for k in range(len(coefficients)):
        for i in range(coefficients.shape[1]):
            for j in range(i + 1):
                weight = coefficients[k, i] * coefficients[k, j]
                for a in range(p):
                    for b in range(a + 1 if i == j else p):
                        total = 0.0
                        for l in range(n):
                            total += curvature[k, l] * Z[k + i, l, a] * Z[k + j, l, b]
                        row = (k + i) * p + a
                        B[row, w - 1 - row + (k + j) * p + b] += weight * total


@kernel
def add_blocks(H, B):
    """Add blocks H (N, p, p) to the diagonal of B (N p, w)."""
    p, w = H.shape[1], B.shape[1]
    for k in range(len(H)):
        for a in range(p):
            for b in range(a + 1):
                B[k * p + a, w - 1 - a + b] += H[k, a, b]


@kernel
def times(B, x, out):
    """out = B x."""
    w = B.shape[1]
    for i in range(len(x)):
        total = B[i, w - 1] * x[i]
        for o in range(1, min(i, w - 1) + 1):
            total += B[i, w - 1 - o] * x[i - o]
            out[i - o] += B[i, w - 1 - o] * x[i]
        out[i] = total


@kernel
def factor(B):
    """Overwrite B with Cholesky's factor L of it, its diagonal inverted; return whether there is one."""
    n, w = B.shape
    for j in range(n):
        if not B[j, w - 1] > 0.0:
            return False
        pivot = 1.0 / math.sqrt(B[j, w - 1])
        B[j, w - 1] = pivot
        last = min(w, n - j)
        for o in range(1, last):
            B[j + o, w - 1 - o] *= pivot
        for o in range(1, last):
            x = B[j + o, w - 1 - o]
            for l in range(1, o + 1):
                B[j + o, w - 1 - o + l] -= x * B[j + l, w - 1 - l]
    return True


@kernel
def solve(L, x):
    """Overwrite x with (L Lᵀ)⁻¹ x, L as `factor` leaves it."""
    n, w = L.shape
    for j in range(n):
        x[j] *= L[j, w - 1]
        for o in range(1, min(w, n - j)):
            x[j + o] -= L[j + o, w - 1 - o] * x[j]
    for i in range(n - 1, -1, -1):
        x[i] *= L[i, w - 1]
        for o in range(1, min(i, w - 1) + 1):
            x[i - o] -= L[i, w - 1 - o] * x[i]


@kernel
def _factor_row(B, L, i):
    """Fill row i of Cholesky's factor L of B from the rows before it; return whether there is one."""
    w = B.shape[1]
    for o in range(min(i, w - 1), -1, -1):
        j = i - o
        total = B[i, w - 1 - o]
        for l in range(max(0, i - w + 1, j - w + 1), j):
            total -= L[i, w - 1 - i + l] * L[j, w - 1 - j + l]
        if o == 0:
            if not total > 0.0:
                return False
            L[i, w - 1] = math.sqrt(total)
        else:
            L[i, w - 1 - o] = total / L[j, w - 1]
    return True


@kernel
def mend(H, convex, links, floor):
    """Put blocks of `convex` (N, p, p) for those of H (N, p, p) until H + links' curvature is convex.

    Where factoring fails, the last waypoint that can give way does. No eigenvalue is below the floor then; return
    whether it came out.
    """
    N, p, _ = H.shape
    w = links.shape[1]
    B, L = links.copy(), links.copy()
    add_blocks(H, B)
    mended = links[:, 0] != links[:, 0]
    for i in range(N * p):
        B[i, w - 1] -= floor
    k = 0
    while k < N:
        fine = True
        for a in range(p):
            fine = fine and _factor_row(B, L, k * p + a)
        if fine:
            k += 1
            continue
        while k >= 0 and mended[k]:
            k -= 1
        if k < 0:
            return False
        mended[k] = True
        for a in range(p):
            for b in range(p):
                if b <= a:
                    B[k * p + a, w - 1 - a + b] += convex[k, a, b] - H[k, a, b]
                H[k, a, b] = convex[k, a, b]
    return True
