"""Compiled: which points the laser has seen, how far the base may go on before it meets one, and whether a plan does.

The outline is a rectangle (4,) [least x, greatest x, least y, greatest y] and capsules (k, 5) [x, y, x, y, radius], in
the base's axes; points are in a frame that stands still, and a pose (3,) says where the base is in it.
"""

import math

import numpy as np

from longreach.geometry._kernels import se2_exp
from longreach.kernels import kernel

_SEEN_THROUGH = 0.1  # what lies nearer than a beam's end by this [m] is not there any more; ten times a range's noise
_OURS = 0.05  # so deep within the outline [m] lie the robot's own parts
_APART = 0.03  # between two points that are kept of a sweep [m]
_CLOSER = 1e-4  # that something within the margin may come closer [m]: nothing but rounding
_STEP = 0.02  # of the outline's way between two looks [m]


@kernel
def _distance(x, y, rectangle, capsules):
    """Signed distance [m] of a point in the base's axes from the outline."""
    dx = max(rectangle[0] - x, x - rectangle[1])
    dy = max(rectangle[2] - y, y - rectangle[3])
    least = math.hypot(max(dx, 0.0), max(dy, 0.0)) + min(max(dx, dy), 0.0)
    for i in range(len(capsules)):
        ax, ay = capsules[i, 0], capsules[i, 1]
        bx, by = capsules[i, 2] - ax, capsules[i, 3] - ay
        square = bx * bx + by * by
        t = 0.0 if square < 1e-12 else min(max(((x - ax) * bx + (y - ay) * by) / square, 0.0), 1.0)
        least = min(least, math.hypot(x - ax - t * bx, y - ay - t * by) - capsules[i, 4])
    return least


@kernel
def _seen_from(point, pose):
    """A point in the base's axes."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    x, y = point[0] - pose[0], point[1] - pose[1]
    return c * x + s * y, -s * x + c * y


@kernel
def distance_from(point, pose, rectangle, capsules):
    """Signed distance [m] of a point (2,) from the outline of a base at a pose."""
    x, y = _seen_from(point, pose)
    return _distance(x, y, rectangle, capsules)


@kernel
def _still_there(point, laser, ranges, first, increment, most):
    """Whether a point (2,) has still to be remembered: the sweep does not reach its place, and does not pass it."""
    x, y = _seen_from(point, laser)
    r = math.hypot(x, y)
    turn = (math.atan2(y, x) - first) / increment
    whole = 2.0 * math.pi / abs(increment)
    beam = round(turn - whole * math.floor((turn + 0.5) / whole))
    if beam < 0 or beam >= len(ranges) or r > most:
        return True
    if abs(ranges[beam] - r) < _SEEN_THROUGH:
        return False  # it is in the new sweep
    hidden = False
    for i in range(max(beam - 1, 0), min(beam + 2, len(ranges))):  # a beam may be lost
        hidden = hidden or 0.0 < ranges[i] < r - _SEEN_THROUGH
    return hidden


@kernel
def remember(points, count, laser, pose, ranges, first, increment, most, far, rectangle, capsules, out):
    """Fill out (n, 2) with what a sweep sees, and then with those of points (count of them) that it does not see anew.

    Return how many there are. laser, pose (3,): of the laser and of the base in the points' frame when it was taken. ranges: 0 where nothing came
    back; most, far: how far the laser sees, and how far from the base points are kept [m].
    """
    kept, x_before, y_before = 0, math.inf, math.inf
    for i in range(len(ranges)):
        r = ranges[i]
        angle = laser[2] + first + i * increment
        x, y = laser[0] + r * math.cos(angle), laser[1] + r * math.sin(angle)
        if r <= 0.0 or math.hypot(x - x_before, y - y_before) < _APART or math.hypot(x - pose[0], y - pose[1]) > far:
            continue
        if kept == len(out) or distance_from(np.array((x, y)), pose, rectangle, capsules) < -_OURS:
            continue
        out[kept, 0], out[kept, 1] = x, y
        x_before, y_before = x, y
        kept += 1
    for i in range(count):
        away = math.hypot(points[i, 0] - pose[0], points[i, 1] - pose[1])
        if kept < len(out) and away < far and _still_there(points[i], laser, ranges, first, increment, most):
            out[kept, 0], out[kept, 1] = points[i, 0], points[i, 1]
            kept += 1
    return kept


@kernel
def free_way(points, count, pose, rectangle, capsules, twist, horizon, margin):
    """For how long a twist (3,) may go on before the outline comes nearer than a margin [m] to a point, and to which.

    At most `horizon` [s], and -1 where there is no such point. Who is nearer already may move, but not closer.
    """
    reach = 0.0
    for i in range(4):
        reach = max(reach, math.hypot(rectangle[i // 2], rectangle[2 + i % 2]))
    for i in range(len(capsules)):
        for j in (0, 2):
            reach = max(reach, math.hypot(capsules[i, j], capsules[i, j + 1]) + capsules[i, 4])
    v, w = math.hypot(twist[0], twist[1]), twist[2]
    free, which = horizon, -1
    for i in range(count):
        x, y = _seen_from(points[i], pose)
        r = math.hypot(x, y)
        fastest = v + abs(w) * (r + v * horizon)  # that the point can move in the base's axes
        if r > reach + margin + fastest * horizon:
            continue
        distance = _distance(x, y, rectangle, capsules)
        closest = min(distance - _CLOSER, margin)
        if distance < -_OURS:
            continue
        t, before = 0.0, 0.0
        while t < free:
            before = t
            t = min(t + max(distance - closest, _STEP) / fastest, free)
            px, py, turned = se2_exp(twist[0] * t, twist[1] * t, w * t)
            c, s = math.cos(turned), math.sin(turned)
            dx, dy = x - px, y - py
            distance = _distance(c * dx + s * dy, -s * dx + c * dy, rectangle, capsules)
            if distance < closest:
                free, which = before, i
                break
    return free, which


@kernel
def first_contact(points, count, poses, rectangle, capsules):
    """Return the row of a plan, poses (n, 3) with capsules (n, k, 5), in which the outline meets a point, and which.

    Both -1 where none does. What is met already in the first row counts where it is met deeper.
    """
    start = np.empty(count)
    for i in range(count):
        x, y = _seen_from(points[i], poses[0])
        start[i] = _distance(x, y, rectangle, capsules[0])
    for row in range(len(poses)):
        for i in range(count):
            x, y = _seen_from(points[i], poses[row])
            if start[i] >= -_OURS and _distance(x, y, rectangle, capsules[row]) < min(start[i] - 1e-2, 0.0):
                return row, i
    return -1, -1
