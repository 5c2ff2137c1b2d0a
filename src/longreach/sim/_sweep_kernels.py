"""A laser's sweep while its base moves, compiled."""

import math

from longreach.kernels import kernel

_ENDS = 1e-9  # a ray through a corner hits, whatever the rounding


@kernel
def sweep(poses, first, dt, stamp, beam_time, angles, segments, out):
    """Distance along each beam to the nearest segment (x0, y0, x1, y1), inf where there is none.

    poses (n, 3) of the laser at the times first + i dt, headings not wrapped; beam b is cast at stamp + b beam_time
    from where the laser then is, on the straight line between two poses.
    """
    last = len(poses) - 1
    for b in range(len(angles)):
        place = min(max((stamp + b * beam_time - first) / dt, 0.0), float(last))
        i = min(int(place), last - 1)
        part = place - i
        x = poses[i, 0] + part * (poses[i + 1, 0] - poses[i, 0])
        y = poses[i, 1] + part * (poses[i + 1, 1] - poses[i, 1])
        heading = poses[i, 2] + part * (poses[i + 1, 2] - poses[i, 2]) + angles[b]
        dx, dy = math.cos(heading), math.sin(heading)
        nearest = math.inf
        for m in range(len(segments)):
            px, py = segments[m, 0] - x, segments[m, 1] - y
            ex, ey = segments[m, 2] - segments[m, 0], segments[m, 3] - segments[m, 1]
            area = dx * ey - dy * ex
            across = px * dy - py * dx
            # The ray's line must cut the segment, 0 <= across / area <= 1: seen without a division.
            if area == 0.0 or abs(2.0 * across - area) > (1.0 + _ENDS) * abs(area):
                continue
            distance = (px * ey - py * ex) / area
            if 0.0 < distance < nearest:
                nearest = distance
        out[b] = nearest
