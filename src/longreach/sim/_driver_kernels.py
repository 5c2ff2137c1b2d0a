"""The robot's own drivers, compiled: from the command that holds to what base and arm do in the next step."""

import math

from longreach.kernels import kernel


@kernel
def copy(source, target):
    """Write an array over the beginning of another; numba compiles this five times as fast as a slice."""
    for i in range(len(source)):
        target[i] = source[i]


@kernel
def run_base(twist, wanted, step, inverse, out):
    """Rows of out (count, w): the wheels' speeds while the twist goes towards what is wanted, by `step` a row."""
    for k in range(len(out)):
        for i in range(3):
            twist[i] += min(max(wanted[i] - twist[i], -step[i]), step[i])
        for w in range(len(inverse)):
            out[k, w] = inverse[w, 0] * twist[0] + inverse[w, 1] * twist[1] + inverse[w, 2] * twist[2]


@kernel
def grip(position, velocity, effort, share, lever):
    """How far fingers (k,), the last joints, are closed, how fast, and with what force at the tips.

    share (k,): what each one's angle says of that, 0 where it says nothing; lever: from a tip to its joint.
    """
    first, moving = len(position) - len(share), 0
    closed = speed = torque = 0.0
    for i in range(len(share)):
        if share[i] > 0.0:
            moving += 1
            closed += share[i] * position[first + i]
            speed += share[i] * velocity[first + i]
            torque += abs(effort[first + i])
    return closed, speed, torque / (max(moving, 1) * lever)


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
