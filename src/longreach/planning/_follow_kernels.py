"""Compiled iterations of task priority: damping that learns from what steps gained, and waypoints followed in one call.

`problem` is (starts, ranged, gains, lower, upper, scheme, setting, base_damping, error_damping, strongest, reach,
longest, z): the rows of `_priority_kernels`, each with its gain and, where ranged, its range, and the levels' inverses.
`memory` is what one step leaves for the next, made by `remember`.
"""

import math

import numpy as np

from longreach.kernels import kernel
from longreach.planning._priority_kernels import SICILIANO_SLOTINE, step, workspace
from longreach.planning._quick_step_kernels import quick_step
from longreach.planning._stack_kernels import errors, jacobians
from longreach.robot._kinematics_kernels import forward_jacobian

_POOR, _GOOD = 0.5, 0.25  # part of what was promised that is missed
SHARE_BELOW = 0.6  # part of a joint's limit of speed that levels below the first may use
_LAST = 3  # iterations at the end of many that are the first level's alone
_ROUNDING = 1e-9  # [m, rad], an error too small to learn from
_SURPRISE = 0.25  # part of an error up to which what the last waypoint's step missed is expected to be missed again


@kernel
def remember(M, n, levels):
    """Memory before the first step."""
    mu, lengths, before, then = np.zeros(levels), np.zeros(levels), np.zeros(levels), np.zeros(levels)
    a, floor, ceiling, goal = np.zeros(M), np.zeros(M), np.zeros(M), np.zeros(M)
    predicted, missed, active = np.zeros(M), np.zeros(M), np.zeros(M, dtype=np.bool_)
    pool, parts = np.zeros(M, dtype=np.int64), np.zeros(levels + 1)
    return (mu, lengths, before, then, parts), (a, floor, ceiling, goal, active, pool), (predicted, missed), \
        workspace(M, n)  # fmt: skip


@kernel(fastmath={"contract", "reassoc"})
def measure(e, starts, ranged, lower, upper, lengths):
    """‖e‖ of each level's equations; return the largest, or how far out of its range a value is if that is more."""
    worst = 0.0
    for level in range(len(starts) - 1):
        total = 0.0
        for r in range(starts[level], starts[level + 1]):
            if not ranged[r]:
                total += e[r] * e[r]
            else:
                worst = max(worst, max(lower[r] - e[r], e[r] - upper[r]))
        lengths[level] = math.sqrt(total)
        worst = max(worst, lengths[level])
    return worst


@kernel
def learn(strongest, levels):
    """μ grows where a step missed half of what it promised, and falls where it missed a quarter or less.

    Marquardt's rule for levels: what level i missed is weighed against what it and all below promised to gain, and laid
    on that one of them which moved most, for the motion of a lower level bends what a higher one holds. λ = μ ‖e‖
    because what the model lacks is the chain's curvature times the error.
    """
    mu, lengths, before, then, parts = levels
    promised = 0.0
    for i in range(len(mu) - 1, -1, -1):
        gain = before[i] - then[i]
        before[i] = gain if gain > 0.0 else 0.0
        promised += before[i]
    for i in range(len(mu)):
        missed = lengths[i] - then[i]
        if missed > _POOR * promised and missed > _ROUNDING:
            culprit = i
            for j in range(i + 1, len(mu)):
                if parts[j] > parts[culprit]:
                    culprit = j
            mu[culprit] = min(max(4.0 * mu[culprit], 0.05 * strongest), strongest)
            return
        if before[i] > _ROUNDING and missed < _GOOD * promised:
            mu[i] = 0.25 * mu[i] if mu[i] > 0.01 * strongest else 0.0
        promised -= before[i]


@kernel(fastmath={"contract", "reassoc"})
def _predict(A, e, starts, ranged, dq, levels, predicted):
    """The equations' errors after dq as their linear model says, and their size in each level."""
    _, lengths, before, then, _ = levels
    for level in range(len(starts) - 1):
        total = 0.0
        for r in range(starts[level], starts[level + 1]):
            if ranged[r]:
                continue
            moved = e[r]
            for k in range(len(dq)):
                moved += A[r, k] * dq[k]
            predicted[r] = moved
            total += moved * moved
        before[level], then[level] = lengths[level], math.sqrt(total)


@kernel(fastmath={"contract", "reassoc"})
def _fits(A, ranged, floor, ceiling, low, high, dq):
    for k in range(len(dq)):
        if not low[1, k] <= dq[k] <= high[1, k]:
            return False
    for r in range(len(ranged)):
        if ranged[r]:
            moved = 0.0
            for k in range(len(dq)):
                moved += A[r, k] * dq[k]
            if not floor[r] <= moved <= ceiling[r]:
                return False
    return True


@kernel
def _wishes(e, ranged, gains, lower, upper, expected, rows):
    """What each equation wants and how far each range lets a step go; out of it, back in at the row's gain."""
    a, floor, ceiling = rows[:3]
    for r in range(len(e)):
        if ranged[r]:
            floor[r] = (lower[r] - e[r]) * (gains[r] if e[r] < lower[r] else 1.0)
            ceiling[r] = (upper[r] - e[r]) * (gains[r] if e[r] > upper[r] else 1.0)
        else:
            a[r] = -gains[r] * e[r] - expected[r]


@kernel
def advance(e, A, low, high, problem, memory, expected, dq):
    """dq (n,) of one iteration at errors e (M,) and Jacobian A (M, n), low <= dq <= high (2, n).

    `memory`'s lengths are those of e; `expected` (M,) is what the linear model will miss.
    """
    starts, ranged, gains, lower, upper, scheme, setting, base, by_error, _, reach, longest, z = problem
    levels, rows, (predicted, _), work = memory
    mu, lengths, _, _, parts = levels
    a, floor, ceiling, goal, active, pool = rows
    _, _, L, b, _, M, _, order = work
    _wishes(e, ranged, gains, lower, upper, expected, rows)
    plain = scheme == SICILIANO_SLOTINE
    for i in range(len(mu)):
        setting[i, 1] = base[i] + by_error[i] * lengths[i] ** 2 + mu[i] * lengths[i]
    for k in range(len(z)):
        plain &= z[k] == 0.0
    if (
        plain
        and quick_step(A, a, starts, ranged, setting, order, L, M, b, parts, dq)
        and _fits(A, ranged, floor, ceiling, low, high, dq)
    ):
        for r in range(len(active)):
            active[r] = False
    else:
        step(A, a, starts, ranged, active, goal, floor, ceiling, scheme, setting, reach, longest, z, low, high, pool,
             work, parts, dq)  # fmt: skip
    _predict(A, e, starts, ranged, dq, levels, predicted)


@kernel
def expect(e, starts, missed, expected):
    """What the last waypoint's first step missed, where it is small beside the error e of its level."""
    for level in range(len(starts) - 1):
        size, surprise = 0.0, 0.0
        for r in range(starts[level], starts[level + 1]):
            size += e[r] * e[r]
            surprise += missed[r] * missed[r]
        usual = surprise <= _SURPRISE**2 * size
        for r in range(starts[level], starts[level + 1]):
            expected[r] = missed[r] if usual else 0.0


@kernel
def room(iteration, iterations, q, last, speed, longest, low, high):
    """low, high (2, n): how far one iteration may move a joint, so that in all |q - last| <= speed.

    Row 1 is for the levels below the first, which needs the rest to mend what they bend. They stand still in the last
    few of many iterations, so that what they bent is mended even where they have not come to rest.
    """
    still = iterations > 2 * _LAST and iteration >= iterations - _LAST
    for k in range(len(q)):
        for row in range(2):
            part = SHARE_BELOW if row else 1.0
            if row == 1 and still:
                low[row, k] = high[row, k] = 0.0
                continue
            low[row, k] = max(-longest[k], min(last[k] - part * speed[k] - q[k], 0.0))
            high[row, k] = min(longest[k], max(last[k] + part * speed[k] - q[k], 0.0))


@kernel
def gauge(e, ranged, lower, upper, owner, angular, sizes):
    """sizes (2, tasks): the length [m] and the angle [rad] of each task's errors, of a range what is out of it."""
    for i in range(sizes.shape[0]):
        for j in range(sizes.shape[1]):
            sizes[i, j] = 0.0
    for r in range(len(e)):
        off = max(lower[r] - e[r], e[r] - upper[r], 0.0) if ranged[r] else e[r]
        sizes[1 if angular[r] else 0, owner[r]] += off * off
    for i in range(sizes.shape[0]):
        for j in range(sizes.shape[1]):
            sizes[i, j] = math.sqrt(sizes[i, j])


@kernel
def follow(
    fixed, prismatic, kinds, targets, owner, angular, speeds, farthest, iterations, tolerance, least, problem, q, Q,
    sizes, counts,
):  # fmt: skip
    """Q (waypoints, n) from q on, sizes (2, tasks, waypoints) of errors [m; rad], counts (waypoints,) of iterations."""
    starts, ranged, _, lower, upper = problem[:5]
    n, M, levels = len(q), len(ranged), len(starts) - 1
    T, J, e, A = np.empty((4, 4)), np.empty((6, n)), np.empty(M), np.zeros((M, n))
    low, high, dq, expected, none = np.empty((2, n)), np.empty((2, n)), np.zeros(n), np.zeros(M), np.zeros(M)
    memory, found = remember(M, n, levels), np.empty(sizes.shape[:2])
    lengths, (predicted, missed) = memory[0][1], memory[2]
    forward_jacobian(fixed, prismatic, q, T, J)
    for k in range(len(targets)):
        last = Q[max(k - 1, 0)]
        for iteration in range(iterations + 1):
            errors(kinds, targets[k], q, T, e)
            worst = measure(e, starts, ranged, lower, upper, lengths)
            if iteration > 0:
                learn(problem[9], memory[0])
            if iteration == 1:
                for r in range(M):
                    missed[r] = e[r] - predicted[r]
            moved = 0.0
            for j in range(n):
                moved = max(moved, abs(dq[j]))
            if iteration == iterations or worst <= tolerance or (iteration > 0 and moved < least):
                counts[k] = iteration
                break
            jacobians(kinds, targets[k], q, T, J, e, A)
            if iteration == 0:
                expect(e, starts, missed, expected)
            room(iteration, iterations, q, last, speeds[k], farthest, low, high)
            advance(e, A, low, high, problem, memory, expected if iteration == 0 else none, dq)
            for j in range(n):
                q[j] += dq[j]
            forward_jacobian(fixed, prismatic, q, T, J)
        if counts[k] == 0:
            for r in range(M):
                missed[r] = 0.0
        for j in range(n):
            Q[k, j] = q[j]
        gauge(e, ranged, lower, upper, owner, angular, found)
        sizes[:, :, k] = found
