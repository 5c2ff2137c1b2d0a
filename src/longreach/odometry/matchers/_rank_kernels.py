"""Compiled order statistics; numpy's own take numba seconds to compile."""

from longreach.kernels import kernel


@kernel
def smallest(values, k):
    """Return the number that k others of `values` precede in order, which is shuffled for it (Hoare 1961)."""
    low, high = 0, len(values) - 1
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if j < k:
            low = i
        if k < i:
            high = j
    return values[k]
