"""The robot's own drivers, compiled: from the command that holds to what base and arm do in the next step."""

import math

from longreach.kernels import kernel


@kernel
def copy(source, target):
    """Write an array over the beginning of another; numba compiles this five times as fast as a slice."""
    for i in range(len(source)):
        target[i] = source[i]


@kernel
def approach(value, wanted, step):
    """Move each value towards what is wanted by at most its step, in place."""
    for i in range(len(value)):
        value[i] += min(max(wanted[i] - value[i], -step[i]), step[i])


@kernel
def approach_all(value, wanted, step, out):
    """Rows of out (count, n): the next values on the way; `value` ends at the last of them."""
    for k in range(len(out)):
        approach(value, wanted, step)
        copy(value, out[k])


@kernel
def reach(q, v, wanted, left, dt, lower, upper, v_max):
    """Move the joints evenly so that they are at `wanted` after `left` more steps of dt [s], in place."""
    for i in range(len(q)):
        v[i] = min(max((wanted[i] - q[i]) / (left * dt), -v_max[i]), v_max[i])
        q[i] = min(max(q[i] + v[i] * dt, lower[i]), upper[i])


@kernel
def run_arm(q, v, wanted, angles, left, dt, lower, upper, v_max, a_max, q_out, v_out):
    """Rows of q_out, v_out (count, n): angles and speeds in the next steps; q, v end at the last of them.

    angles: whether `wanted` is angles to be reached after `left` steps, or speeds.
    """
    for k in range(len(q_out)):
        if angles:
            reach(q, v, wanted, max(left - k, 1), dt, lower, upper, v_max)
        else:
            for i in range(len(q)):
                v[i] += min(max(wanted[i] - v[i], -a_max[i] * dt), a_max[i] * dt)
                q[i] = min(max(q[i] + v[i] * dt, lower[i]), upper[i])
        copy(q, q_out[k])
        copy(v, v_out[k])


@kernel
def planar(qpos, bases):
    """Rows of bases (count + 1, 3) but the first: x, y and heading of a free body, the heading not wrapped.

    qpos (count, n) begins with a position and a quaternion wxyz; from row to row it turns by far less than π.
    """
    for k in range(len(qpos)):
        w, x, y, z = qpos[k, 3], qpos[k, 4], qpos[k, 5], qpos[k, 6]
        heading = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        turn = heading - bases[k, 2]
        bases[k + 1, 0], bases[k + 1, 1] = qpos[k, 0], qpos[k, 1]
        bases[k + 1, 2] = bases[k, 2] + turn - 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
