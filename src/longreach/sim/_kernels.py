"""Compiled ray casting in the plane."""

import math

from longreach.kernels import kernel

_ENDS = 1e-9  # a ray through a corner hits, whatever the rounding


@kernel
def cast_all(poses, angles, segments, out):
    """Distance along each ray to the nearest segment (x0, y0, x1, y1), inf where there is none."""
    for n in range(len(poses)):
        x, y, heading = poses[n, 0], poses[n, 1], poses[n, 2]
        for b in range(len(angles)):
            dx, dy = math.cos(heading + angles[b]), math.sin(heading + angles[b])
            nearest = math.inf
            for m in range(len(segments)):
                px, py = segments[m, 0] - x, segments[m, 1] - y
                ex, ey = segments[m, 2] - segments[m, 0], segments[m, 3] - segments[m, 1]
                area = dx * ey - dy * ex
                if area == 0.0:
                    continue
                part = (px * dy - py * dx) / area
                if -_ENDS <= part <= 1.0 + _ENDS:
                    distance = (px * ey - py * ex) / area
                    if 0.0 < distance < nearest:
                        nearest = distance
            out[n, b] = nearest
