"""Compiled descent of a chain's end to a target pose that never leaves the joints' limits.

Levenberg-Marquardt with a damping in proportion to the squared error, and an active set of limits: joints that the step
would carry past a limit go just to it, and the others make up for what is missing of the step, until none is left.
Source: Sugihara 2011, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method", for the damping.
"""

import math
from typing import NamedTuple

import numpy as np

from longreach.geometry._kernels import so3_log
from longreach.kernels import kernel
from longreach.robot._kinematics_kernels import forward_jacobian

_ENOUGH = 1e-10  # [m, rad], where a descent ends; Newton's last step jumps from 1e-6 to rounding
REACHED = 1e-9  # [m, rad], what counts as reached; at singular postures the last digits come slowly
_DAMPING = 0.05  # of the squared error
_FLOOR = 1e-14  # of the damping: keeps singular postures solvable
_LEAST = 1e-15  # pivot; less is rounding
_PATIENCE = 6  # iterations within which the error must halve
_SETTLED = 1e-9  # gain of the squared error, as a part of it, that is none
_STIFF = 1e8  # damping under which nothing moves
_FUSED = {"contract", "reassoc"}


class Joints(NamedTuple):
    """A chain F[0] · J_0 ⋯ F[k] of n joints, their limits, and each one's ratio (n,) of a low-discrepancy sequence."""

    fixed: np.ndarray
    prismatic: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    ratios: np.ndarray


class Room(NamedTuple):
    """Arrays to work in: pose T, Jacobian J (6, n), error e and y of A y = e (6,), rotation R, free joints (n,)."""

    T: np.ndarray
    J: np.ndarray
    e: np.ndarray
    y: np.ndarray
    A: np.ndarray
    R: np.ndarray
    free: np.ndarray


@kernel
def room_for(n):
    """Make the arrays for n joints."""
    return Room(
        np.empty((4, 4)), np.empty((6, n)), np.empty(6), np.empty(6), np.empty((6, 6)), np.empty((3, 3)), np.empty(n)
    )


@kernel
def put(x, out):
    """out[:] = x (numba takes long to compile that)."""
    for k in range(len(x)):
        out[k] = x[k]


@kernel
def gap(target, T, R, e):
    """Fill e (6,) = [p_target - p; log(R_target Rᵀ)], world-aligned as the Jacobian is; return both lengths."""
    for i in range(3):
        e[i] = target[i, 3] - T[i, 3]
        for j in range(3):
            R[i, j] = target[i, 0] * T[j, 0] + target[i, 1] * T[j, 1] + target[i, 2] * T[j, 2]
    e[3], e[4], e[5] = so3_log(R)
    return math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]), math.sqrt(e[3] * e[3] + e[4] * e[4] + e[5] * e[5])


@kernel(fastmath=_FUSED)
def _solve(A, y):
    """Overwrite y (6,) with A⁻¹ y by Cholesky's factor, which takes A's lower triangle."""
    for j in range(6):
        for k in range(j):
            for i in range(j, 6):
                A[i, j] -= A[i, k] * A[j, k]
        pivot = 1.0 / math.sqrt(max(A[j, j], _LEAST))
        for i in range(j + 1, 6):
            A[i, j] *= pivot
        A[j, j] = pivot
    for i in range(6):
        for k in range(i):
            y[i] -= A[i, k] * y[k]
        y[i] *= A[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            y[i] -= A[k, i] * y[k]
        y[i] *= A[i, i]


@kernel(fastmath=_FUSED)
def _damped_step(J, free, damping, e, A, y):
    """y = (J Jᵀ + damping I)⁻¹ e over the free joints; their step is Jᵀ y."""
    for i in range(6):
        for j in range(i + 1):
            total = 0.0
            for k in range(J.shape[1]):
                total += free[k] * J[i, k] * J[j, k]
            A[i, j] = total
        A[i, i] += damping
        y[i] = e[i]
    _solve(A, y)


@kernel
def _step(joints, room, damping, q):
    """Move q by the damped step inside the limits."""
    n = len(q)
    J, e, y, free = room.J, room.e, room.y, room.free
    for k in range(n):
        free[k] = 1.0
    for _ in range(n):
        _damped_step(J, free, damping, e, room.A, y)
        stopped = False
        for k in range(n):
            if free[k] == 0.0:
                continue
            step = 0.0
            for i in range(6):
                step += J[i, k] * y[i]
            if q[k] + step < joints.lower[k] or q[k] + step > joints.upper[k]:
                limit = joints.lower[k] if step < 0.0 else joints.upper[k]
                for i in range(6):
                    e[i] -= J[i, k] * (limit - q[k])
                q[k], free[k], stopped = limit, 0.0, True
        if not stopped:
            break
    for k in range(n):
        if free[k] != 0.0:
            step = 0.0
            for i in range(6):
                step += J[i, k] * y[i]
            q[k] = min(max(q[k] + step, joints.lower[k]), joints.upper[k])


@kernel
def descend(joints, room, target, most, part, q):
    """Move q (n,), inside its limits, towards the target; return iterations and the error's lengths [m], [rad].

    It ends at the target, after `most` iterations, where it makes no way, or where only a `part` of the error is left.
    """
    mark, since, used, enough = np.inf, 0, 0, -1.0
    while True:
        forward_jacobian(joints.fixed, joints.prismatic, q, room.T, room.J)
        position, orientation = gap(target, room.T, room.R, room.e)
        error = position * position + orientation * orientation
        if error < 0.25 * mark:
            mark, since = error, 0
        if used == 0:
            enough = part * part * error
        done = (position < _ENOUGH and orientation < _ENOUGH) or error < enough
        if done or used == most or since == _PATIENCE:
            return used, position, orientation
        _step(joints, room, _DAMPING * error + _FLOOR, q)
        used += 1
        since += 1


@kernel
def settle(joints, room, target, most, q, trial):
    """Lower the error from q on as far as it goes, for a target out of reach: only steps that lower it are taken."""
    damping = 1e-2
    forward_jacobian(joints.fixed, joints.prismatic, q, room.T, room.J)
    position, orientation = gap(target, room.T, room.R, room.e)
    for used in range(most):
        put(q, trial)
        _step(joints, room, damping, trial)
        forward_jacobian(joints.fixed, joints.prismatic, trial, room.T, room.J)
        p, o = gap(target, room.T, room.R, room.e)
        gain = position * position + orientation * orientation - p * p - o * o
        if gain > 0.0:
            put(trial, q)
            position, orientation, damping = p, o, max(0.2 * damping, _FLOOR)
            if gain < _SETTLED * (p * p + o * o):
                return used + 1, position, orientation
        else:
            damping *= 8.0
            if damping > _STIFF:
                return used + 1, position, orientation
            forward_jacobian(joints.fixed, joints.prismatic, q, room.T, room.J)
            gap(target, room.T, room.R, room.e)
    return most, position, orientation


@kernel
def reached(position, orientation):
    """Whether what `descend` left counts as nothing."""
    return position < REACHED and orientation < REACHED
