"""A laser's sweep while its base moves, compiled."""

import math

from longreach.kernels import kernel

_ENDS = 1e-9  # a ray through a corner hits, whatever the rounding


@kernel
def sweep(bases, mount, first, dt, stamp, beam_time, angles, segments, reach, beams, out):
    """Distance along each beam to the nearest segment (x0, y0, x1, y1), inf where there is none.

    bases (n, 3): poses at the times first + i dt, headings not wrapped; between two of them the base moves evenly.
    mount (3,): of the laser in the base; beam b is cast at stamp + b beam_time from where the laser then is. angles:
    increasing evenly. Segments farther away than `reach` [m] are left out. beams (b, 5): room to work in.
    """
    count = len(angles)
    for b in range(count):
        _pose_at(bases, mount, (stamp + b * beam_time - first) / dt, angles[b], beams[b])
        out[b] = math.inf
    # Each segment is tried by the beams of its sector alone, seen from the middle of the sweep and widened by what the
    # laser moves and turns until its ends.
    x, y, heading = beams[count // 2, 0], beams[count // 2, 1], beams[count // 2, 4]
    moved = turned = 0.0
    for b in (0, count - 1):
        moved = max(moved, math.hypot(beams[b, 0] - x, beams[b, 1] - y))
        turned = max(turned, abs(beams[b, 4] - heading))
    increment = angles[1] - angles[0]
    for m in range(len(segments)):
        x0, y0 = segments[m, 0] - x, segments[m, 1] - y
        ex, ey = segments[m, 2] - segments[m, 0], segments[m, 3] - segments[m, 1]
        part = min(max(-(x0 * ex + y0 * ey) / max(ex * ex + ey * ey, 1e-300), 0.0), 1.0)
        near = math.hypot(x0 + part * ex, y0 + part * ey)
        if near > reach + moved:
            continue
        if near <= 2.0 * moved + 1e-6:
            _try(beams, segments[m], 0, count, out)
            continue
        wider = turned + 2.0 * moved / near + 2.0 * increment
        begin = math.atan2(y0, x0)
        width = math.atan2(x0 * ey - y0 * ex, x0 * (x0 + ex) + y0 * (y0 + ey))  # from one end to the other, |.| < π
        low = begin + min(width, 0.0) - heading - wider - angles[0]
        span = (abs(width) + 2.0 * wider) / increment
        low = (low - 2.0 * math.pi * math.floor(low / (2.0 * math.pi))) / increment  # in [0, 2π)
        for k in range(2):
            start = low - k * 2.0 * math.pi / increment
            _try(beams, segments[m], max(math.floor(start), 0), min(math.ceil(start + span) + 1, count), out)


@kernel
def _pose_at(bases, mount, place, angle, beam):
    """Where a beam starts, its direction, and the laser's heading, at `place` in the list of poses."""
    last = len(bases) - 1
    place = min(max(place, 0.0), float(last))
    i = min(int(place), last - 1)
    part = place - i
    heading = bases[i, 2] + part * (bases[i + 1, 2] - bases[i, 2])
    c, s = math.cos(heading), math.sin(heading)
    beam[0] = bases[i, 0] + part * (bases[i + 1, 0] - bases[i, 0]) + c * mount[0] - s * mount[1]
    beam[1] = bases[i, 1] + part * (bases[i + 1, 1] - bases[i, 1]) + s * mount[0] + c * mount[1]
    beam[4] = heading + mount[2]
    beam[2], beam[3] = math.cos(beam[4] + angle), math.sin(beam[4] + angle)


@kernel
def spoil(ranges, noise, deviation, lost, part, nearest, farthest):
    """Make ranges noisy, in place; those out of reach, and the part that is lost, become inf."""
    for b in range(len(ranges)):
        ranges[b] += deviation * noise[b]
        if lost[b] < part or ranges[b] < nearest or ranges[b] > farthest:
            ranges[b] = math.inf


@kernel
def _try(beams, segment, begin, end, out):
    """Shorten those of the beams from `begin` to `end` that meet the segment."""
    ex, ey = segment[2] - segment[0], segment[3] - segment[1]
    for b in range(begin, end):
        px, py = segment[0] - beams[b, 0], segment[1] - beams[b, 1]
        dx, dy = beams[b, 2], beams[b, 3]
        area = dx * ey - dy * ex
        if area == 0.0:
            continue
        part = (px * dy - py * dx) / area
        if -_ENDS <= part <= 1.0 + _ENDS:
            distance = (px * ey - py * ex) / area
            if 0.0 < distance < out[b]:
                out[b] = distance
