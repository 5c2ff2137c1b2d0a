"""Compiled distances of moving capsules from all obstacles, over many configurations."""

import numpy as np

from longreach.kernels import kernel
from longreach.planning._distance_kernels import segment_box, segment_segment


@kernel
def _moved(R, p, x, y):
    for i in range(3):
        y[i] = R[i, 0] * x[0] + R[i, 1] * x[1] + R[i, 2] * x[2] + p[i]


@kernel
def _seen(R, p, x, y):
    for i in range(3):
        y[i] = R[0, i] * (x[0] - p[0]) + R[1, i] * (x[1] - p[1]) + R[2, i] * (x[2] - p[2])


@kernel
def _row(T, J, near, normal, out):
    """out (n,) = normalᵀ ∂near/∂q for a point that moves with the frame at T (4, 4), its Jacobian J (6, n)."""
    x, y, z = near[0] - T[0, 3], near[1] - T[1, 3], near[2] - T[2, 3]
    a, b, c = normal[0], normal[1], normal[2]
    for j in range(len(out)):
        out[j] = (
            a * J[0, j] + b * J[1, j] + c * J[2, j]
            + (y * c - z * b) * J[3, j] + (z * a - x * c) * J[4, j] + (x * b - y * a) * J[5, j]
        )  # fmt: skip


@kernel
def clearances(T, J, a, b, radius, capsules, boxes, value, jacobian):
    """Fill value (w, k) and jacobian (w, k, n) with the signed distances of one capsule from k obstacles.

    The capsule is a to b (3,) in the frame at T (w, 4, 4). capsules (c, 7): [ends, radius]; boxes (k - c, 15):
    [rotation row by row, middle, half sizes].
    """
    start, end, s, e, out = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty((3, 3))
    near, normal, origin = np.empty(3), np.empty(3), np.zeros(3)
    for w in range(len(T)):
        _moved(T[w], T[w, :3, 3], a, start)
        _moved(T[w], T[w, :3, 3], b, end)
        for i in range(len(capsules)):
            distance = segment_segment(start, end, capsules[i, :3], capsules[i, 3:6], out)
            value[w, i] = distance - radius - capsules[i, 6]
            _row(T[w], J[w], out[0], out[2], jacobian[w, i])
        for l in range(len(boxes)):
            i = len(capsules) + l
            R, p = boxes[l, :9].copy().reshape(3, 3), boxes[l, 9:12]
            _seen(R, p, start, s)
            _seen(R, p, end, e)
            value[w, i] = segment_box(s, e, boxes[l, 12:15], out) - radius
            _moved(R, p, out[0], near)
            _moved(R, origin, out[2], normal)
            _row(T[w], J[w], near, normal, jacobian[w, i])
