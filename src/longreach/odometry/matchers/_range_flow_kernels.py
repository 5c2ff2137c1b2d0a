"""Compiled range flow of 2016: the warp of a scan, the pull to the last motion, and a match coarse to fine."""

import math
from typing import NamedTuple

import numpy as np

from longreach.geometry._kernels import se2_adjoint, se2_compose, se2_exp, se2_log
from longreach.kernels import kernel
from longreach.odometry.matchers import _flow_kernels
from longreach.odometry.matchers._flow_kernels import carried, flow_covariance, flow_rows, robust_flow, scan_pyramid

_FRESH = 0.3  # weight of the last twist in the running mean


class RangeFlowConfig(NamedTuple):
    """Parameters of range flow; the defaults serve 180 to 1081 beams at 5 to 40 Hz."""

    iterations: int = 5  # reweightings a level at most; the authors' code of 2016
    noise: float = 0.1  # [m] floor under the derivatives in a row's weight; 0.2 in SRF 2018, 0.01 of scanners
    blend_covariance: float = 5000.0  # pull to the last motion per variance; SRF 2018
    blend_constant: float = 0.02  # constant pull to the last motion; SRF 2018
    share: float = 0.02  # deviation of a translation in distances between beams, from aliasing; ours


@kernel(fastmath=True)
def warp(r, cos, sin, increment, x, y, theta, warped, weight):
    """Step 2: carry the new scan by the motion (x, y, θ) into the old one's beams.

    Each point gives its range to its two neighbouring beams by nearness. (The 2016 code squares it, and hides rotations
    below a beam: its heading error at 1081 beams is four times larger.)
    """
    n = len(r)
    ct, st = math.cos(theta), math.sin(theta)
    for u in range(n):
        warped[u] = weight[u] = 0.0
    for u in range(n):
        if r[u] <= 0.0:
            continue
        turned, square = carried(r[u], cos[u], sin[u], increment, x, y, ct, st)
        position, distance = u + turned, math.sqrt(square)
        if position < 0.0 or position > n - 1:
            continue
        left = min(int(position), n - 2)
        w = position - left
        warped[left] += (1.0 - w) * distance
        weight[left] += 1.0 - w
        warped[left + 1] += w * distance
        weight[left + 1] += w
    for u in range(n):
        warped[u] = warped[u] / weight[u] if weight[u] > 1e-3 else 0.0


@kernel
def blend(xi, H, V, variance, expected, c, d, covariance):
    """Step 8: in the covariance's eigenbasis draw ξ to the expected one; what that moved may be wrong by as much."""
    floor = 1e-12 * max(H[0, 0], max(H[1, 1], H[2, 2])) + 1e-300
    for i in range(3):
        pull, moved = c * variance / max(H[i, i], floor) + d, 0.0
        for j in range(3):
            moved += V[j, i] * (expected[j] - xi[j])
        moved *= pull / (1.0 + pull)
        for j in range(3):
            xi[j] += V[j, i] * moved
            for l in range(3):
                covariance[j, l] += V[j, i] * V[l, i] * moved * moved


@kernel
def sampling_error(ranges, increment, x, y, theta, share):
    """Deviation [m] of a translation by sampling: a share of the distance of points, or of their motion if less."""
    total, n = 0.0, 0
    for r in ranges:
        if r > 0.0:
            total += r
            n += 1
    distance = total / max(n, 1)
    return share * min(distance * increment, math.hypot(x, y) + distance * abs(theta))


@kernel
def step_scan(
    scan, low, high, flipped, share, old, new, start, cos, sin, increments, motion, mount, config, pose, covariance
):  # fmt: skip
    """Fill the pyramid `new` from the ranges of a scan between low and high, and match it, coarse to fine, to `old`.

    motion (2, 3): the laser's last twist per scan and its running mean, both brought up to date. share: the part of it
    that goes by from beam to beam. Fills the base's pose (3,) and covariance (3, 3), carried from the laser through the
    planar mount (3,). Returns the rows used on the finest level, 0 where the result is not finite.
    """
    ranges, work, A = np.empty(len(scan)), np.empty((4, start[1])), np.empty((8, start[1]))
    xi, expected, H, V = np.empty(3), np.empty(3), np.empty((3, 4)), np.empty((3, 3))
    local, adjoint = np.zeros((3, 3)), np.empty((3, 3))
    scan_pyramid(scan, low, high, flipped, cos, sin, increments[0], motion[1], share, start, ranges, new)
    x, y, theta, m = 0.0, 0.0, 0.0, 0
    for level in range(len(start) - 2, -1, -1):
        at, increment, fade = slice(start[level], start[level + 1]), increments[level], math.exp(-level)
        warped, rest = work[0, : start[level + 1] - start[level]], work[1:]
        for _ in range(_flow_kernels.LINEARISATIONS):
            warp(new[at], cos[at], sin[at], increment, x, y, theta, warped, rest[0])
            m = flow_rows(old[at], warped, cos[at], sin[at], increment, 1.0, config.noise, False, rest, 0, A)
            if m <= 3:
                break
            variance, k = robust_flow(A, m, config.iterations, False, xi, H, V)
            if level == 0:
                flow_covariance(A, m, xi, k, False, H, V, local)
            done = se2_log(x, y, theta)
            for j in range(3):
                expected[j] = motion[0, j] - done[j]
            blend(xi, H, V, variance, expected, config.blend_covariance * fade, config.blend_constant * fade, local)
            dx, dy, dt = se2_exp(xi[0], xi[1], xi[2])
            x, y, theta = se2_compose(x, y, theta, dx, dy, dt)
            if abs(xi[0]) + abs(xi[1]) + abs(xi[2]) < _flow_kernels.SETTLED:
                break
    motion[0, 0], motion[0, 1], motion[0, 2] = se2_log(x, y, theta)
    for i in range(3):  # a mean, for an error of the last twist would skew the next scan, and come back larger
        motion[1, i] += _FRESH * (motion[0, i] - motion[1, i])
    deviation = sampling_error(ranges, increments[0], x, y, theta, config.share)
    for i in range(2):
        local[i, i] += deviation * deviation
    pose[0], pose[1], pose[2] = _flow_kernels.as_seen_from(mount[0], mount[1], mount[2], x, y, theta)
    se2_adjoint(mount[0], mount[1], mount[2], adjoint)
    _flow_kernels.transformed(adjoint, local, covariance)
    for i in range(3):
        covariance[i, i] += 1e-12
    return m if math.isfinite(pose.sum() + covariance.sum()) else 0
