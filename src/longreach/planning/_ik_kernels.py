"""Compiled search for one configuration at a target pose: descent, closed form where the arm has one, fresh starts."""

import math
from typing import NamedTuple

import numpy as np

from longreach.kernels import kernel
from longreach.planning._descent_kernels import Joints, descend, put, reached, room_for, settle
from longreach.planning._ur_kernels import arm_postures, wrist_pose
from longreach.robot._kinematics_kernels import forward_jacobian

# Iterations; plain numbers would make numba compile a descent for each.
_APPROACH = np.int64(5)  # that bring the base near, before the closed form places the arm
_NEAR = 1e-2  # part of the error that the approach may leave
_DESCENT = np.int64(60)  # from a start
_POLISH = np.int64(8)  # from a closed form to what it leaves out, a calibration's deviations
_SETTLING = np.int64(200)  # on the nearest of all, where none arrives
_PLACES = 300  # of the base at which the arm is tried
_STARTS = 400  # of descents
_TRIED = 2  # postures at one place of the base
_SLACK = 0.05  # [rad, m] by which a posture may miss, and be polished
_EXACT = 1e-9  # [rad, m], less is rounding
_SAME = 1e-6  # [turns] between two postures that are one
_WHOLE = 2.0 * math.pi
_SQUARE = 1e-6  # by which a rotation's columns may miss unit length and right angles

WRONG_SHAPE, NOT_FINITE, NO_ROTATION = -1, -2, -3  # instead of a number of iterations


class Arm(NamedTuple):
    """The closed form of a chain's last joints, `ur_arm.UrArm`; shape (0, 6) where there is none."""

    ends: np.ndarray
    shape: np.ndarray


class Postures(NamedTuple):
    """Arm postures Q (8, 6), what they miss (8,) [rad, m], their cost (8,), and two poses to work in."""

    Q: np.ndarray
    miss: np.ndarray
    cost: np.ndarray
    M: np.ndarray
    W: np.ndarray


@kernel
def fault(target, q0, n):
    """0, or what is wrong with a target pose and a seed."""
    if target.shape[0] != 4 or target.shape[1] != 4 or len(q0) != n:
        return WRONG_SHAPE
    total = 0.0
    for i in range(n):
        total += 0.0 * q0[i]
    for i in range(4):
        for j in range(4):
            total += 0.0 * target[i, j]
    if total != 0.0:
        return NOT_FINITE
    off = abs(target[3, 0]) + abs(target[3, 1]) + abs(target[3, 2]) + abs(target[3, 3] - 1.0)
    for i in range(3):
        for j in range(i + 1):
            dot = target[0, i] * target[0, j] + target[1, i] * target[1, j] + target[2, i] * target[2, j]
            off = max(off, abs(dot - (1.0 if i == j else 0.0)))
    x = target[1, 0] * target[2, 1] - target[2, 0] * target[1, 1]
    y = target[2, 0] * target[0, 1] - target[0, 0] * target[2, 1]
    z = target[0, 0] * target[1, 1] - target[1, 0] * target[0, 1]
    mirrored = x * target[0, 2] + y * target[1, 2] + z * target[2, 2] < 0.0
    return NO_ROTATION if off > _SQUARE or mirrored else 0


@kernel
def _wrapped(angle, near, lower, upper):
    """The angle plus whole turns that is nearest to `near` inside the limits, and how far outside it had to stay."""
    x = angle + _WHOLE * np.rint((near - angle) / _WHOLE)
    if x > upper:
        x -= _WHOLE * math.ceil((x - upper) / _WHOLE)
    elif x < lower:
        x += _WHOLE * math.ceil((lower - x) / _WHOLE)
    if lower <= x <= upper:
        return x, 0.0
    above = x if x > upper else x + _WHOLE
    below = above - _WHOLE
    return (upper, above - upper) if above - upper < lower - below else (lower, lower - below)


@kernel
def place_arm(joints, arm, room, postures, target, near, q):
    """Fill the postures of the last joints that reach the target from where q puts the others; cost: the way² there."""
    first = joints.fixed.shape[0] - 7
    forward_jacobian(joints.fixed[: first + 1], joints.prismatic, q, room.T, room.J)
    wrist_pose(arm.ends, room.T, target, postures.M, postures.W)
    arm_postures(arm.shape, postures.W, near[first + 5], postures.Q, postures.miss)
    for row in range(8):
        way = 0.0
        for i in range(6):
            k = first + i
            x, outside = _wrapped(postures.Q[row, i], near[k], joints.lower[k], joints.upper[k])
            postures.Q[row, i] = x
            postures.miss[row] = max(postures.miss[row], outside)
            way += (x - near[k]) ** 2
        postures.cost[row] = way if postures.miss[row] < _EXACT else 1e6 * (1.0 + postures.miss[row])


@kernel
def _least(x):
    """Where the least of x stands (np.argmin takes longer to compile)."""
    row = 0
    for i in range(1, len(x)):
        if x[i] < x[row]:
            row = i
    return row


@kernel
def _nearest_posture(joints, arm, room, postures, target, near, q, trial):
    """Try the postures from the nearest on; put the first that holds into `trial` and return what `descend` does."""
    first = joints.fixed.shape[0] - 7
    place_arm(joints, arm, room, postures, target, near, q)
    used = 0
    for _ in range(8 if first == 0 else _TRIED):
        row = _least(postures.cost)
        if postures.miss[row] > _SLACK or postures.cost[row] == np.inf:
            break
        postures.cost[row] = np.inf
        put(q, trial)
        put(postures.Q[row], trial[first:])
        more, position, orientation = descend(joints, room, target, _POLISH, 0.0, trial)
        used += more
        if reached(position, orientation):
            return used, position, orientation
    return used, np.inf, np.inf


@kernel
def _fraction(joints, k, number):
    """The `number`-th member in [0, 1) of joint k's low-discrepancy sequence."""
    x = 0.5 + number * joints.ratios[k]
    return x - math.floor(x)


@kernel
def _draw(joints, count, number, near, reach, q):
    """Put the first `count` joints anywhere inside their limits, those that slide within reach of where they are."""
    for k in range(count):
        lower, upper = joints.lower[k], joints.upper[k]
        if joints.prismatic[k]:
            lower, upper = max(lower, near[k] - reach), min(upper, near[k] + reach)
        elif upper - lower > 2.0 * _WHOLE:
            lower, upper = max(lower, near[k] - math.pi), min(upper, near[k] + math.pi)
        q[k] = lower + (upper - lower) * _fraction(joints, k, number)


@kernel
def solve(fixed, prismatic, span, ends, shape, target, q0, q):
    """Fill q (n,) with the best found; return iterations (or a fault) and what is left [m], [rad].

    span (3, n): `Joints`' lower, upper and ratios; ends and shape: `Arm`. (Plain arrays come cheaper from Python.)
    """
    joints, arm = Joints(fixed, prismatic, span[0], span[1], span[2]), Arm(ends, shape)
    n = len(q)
    wrong = fault(target, q0, n)
    if wrong != 0:
        return wrong, np.inf, np.inf
    room, start, trial = room_for(n), np.empty(n), np.empty(n)
    for k in range(n):
        start[k] = min(max(q0[k], joints.lower[k]), joints.upper[k])
    put(start, q)
    has_arm = len(arm.ends) > 0
    used, position, orientation = 0, np.inf, np.inf
    if not has_arm or joints.fixed.shape[0] > 7:
        most, part = (_APPROACH, _NEAR) if has_arm else (_DESCENT, 0.0)
        used, position, orientation = descend(joints, room, target, most, part, q)
    if has_arm:
        more, p, o = _with_arm(joints, arm, room, target, q0, start, q, trial)
        used += more
        if reached(p, o):
            put(trial, q)
            return used, p, o
    if reached(position, orientation):
        return used, position, orientation
    return _from_fresh_starts(joints, room, target, used, start, q, trial)


@kernel
def _with_arm(joints, arm, room, target, q0, start, q, trial):
    """Place the arm: from where q puts the base, from where it starts, and from places between the limits."""
    postures = Postures(np.empty((8, 6)), np.empty(8), np.empty(8), np.empty((4, 4)), np.empty((4, 4)))
    base = joints.fixed.shape[0] - 7
    reach = arm.shape[2, 0] + arm.shape[2, 1]
    place, used = np.empty(len(q)), 0
    put(q, place)
    for number in range(_PLACES if base > 0 else 1):
        if number == 1:
            put(start[:base], place)
        elif number > 1:
            _draw(joints, base, number, q, reach, place)
        more, position, orientation = _nearest_posture(joints, arm, room, postures, target, q0, place, trial)
        used += more
        if reached(position, orientation):
            return used, position, orientation
    return used, np.inf, np.inf


@kernel
def _from_fresh_starts(joints, room, target, used, start, q, trial):
    """Descend from the seed and from everywhere between the limits; q keeps the best of all."""
    best = np.inf
    for number in range(_STARTS + 1):
        put(start, trial)
        if number > 0:
            reach = 1.0 + abs(target[0, 3]) + abs(target[1, 3]) + abs(target[2, 3])
            _draw(joints, joints.fixed.shape[0] - 1, number, start, reach, trial)
        more, p, o = descend(joints, room, target, _DESCENT, 0.0, trial)
        used += more
        if p * p + o * o < best:
            best = p * p + o * o
            put(trial, q)
            if reached(p, o):
                return used, p, o
    more, position, orientation = settle(joints, room, target, _SETTLING, q, trial)
    return used + more, position, orientation


@kernel
def all_postures(fixed, prismatic, span, ends, shape, target, near, Q):
    """Put each posture of an arm without a base that reaches the target into a row of Q (8, 6); return how many."""
    joints, arm = Joints(fixed, prismatic, span[0], span[1], span[2]), Arm(ends, shape)
    room, count = room_for(6), 0
    postures = Postures(np.empty((8, 6)), np.empty(8), np.empty(8), np.empty((4, 4)), np.empty((4, 4)))
    place_arm(joints, arm, room, postures, target, near, near)
    for row in range(8):
        if postures.miss[row] > _SLACK:
            continue
        put(postures.Q[row], Q[count])
        _, position, orientation = descend(joints, room, target, _POLISH, 0.0, Q[count])
        if reached(position, orientation) and _is_new(Q, count):
            count += 1
    return count


@kernel
def _is_new(Q, count):
    """Whether row `count` is another posture than each row before it; at singular postures two become one."""
    for row in range(count):
        off = 0.0
        for i in range(6):
            turn = (Q[count, i] - Q[row, i]) / _WHOLE
            off = max(off, abs(turn - np.rint(turn)))
        if off < _SAME:
            return False
    return True
