"""A quadratic program of a whole trajectory: a narrow band of curvature, and many rows of which few bind.

    min ½ zᵀB z + cᵀz + Σ price · violation,   violations being how far A z and z are outside [low, high]

A price without end makes a row hold. This is the augmented Lagrangian: for fixed multipliers y its function
½ zᵀB z + cᵀz + ½ρ Σ dist²(A z + y/ρ, [low, high]), pulls of rows no larger than their price, is convex and made of
quadratic pieces. Newton's step, one banded factor, is exact inside a piece, and a search along the step takes it
across. Then the pulls are the next multipliers. From a start near the solution it takes one or two steps.
Source: Nocedal & Wright, "Numerical Optimization", section 17.4; Hermans, Themelis & Patrinos 2019, "QPALM".

A row i of A is data[i, :count[i]] from the variable first[i] on. Values of rows, v (m + n,), end with those of z.
"""

import numpy as np

from longreach.kernels import kernel
from longreach.planning import _band_kernels as bands

_ORDERLESS = {"contract", "reassoc"}
_STEPS = 150  # Newton's, in all
_SEARCHES = 30
_FLAT = 1e-3  # part of its first slope at which a search ends
_SLOW = 0.1  # of the violation that may be left by new multipliers, or else ρ rises
_RISES, _STIFFEST = 10.0, 1e3  # by what ρ rises, and how far in all: from there on rounding would tell
_PATIENCE = 3  # new multipliers in a row by which the violation hardly fell: rows contradict each other
_ENOUGH = 1e-8  # a violation that may be left then: rows that nearly depend on each other settle slowly


@kernel
def waypoint_rows(G, Z, d0, data, at):
    """Fill the first rows with G Z, and at with G d₀, for G (N, r, n), Z (N, n, p), d₀ (N, n)."""
    N, r, n = G.shape
    p = Z.shape[2]
    for k in range(N):
        for i in range(r):
            row = k * r + i
            for a in range(p):
                data[row, a] = 0.0
            at[row] = 0.0
            for l in range(n):
                x = G[k, i, l]
                if x != 0.0:
                    at[row] += x * d0[k, l]
                    for a in range(p):
                        data[row, a] += x * Z[k, l, a]


@kernel
def link_rows(coefficients, Z, d0, data, at):
    """Fill rows with differences between neighbours, k by n of them by coefficients (k, width), and at with d₀'s."""
    n, p = Z.shape[1], Z.shape[2]
    for k in range(len(coefficients)):
        for j in range(n):
            at[k * n + j] = 0.0
            for i in range(coefficients.shape[1]):
                at[k * n + j] += coefficients[k, i] * d0[k + i, j]
                for a in range(p):
                    data[k * n + j, i * p + a] = coefficients[k, i] * Z[k + i, j, a]


@kernel(fastmath=_ORDERLESS)
def _values(data, first, count, z, v):
    """v = [A z; z]."""
    m = len(data)
    for i in range(m):
        total = 0.0
        for a in range(count[i]):
            total += data[i, a] * z[first[i] + a]
        v[i] = total
    for j in range(len(z)):
        v[m + j] = z[j]


@kernel(fastmath=_ORDERLESS)
def _pulls(v, y, low, high, price, rho, out):
    """out = ρ (t - t clipped), t = v + y/ρ, at most the price; return by how much it changes y, as a length."""
    worst = 0.0
    for i in range(len(v)):
        t = v[i] + y[i] / rho
        x = rho * (max(t - high[i], 0.0) + min(t - low[i], 0.0))
        out[i] = min(max(x, -price[i]), price[i])
        worst = max(worst, abs(out[i] - y[i]) / rho)
    return worst


@kernel
def _add_rows(data, first, count, pull, price, rho, g, B):
    """g += [Aᵀ 1] pull, and B += ρ Σ aᵢ aᵢᵀ over the rows that pull less than their price."""
    m, w = len(data), B.shape[1]
    for i in range(m):
        if pull[i] != 0.0:
            for a in range(count[i]):
                row = first[i] + a
                g[row] += pull[i] * data[i, a]
                if abs(pull[i]) < price[i]:
                    for b in range(a + 1):
                        B[row, w - 1 - a + b] += rho * data[i, a] * data[i, b]
    for j in range(len(g)):
        g[j] += pull[m + j]
        if pull[m + j] != 0.0:
            B[j, w - 1] += rho


@kernel(fastmath=_ORDERLESS)
def _slope(v, dv, y, low, high, price, rho, s):
    """Return the slope at s of the rows' part of the function along the line v + s dv, and the slope's own."""
    slope, bend = 0.0, 0.0
    for i in range(len(v)):
        t = v[i] + s * dv[i] + y[i] / rho
        x = rho * (max(t - high[i], 0.0) + min(t - low[i], 0.0))
        slope += min(max(x, -price[i]), price[i]) * dv[i]
        bend += rho * dv[i] * dv[i] if x != 0.0 and abs(x) < price[i] else 0.0
    return slope, bend


@kernel
def _searched(v, dv, y, low, high, price, rho, slope, bend):
    """Return where along a step the function is least; slope + s · bend is its slope without the rows."""
    before, after, s = 0.0, np.inf, 1.0
    begin = abs(slope + _slope(v, dv, y, low, high, price, rho, 0.0)[0])
    for _ in range(_SEARCHES):
        rows, more = _slope(v, dv, y, low, high, price, rho, s)
        here = slope + s * bend + rows
        if abs(here) <= _FLAT * begin:
            break
        if here < 0.0:
            before = s
        else:
            after = s
        s -= here / (bend + more)
        if not before < s < after:
            s = 0.5 * (before + after) if after < np.inf else 2.0 * before
    return s


@kernel
def _minimise(B, c, data, first, count, low, high, price, rho, exact, tight, z, y):
    """Move z (n,) and the multipliers y (m + n,) to the solution; return whether there is one."""
    n, size = len(z), len(y)
    g, h, v, dv, pull, K = np.empty(n), np.empty(n), np.empty(size), np.empty(size), np.empty(size), np.empty(B.shape)
    last, patience, stiffest = np.inf, _PATIENCE, _STIFFEST * rho
    for _ in range(_STEPS):
        _values(data, first, count, z, v)
        worst = _pulls(v, y, low, high, price, rho, pull)
        K[:] = B
        bands.times(B, z, g)
        slope, bend, steepest = 0.0, 0.0, 0.0
        for j in range(n):
            g[j] += c[j]
            h[j] = g[j]
        _add_rows(data, first, count, pull, price, rho, h, K)
        for j in range(n):
            steepest = max(steepest, abs(h[j]))
            h[j] = -h[j]
        if steepest <= exact:
            y[:] = pull
            if worst <= tight:
                return True
            patience = patience - 1 if worst > 0.5 * last else _PATIENCE
            if patience == 0:
                return worst <= _ENOUGH
            rho = min(_RISES * rho, stiffest) if worst > _SLOW * last else rho
            last = worst
            continue
        if not bands.factor(K):
            return False
        bands.solve(K, h)
        _values(data, first, count, h, dv)
        bands.times(B, h, K[:, 0])
        for j in range(n):
            slope += g[j] * h[j]
            bend += K[j, 0] * h[j]
        s = _searched(v, dv, y, low, high, price, rho, slope, bend)
        for j in range(n):
            z[j] += s * h[j]
    return False


@kernel
def solve(B, c, data, first, count, low, high, price, rho, near, exact, tight, z, y):
    """Do so, with only those rows that are less than `near` from their bounds, that pull, or turn out to be violated.

    exact: the largest slope that may be left; tight: the largest violation.
    """
    m, n = len(data), len(z)
    part = np.empty(m, dtype=np.bool_)
    for i in range(m):
        part[i] = y[i] != 0.0 or low[i] > -near or high[i] < near
    v = np.empty(m + n)
    while True:
        chosen = np.append(np.flatnonzero(part), np.arange(m, m + n))
        rows = chosen[: len(chosen) - n]
        some = y[chosen]
        fine = _minimise(
            B, c, data[rows], first[rows], count[rows], low[chosen], high[chosen], price[chosen], rho, exact, tight,
            z, some,
        )  # fmt: skip
        if not fine:
            return False
        y[chosen] = some
        _values(data, first, count, z, v)
        new = 0
        for i in range(m):
            if not part[i] and (v[i] > high[i] + tight or v[i] < low[i] - tight):
                part[i] = True
                new += 1
        if new == 0:
            return True
