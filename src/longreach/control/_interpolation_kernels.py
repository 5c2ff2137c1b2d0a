"""Compiled Hermite interpolation of timed points: cubic through velocities, quintic through accelerations, too."""

from longreach.kernels import kernel


@kernel
def _row_before(stamps, t):
    """The last row whose stamp is not after t, but never the last of all."""
    low, high = 0, len(stamps) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if stamps[middle] <= t:
            low = middle
        else:
            high = middle
    return low


@kernel
def _bend(stamps, q, v, i, k):
    """The acceleration at row i: the mean of what the two cubics that meet there have; 0 at both ends."""
    if i == 0 or i == len(stamps) - 1:
        return 0.0
    before, after = stamps[i] - stamps[i - 1], stamps[i + 1] - stamps[i]
    left = (2.0 * v[i - 1, k] + 4.0 * v[i, k] - 6.0 * (q[i, k] - q[i - 1, k]) / before) / before
    right = (6.0 * (q[i + 1, k] - q[i, k]) / after - 4.0 * v[i, k] - 2.0 * v[i + 1, k]) / after
    return 0.5 * (left + right)


@kernel
def _one(stamps, q, v, a, quintic, t, out):
    """q, q̇, q̈ at t as out (3, dof); at rest in the first row before the start, and in the last one after the end."""
    n, dof = q.shape
    last = n - 1
    if n == 1 or t < stamps[0] or t > stamps[last]:
        row = 0 if t < stamps[0] else last
        for k in range(dof):
            out[0, k], out[1, k], out[2, k] = q[row, k], 0.0, 0.0
        return
    i = _row_before(stamps, t)
    T = stamps[i + 1] - stamps[i]
    s = (t - stamps[i]) / T
    for k in range(dof):
        # In s = 0 .. 1: p0 + v0 s + c2 s² + c3 s³ + c4 s⁴ + c5 s⁵, what is left over is what the end still lacks.
        p0, v0, v1 = q[i, k], v[i, k] * T, v[i + 1, k] * T
        d = q[i + 1, k] - p0
        if quintic:
            given = a.shape[0] == n
            a0 = 0.5 * T * T * (a[i, k] if given else _bend(stamps, q, v, i, k))
            a1 = 0.5 * T * T * (a[i + 1, k] if given else _bend(stamps, q, v, i + 1, k))
            c2 = a0
            c3 = 10.0 * d - 6.0 * v0 - 4.0 * v1 - 3.0 * a0 + a1
            c4 = -15.0 * d + 8.0 * v0 + 7.0 * v1 + 3.0 * a0 - 2.0 * a1
            c5 = 6.0 * d - 3.0 * (v0 + v1) - a0 + a1
        else:
            c2, c3, c4, c5 = 3.0 * d - 2.0 * v0 - v1, v0 + v1 - 2.0 * d, 0.0, 0.0
        out[0, k] = p0 + s * (v0 + s * (c2 + s * (c3 + s * (c4 + s * c5))))
        out[1, k] = (v0 + s * (2.0 * c2 + s * (3.0 * c3 + s * (4.0 * c4 + s * 5.0 * c5)))) / T
        out[2, k] = (2.0 * c2 + s * (6.0 * c3 + s * (12.0 * c4 + s * 20.0 * c5))) / (T * T)


@kernel
def sample_all(stamps, q, v, a, quintic, t, out):
    """out (m, 3, dof): q, q̇, q̈ at each of t (m,); a (n, dof), or (0, dof) where none are given."""
    for j in range(len(t)):
        _one(stamps, q, v, a, quintic, t[j], out[j])
