"""Compiled clamping of velocities to what joints can do, so that the next step can do it, too.

Braking with acceleration a from velocity v, each velocity being held for at most H, takes a distance of at most

    D(v) = v² / 2a + v H,    for D(v) ≥ v dt + D(max(v - a dt, 0)) for every dt in [0, H].

So a velocity with D(v) no more than the room ahead leaves a next one that the acceleration allows and that has the
same property: with dt ≤ H no limit is ever crossed, however dt jitters.
"""

import math

from longreach.kernels import kernel


@kernel
def braking_speed(room, acceleration, hold):
    """The largest v with D(v) ≤ room; 0 where there is none."""
    if room <= 0.0:
        return 0.0
    if room == math.inf:
        return math.inf
    return 2.0 * room / (hold + math.sqrt(hold * hold + 2.0 * room / acceleration))


@kernel
def _span(i, before, dt, hold, v_max, a_max, below, above):
    """The least and the largest velocity of joint i; the acceleration comes before everything else."""
    least, most = before[i] - a_max[i] * dt, before[i] + a_max[i] * dt
    down = -min(v_max[i], braking_speed(below[i], a_max[i], hold))
    up = min(v_max[i], braking_speed(above[i], a_max[i], hold))
    return min(max(least, down), most), max(min(most, up), least)


@kernel
def limit(desired, before, dt, hold, v_max, a_max, below, above, out):
    """out (n,): the velocity in the desired direction, or as near to it as can be; True where it is another one.

    The largest part of the desired velocity that all joints can do now. Where there is none, for they still move
    otherwise, the way from the velocity before towards the desired one, as far as the accelerations allow, and each
    joint clamped by itself.
    below, above (n,): room to the position limits; hold: for how long a velocity may last.
    """
    n = len(desired)
    least, most, within = 0.0, 1.0, 1.0
    for i in range(n):
        low, high = _span(i, before, dt, hold, v_max, a_max, below, above)
        w = desired[i]
        if w == 0.0:
            if low > 0.0 or high < 0.0:
                least = math.inf
        elif w > 0.0:
            least, most = max(least, low / w), min(most, high / w)
        else:
            least, most = max(least, high / w), min(most, low / w)
        if abs(w) > v_max[i]:
            within = min(within, v_max[i] / abs(w))
    part = 1.0
    if least > most:
        for i in range(n):
            change = abs(within * desired[i] - before[i])
            if change > a_max[i] * dt:
                part = min(part, a_max[i] * dt / change)
    changed = False
    for i in range(n):
        low, high = _span(i, before, dt, hold, v_max, a_max, below, above)
        v = most * desired[i] if least <= most else before[i] + part * (within * desired[i] - before[i])
        out[i] = min(max(v, low), high)
        changed = changed or abs(out[i] - desired[i]) > 1e-12
    return changed


@kernel
def follow(target, target_before, place, dt, a_max, out):
    """out (n,): the velocity that brings joints from `place` to a moving target, without running past it.

    The target's own velocity, and on top of it what makes good the distance that was left: at half the acceleration,
    so that the other half is left for the target.
    """
    for i in range(len(target)):
        lag = target_before[i] - place[i]
        catch_up = braking_speed(abs(lag), 0.5 * a_max[i], dt)
        out[i] = (target[i] - target_before[i]) / dt + math.copysign(catch_up, lag)
