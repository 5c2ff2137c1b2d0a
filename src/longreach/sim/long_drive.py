"""Long drives along the ways of a world: from place to place, lap after lap, smooth and within a base's limits.

The base looks where it goes. The same seed gives the same drive; another one other places, speeds and laps, and each
lap passes its stations a little beside the last.
"""

import heapq
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.errors import ConfigError
from longreach.robot.footprint import footprint_of
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.drive import Motion
from longreach.sim.worlds import Ways, World

TOP_SPEED = 1.0  # [m/s]; ours, a little below the Ridgeback's
_SPEEDS = (0.7, TOP_SPEED)  # [m/s] where it is straight; ours
_ACCELERATION = 0.4  # [m/s²] along the path and across it; ours, a sixth of the Ridgeback's
_TURNING = (1.0, 0.9)  # [rad/s, rad/s²]; ours, below the Ridgeback's 2 and 1
_ROUND = 0.85  # a corner is rounded from so far before it to so far behind it [m]
_EARLY = 0.5  # the base begins to turn so far before its path does [m]
_SHARPEST = np.radians(110.0)  # turn at a corner
_STEP = 0.02  # between two points of a path [m]
_PLACES, _LAPS, _REVERSED = 4, 3, 0.3  # of a round, how often it is driven, and which part of them the other way; ours
_PIECE = 100.0  # of an endless drive [m]

_Leg = tuple[int, int]  # from which station to which


class Path(NamedTuple):
    """Points (n, 2) [m] along a path, how far along it they are (n,) [m], and the base's heading (n,), not wrapped."""

    points: Float[np.ndarray, "n 2"]
    along: Float[np.ndarray, " n"]
    heading: Float[np.ndarray, " n"]


def long_drive(world: World, length: float = 300.0, seed: int = 0, rate: float = 50.0) -> Motion:
    """Return a drive of at least `length` [m] along the ways of a world, a row each 1 / rate [s], at rest at both ends.

    It begins at (0, 0, 0).

    Raises:
        ConfigError: the world has no ways, or the length is none.
    """
    if not 0.0 < length < np.inf:
        raise ConfigError(f"A drive is longer than 0 m, but {length} m was asked for.")
    return next(endless_drive(world, seed, rate, length))


def endless_drive(world: World, seed: int = 0, rate: float = 50.0, piece: float = _PIECE) -> Iterator[Motion]:
    """Yield a drive without end in pieces of at least `piece` [m]; each begins, at rest, where the last one ended.

    Raises:
        ConfigError: the world has no ways, or none that leads along x from its origin.
    """
    ways, rng = ways_of(world), np.random.default_rng(seed)
    speed, start, legs = float(rng.uniform(*_SPEEDS)), np.zeros(2), _legs(ways, rng)
    leg, turned = next(legs), 0.0
    while True:
        passed, wanted, path, end = [leg], piece, None, start
        while path is None or path.along[-1] < piece:  # rounded corners make it shorter than its legs
            wanted += 1.0 + 0.1 * piece * (path is not None)
            while sum(_length(ways, p) for p in passed[1:]) < wanted or _length(ways, passed[-1]) < 1.0:
                passed.append(next(legs))
            leg = passed[-1]
            end = 0.5 * (ways.points[leg[0]] + ways.points[leg[1]])
            path = smooth(np.array([start, *_corners(ways, passed, rng), end]))
        turned = 2 * np.pi * round((turned - path.heading[0]) / (2 * np.pi))
        path = path._replace(heading=path.heading + turned)
        yield timed(path, speed, rate)
        start, turned = end, float(path.heading[-1])


def ways_of(world: World) -> Ways:
    """Return a world's ways.

    Raises:
        ConfigError: it has none.
    """
    if world.ways is None:
        raise ConfigError(f"The world {world.name} has no ways to drive along; take building, storehouse or twins.")
    return world.ways


def _legs(ways: Ways, rng: np.random.Generator) -> Iterator[_Leg]:
    """Yield the legs from station to station, forever; none turns back."""
    after = _graph(ways)
    leg = _first(ways, after)
    yield leg
    while True:
        places = rng.choice(len(ways.points), min(_PLACES, len(ways.points)), replace=False).tolist()
        for _ in range(_LAPS):
            for place in places[::-1] if rng.random() < _REVERSED else places:
                found = _shortest(ways, after, leg, place)
                yield from found
                leg = (leg, *found)[-1]


def _graph(ways: Ways) -> dict[_Leg, list[_Leg]]:
    """Return which legs can follow each."""
    pairs = [tuple(pair) for pair in ways.pairs.tolist()]
    legs = sorted({*pairs, *((b, a) for a, b in pairs)})
    along = {leg: ways.points[leg[1]] - ways.points[leg[0]] for leg in legs}
    cosine = np.cos(_SHARPEST)
    follows: dict[_Leg, list[_Leg]] = {}
    for leg in legs:
        u = along[leg] / np.hypot(*along[leg])
        turns = [(b, c) for b, c in legs if b == leg[1] and c != leg[0]]
        follows[leg] = [turn for turn in turns if u @ along[turn] >= cosine * np.hypot(*along[turn])]
    return follows


def _first(ways: Ways, after: dict[_Leg, list[_Leg]]) -> _Leg:
    for a, b in after:
        along = ways.points[b] - ways.points[a]
        if np.allclose(ways.points[a], 0.0) and along[0] > 0.0 and abs(along[1]) < 1e-6:
            return a, b
    raise ConfigError("A drive begins at the origin along x: put a station there, and a way that leads on along x.")


def _length(ways: Ways, leg: _Leg) -> float:
    return float(np.hypot(*(ways.points[leg[1]] - ways.points[leg[0]])))


def _shortest(ways: Ways, after: dict[_Leg, list[_Leg]], leg: _Leg, place: int) -> list[_Leg]:
    """Return the legs after one on the shortest way to a place (Dijkstra)."""
    before: dict[_Leg, _Leg] = {}
    queue = [(0.0, leg, leg)]
    while queue:
        length, here, last = heapq.heappop(queue)
        if here in before:
            continue
        before[here] = last
        if here[1] == place:
            found = [here]
            while found[-1] != leg:
                found.append(before[found[-1]])
            return found[-2::-1]
        for onward in after[here]:
            heapq.heappush(queue, (length + _length(ways, onward), onward, here))
    raise ConfigError(f"No way leads from station {leg[1]} to station {place} without turning back; add a loop.")


def _corners(ways: Ways, legs: Sequence[_Leg], rng: np.random.Generator) -> list[Float[np.ndarray, "2"]]:
    """Return the stations between the legs, each as far beside its place as it and both its neighbours allow."""
    corners = []
    for leg, onward in pairwise(legs):
        free = ways.slack[leg[1]] if ways.slack[leg[0]] > 0 and ways.slack[onward[1]] > 0 else 0.0
        corners.append(ways.points[leg[1]] + rng.uniform(-free, free, 2) / np.sqrt(2))
    # The first and the last leg are entered and left at their middles: they are straight there.
    corners[0], corners[-1] = ways.points[legs[0][1]], ways.points[legs[-1][0]]
    return corners


def smooth(corners: Float[np.ndarray, "n 2"]) -> Path:
    """Return the path along straight lines from corner to corner, with each corner rounded."""
    first, last = corners[1] - corners[0], corners[-1] - corners[-2]
    ends = [corners[0] - _ROUND * first / np.hypot(*first), corners[-1] + _ROUND * last / np.hypot(*last)]
    straight = _even(np.array([ends[0], *corners, ends[1]]))
    points = np.stack([_averaged(axis, _ROUND) for axis in straight.T], axis=1)
    points[[0, -1]] = corners[[0, -1]]
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    heading = np.unwrap(np.arctan2(*np.gradient(points, axis=0).T[::-1]))
    reach = round(_EARLY / _STEP)
    return Path(points, along, _averaged(np.pad(heading, reach, "edge"), _EARLY))


def _averaged(values: Float[np.ndarray, " n"], reach: float) -> Float[np.ndarray, " m"]:
    """Return weighted means over `reach` [m] either way; so much is missing at both ends."""
    count = round(reach / _STEP)
    weights = 1.0 - (np.arange(-count, count + 1) / (count + 1)) ** 2
    return np.convolve(values, weights / weights.sum(), "valid")


def _even(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    """Return points about a step apart along lines."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    at = np.linspace(0.0, along[-1], round(along[-1] / _STEP) + 1)
    return np.stack([np.interp(at, along, axis) for axis in points.T], axis=1)


def timed(path: Path, speed: float, rate: float) -> Motion:
    """Return how a base follows a path at a speed [m/s], slower in turns, in rows 1 / rate [s] apart."""
    from scipy.interpolate import CubicSpline  # here, for it takes a while to import
    from scipy.ndimage import minimum_filter1d

    turn = np.gradient(path.heading, path.along)
    bend, change = np.abs(turn) + 1e-9, np.abs(np.gradient(turn, path.along)) + 1e-9
    slow = [_TURNING[0] / bend, np.sqrt(_ACCELERATION / bend), np.sqrt(_TURNING[1] / change)]
    # As slow as its slowest point all through a corner: a base that gains speed in a turn has to turn faster, too.
    squared = minimum_filter1d(np.minimum(speed, np.min(slow, axis=0)), 2 * round(_ROUND / _STEP) + 1) ** 2
    squared[[0, -1]] = 0.0
    squared = _reachable(squared, path.along)
    fast = np.sqrt(_reachable(squared[::-1], path.along[-1] - path.along[::-1])[::-1])
    times = np.append(0.0, np.cumsum(2.0 * np.diff(path.along) / (fast[1:] + fast[:-1])))
    t = np.minimum(np.arange(math.ceil(times[-1] * rate) + 1) / rate, times[-1])
    i = np.minimum(np.searchsorted(times, t, side="right"), len(times) - 1) - 1
    since, gain = t - times[i], np.diff(fast**2)[i] / (2.0 * np.diff(path.along)[i])
    passed = path.along[i] + fast[i] * since + 0.5 * gain * since**2
    rows = CubicSpline(path.along, np.column_stack([path.points, path.heading]))(passed)
    velocity = np.gradient(rows, 1.0 / rate, axis=0)
    return Motion(rows, velocity, np.gradient(velocity, 1.0 / rate, axis=0))


def _reachable(squared: Float[np.ndarray, " n"], along: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return squared speeds that the acceleration allows after those before them."""
    gained = 2.0 * _ACCELERATION * along
    return np.minimum.accumulate(squared - gained) + gained


def tucked(robot: MobileManipulator) -> Float[np.ndarray, " n"]:
    """Return the robot's home with its arm's first joint turned so that as little as may be sticks out of the base."""
    q = robot.home
    if q[robot.arm].size == 0:
        return q
    footprint, turns = footprint_of(robot), np.linspace(-np.pi, np.pi, 73)
    arms = np.tile(q[robot.arm], (len(turns), 1))
    arms[:, 0] = np.clip(turns, robot.lower[robot.arm][0], robot.upper[robot.arm][0])
    capsules, (_, front, right, left) = footprint.capsules(arms), footprint.rectangle
    ends, radius = capsules[..., :4].reshape(len(turns), -1, 2, 2), capsules[..., None, 4]
    beside = np.maximum(ends[..., 1] + radius - left, right - ends[..., 1] + radius)
    out = np.maximum(np.maximum(beside, ends[..., 0] + radius - front), 0.0).max(axis=(1, 2))
    tucked = q.copy()
    tucked[robot.arm] = arms[np.argmin(out)]
    return tucked
