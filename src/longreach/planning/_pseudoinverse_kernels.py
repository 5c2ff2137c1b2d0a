"""Compiled inverses of a small Jacobian from its singular values: what (4.7), (4.11), (4.12) make of each of them.

`V, U` here are the two halves of one array A (m, n + m) that `decompose` fills: row i is [v_iᵀ | u_iᵀ].
"""

import math

from longreach.kernels import kernel
from longreach.planning._svd_kernels import svd

UNDAMPED, DAMPED, SELECTIVE = 0, 1, 2
_SELECTIVE_FLOOR = 1e-10  # σ below it are left out, as in Buss & Kim's code


@kernel
def _complete(A, i, n):
    """Row i becomes a unit vector at right angles to the rows before it, or zero where there is none."""
    best, most = -1, 1e-6
    for k in range(n):
        left = 1.0  # of the unit vector k, its squared length outside the rows before i
        for j in range(i):
            left -= A[j, k] * A[j, k]
        if left > most:
            best, most = k, left
    for k in range(n):
        A[i, k] = 1.0 if k == best else 0.0
    if best < 0:
        return
    for _ in range(2):  # twice is enough (Kahan; Parlett 1980, section 6-9)
        for j in range(i):
            along = 0.0
            for k in range(n):
                along += A[j, k] * A[i, k]
            for k in range(n):
                A[i, k] -= along * A[j, k]
        length = 0.0
        for k in range(n):
            length += A[i, k] * A[i, k]
        length = math.sqrt(length)
        for k in range(n):
            A[i, k] /= length


@kernel
def decompose(J, tolerance, A, s):
    """Rows of A become [v_iᵀ | u_iᵀ] and s the σ_i, 0 from the rank on, which is returned: σ > tolerance · σ_max."""
    m, n = J.shape
    svd(J, A, s)
    rank = 0
    while rank < m and s[rank] > tolerance * s[0]:
        for k in range(n):
            A[rank, k] /= s[rank]
        rank += 1
    for i in range(rank, m):
        s[i] = 0.0
        _complete(A, i, n)
    return rank


@kernel
def filter_values(s, v, floor):
    """(4.12) in place; `floor` is σ0."""
    for i in range(len(s)):
        s[i] += 2.0 * floor / (s[i] * s[i] + v * s[i] + 2.0)


@kernel
def reassemble(A, s, out):
    """out (m, n) = Σ σ_i u_i v_iᵀ (4.8)."""
    m, n = out.shape
    out[:] = 0.0
    for i in range(m):
        for r in range(m):
            weight = s[i] * A[i, n + r]
            for k in range(n):
                out[r, k] += weight * A[i, k]


@kernel
def gain(sigma, damping):
    """σ / (σ² + λ) (4.10); 0 for σ = 0, whatever λ."""
    return sigma / (sigma * sigma + damping) if sigma > 0.0 else 0.0


@kernel
def inverse_matrix(A, s, damping, out):
    """out (n, m) = Σ σ_i / (σ_i² + λ) v_i u_iᵀ."""
    n, m = out.shape
    out[:] = 0.0
    for i in range(m):
        g = gain(s[i], damping)
        for k in range(n):
            weight = g * A[i, k]
            for r in range(m):
                out[k, r] += weight * A[i, n + r]


@kernel
def null_projector(A, rank, out):
    """out (n, n) = I - Σ v_i v_iᵀ over the first `rank` rows."""
    n = len(out)
    for j in range(n):
        for k in range(j + 1):
            total = 0.0
            for i in range(rank):
                total += A[i, j] * A[i, k]
            out[j, k] = out[k, j] = (1.0 if j == k else 0.0) - total


@kernel
def null_part(A, rank, z, out):
    """out (n,) = (I - Σ v_i v_iᵀ) z, without the matrix."""
    n = len(out)
    out[:] = z
    for i in range(rank):
        along = 0.0
        for k in range(n):
            along += A[i, k] * z[k]
        for k in range(n):
            out[k] -= along * A[i, k]


@kernel
def clamp_blocks(e, longest, out):
    """Each block of 3 of e, shortened to longest[block]."""
    m = len(e)
    for b in range((m + 2) // 3):
        square = 0.0
        for r in range(3 * b, min(3 * b + 3, m)):
            square += e[r] * e[r]
        length = math.sqrt(square)
        scale = longest[b] / length if length > longest[b] else 1.0
        for r in range(3 * b, min(3 * b + 3, m)):
            out[r] = scale * e[r]


@kernel
def _block_lengths(X, row, column, along_rows, m):
    """Σ over blocks of 3 of ‖X[block]‖, down a column of X or along a row from `column` on."""
    total = 0.0
    for b in range(0, m, 3):
        square = 0.0
        for r in range(b, min(b + 3, m)):
            x = X[row, column + r] if along_rows else X[r, column]
            square += x * x
        total += math.sqrt(square)
    return total


@kernel
def _add_within(w, scale, bound, share, out):
    """out += scale · w, shortened until no |out_j| of it exceeds share · bound_j."""
    over = 1.0
    for j in range(len(out)):
        limit = share * bound[j]
        size = abs(scale * w[j])
        if size > over * limit:
            over = size / limit
    for j in range(len(out)):
        out[j] += scale * w[j] / over


@kernel
def selective_step(J, A, s, e, bound, reach, out):
    """Buss & Kim's step; bound (n,) is γ_max of each joint, reach (n,) is room for Σ_blocks ‖∂s_block/∂θ_j‖."""
    m, n = J.shape
    out[:] = 0.0
    for j in range(n):
        reach[j] = _block_lengths(J, 0, j, False, m)
    for i in range(m):
        if s[i] <= _SELECTIVE_FLOOR:
            continue
        along, moved = 0.0, 0.0
        for r in range(m):
            along += A[i, n + r] * e[r]  # u_iᵀ e
        for j in range(n):
            moved += abs(A[i, j]) * reach[j]
        N = _block_lengths(A, i, n, True, m)
        share = min(1.0, N * s[i] / moved)  # N_i / M_i
        _add_within(A[i], along / s[i], bound, share, out)
    largest = 1.0
    for j in range(n):
        largest = max(largest, abs(out[j]) / bound[j])
    for j in range(n):
        out[j] = min(max(out[j] / largest, -bound[j]), bound[j])


@kernel
def step(J, A, s, e, method, damping, bound, reach, out):
    """out (n,) = J# e by one of the three methods; damping is λ."""
    m, n = J.shape
    if method == SELECTIVE:
        selective_step(J, A, s, e, bound, reach, out)
        return
    out[:] = 0.0
    for i in range(m):
        along = 0.0
        for r in range(m):
            along += A[i, n + r] * e[r]
        along *= gain(s[i], damping)
        for k in range(n):
            out[k] += along * A[i, k]
