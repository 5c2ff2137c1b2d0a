"""Loop closure in worlds built to deceive: how many false closures are taken, and how many places are found again.

    python benchmarks/deceiving_worlds.py [--worlds N] [--seed N] [--show]

Each world is random, and full of places that look the same: a corridor with identical rooms, a hall with a grid of
pillars, a ring of corridors with four equal sides, two wings that are copies of each other. The base drives through it
in loops, 100 to 250 m. Headings drift by 0.4°/√m and positions by 30 mm/√m, which is 5 % of a way of 150 m, and odometry
says so; what it is off by lasts over 20 m, as a local map's drift does. Scans have 10 mm of noise.

False: accepted, off by more than 0.3 m or 3° in directions that it observes, and outside 99.9 % of its covariance.
Recall: of the keyframes within 1.5 m and 60° of one that is more than 20 m of path older, those that have an accepted
closure within 3 m of path. NEES: of accepted closures, 3 degrees of freedom. Exit code 1 when a bar is missed.
"""

import argparse
import math
import sys
import time
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from recordings import Checks

from longreach.geometry import se2
from longreach.mapping import mapper
from longreach.mapping.loop_closure import CHI2
from longreach.mapping.mapper import MapperState, PathRow
from longreach.mapping.refinement import refined
from longreach.measurement import LaserScan
from longreach.sim.room import box, cast

RECALL = 0.8
DRIFT, TURN = 0.03, math.radians(0.4)  # [m/√m, rad/√m]
LASTS = 20.0  # [m] of path
BEAMS, REACH, NOISE = 360, 10.0, 0.01
FALSE = 0.3, math.radians(3.0)  # [m, rad]
OBSERVED = 0.1  # [m]: a direction with a larger deviation is not observed


class World(NamedTuple):
    """Walls (m, 4) and the corners (k, 2) of the way [m]."""

    walls: np.ndarray
    way: np.ndarray


def wall(x0: float, y0: float, x1: float, y1: float, gaps: list[float], width: float) -> list[tuple[float, ...]]:
    """Return a wall along an axis with doors of a width at distances `gaps` from its beginning."""
    length = math.hypot(x1 - x0, y1 - y0)
    ux, uy, parts, begin = (x1 - x0) / length, (y1 - y0) / length, list[tuple[float, ...]](), 0.0
    for gap in [*sorted(gaps), length + width]:
        end = min(gap - 0.5 * width, length)
        if end > begin:
            parts.append((x0 + ux * begin, y0 + uy * begin, x0 + ux * end, y0 + uy * end))
        begin = gap + 0.5 * width
    return parts


def rooms(rng: np.random.Generator) -> World:
    """A corridor with identical rooms on one side; some are visited, and all is driven back."""
    n, wide, deep, hall = int(rng.integers(6, 10)), float(rng.uniform(4.0, 6.0)), float(rng.uniform(4.0, 6.0)), 2.2
    length, doors = n * wide, [(i + 0.5) * wide for i in range(n)]
    segments = [*wall(0, hall, length, hall, doors, 1.1), *wall(0, 0, length, 0, [], 1.0)]
    segments += [(0.0, 0.0, 0.0, hall), (length, 0.0, length, hall), (0, hall + deep, length, hall + deep)]
    segments += [(i * wide, hall, i * wide, hall + deep) for i in range(n + 1)]
    things = [box((i + 0.25) * wide, hall + 0.7 * deep, 1.4, 0.7, 0.0) for i in range(n)]
    way, y = [(1.0, 0.5 * hall)], 0.5 * hall
    for i in [*rng.permutation(n)[: n // 2].tolist(), *rng.permutation(n)[:3].tolist()]:
        x = doors[i]
        way += [(x, y), (x, hall + 0.55 * deep), (x + 0.25 * wide, hall + 0.5 * deep), (x, hall + 0.4 * deep), (x, y)]
    return World(np.vstack([np.array(segments), *things]), np.array([*way, (1.0, y), (length - 1.0, y)]))


def hall(rng: np.random.Generator) -> World:
    """A symmetric hall with a grid of equal pillars; laps between them."""
    nx, ny, period = int(rng.integers(4, 7)), int(rng.integers(3, 5)), float(rng.uniform(3.0, 5.0))
    a, b = nx * period, ny * period
    things = [box((i + 0.5) * period, (j + 0.5) * period, 0.6, 0.6, 0.0) for i in range(nx) for j in range(ny)]
    aisles = [(i * period, j * period) for i in range(1, nx) for j in range(1, ny)]
    way, at = [aisles[0]], aisles[0]
    for _ in range(24):
        along = [p for p in aisles if p != at and (p[0] == at[0] or p[1] == at[1])]
        at = along[int(rng.integers(len(along)))]
        way.append(at)
    return World(np.vstack([box(0.5 * a, 0.5 * b, a, b, 0.0), *things]), np.array([*way, way[0]]))


def ring(rng: np.random.Generator) -> World:
    """A square ring of corridors with equal sides and doors that are all the same; two laps."""
    side, wide, period = float(rng.uniform(14.0, 22.0)), float(rng.uniform(1.8, 2.6)), float(rng.uniform(2.5, 4.0))
    segments = list[tuple[float, ...]]()
    for size in (side - wide, side + wide):
        r, gaps = 0.5 * size, [period * (k + 0.5) for k in range(int(size / period))]
        corners = [(-r, -r), (r, -r), (r, r), (-r, r)]
        for k in range(4):
            (x0, y0), (x1, y1) = corners[k], corners[(k + 1) % 4]
            segments += wall(x0, y0, x1, y1, gaps, 0.9)
            s = 0.4 if size > side else -0.4  # niches behind the doors
            nx, ny = (y1 - y0) / size * s, -(x1 - x0) / size * s
            segments.append((x0 + nx, y0 + ny, x1 + nx, y1 + ny))
    r = 0.5 * side
    lap = [(-r, -r), (r, -r), (r, r), (-r, r)]
    lap = lap if rng.random() < 0.5 else [lap[0], *lap[:0:-1]]
    return World(np.array(segments), np.array([*lap, *lap, lap[0], lap[1]]))


def wings(rng: np.random.Generator) -> World:
    """Two copies of one wing, a corridor apart; both are driven, and the first one again."""
    a, b = float(rng.uniform(7.0, 10.0)), float(rng.uniform(6.0, 8.0))
    apart, wide = a + float(rng.uniform(1.0, 6.0)), 2.0
    segments = [(-2.0, -wide, apart + a + 2.0, -wide), (-2.0, -wide, -2.0, 0.0)]
    segments += [(apart + a + 2.0, -wide, apart + a + 2.0, 0.0)]
    segments += wall(-2.0, 0.0, apart + a + 2.0, 0.0, [2.0 + 0.5 * a, 2.0 + apart + 0.5 * a], 1.2)
    spots = [(rng.uniform(1.0, a - 1.0), rng.uniform(0.75 * b, b - 0.6), rng.uniform(0.3, 1.2)) for _ in range(3)]
    way, things = [(-1.0, -0.5 * wide)], []
    for x in (0.0, apart):
        segments += [(x, 0.0, x, b), (x + a, 0.0, x + a, b), (x, b, x + a, b)]
        things += [box(x + u, v, s, 0.5, 0.0) for u, v, s in spots]
    for x in (0.0, apart, 0.0, apart):
        m = x + 0.5 * a
        way += [(m, -1.0), (m, 0.4 * b), (x + 1.2, 0.5 * b), (m, 0.55 * b), (x + a - 1.2, 0.4 * b), (m, 1.0), (m, -1.0)]
    return World(np.vstack([np.array(segments), *things]), np.array([*way, (-1.0, -1.0), (apart + a, -1.0)]))


KINDS: tuple[Callable[[np.random.Generator], World], ...] = (rooms, hall, ring, wings)


def driven(way: np.ndarray) -> np.ndarray:
    """Return poses (n, 3) along straight lines and turns on the spot, 0.25 m and 10° apart at most."""
    poses, heading = list[tuple[float, ...]](), None
    for (x0, y0), (x1, y1) in zip(way[:-1], way[1:], strict=True):
        length = math.hypot(x1 - x0, y1 - y0)
        if length < 1e-6:
            continue
        to = math.atan2(y1 - y0, x1 - x0)
        turn = 0.0 if heading is None else math.remainder(to - heading, 2 * math.pi)
        n = math.ceil(abs(turn) / math.radians(10.0))
        poses += [(x0, y0, to - turn * (1 - k / n)) for k in range(1, n)]
        m = math.ceil(length / 0.25)
        poses += [(x0 + (x1 - x0) * k / m, y0 + (y1 - y0) * k / m, to) for k in range(m)]
        heading = to
    return np.array(poses)


def odometry(truth: np.ndarray, rng: np.random.Generator) -> list[PathRow]:
    """Return rows of a path that drifts, with its covariance.

    The error a metre goes with exp(-way/LASTS): over a long way a random walk of the deviations stated.
    """
    rows, pose, P = [PathRow(0.0, np.zeros(3), np.diag([1e-6] * 3))], np.zeros(3), np.diag([1e-6] * 3)
    sigma = np.array([DRIFT, DRIFT, TURN]) / math.sqrt(2.0 * LASTS)
    drift = sigma * rng.standard_normal(3)
    for k, step in enumerate(se2.between(truth[:-1], truth[1:]), 1):
        d = math.hypot(step[0], step[1]) + 0.1 * abs(step[2])
        Q, kept = d * np.array([DRIFT**2, DRIFT**2, TURN**2]), math.exp(-d / LASTS)
        drift = kept * drift + math.sqrt(1.0 - kept**2) * sigma * rng.standard_normal(3)
        step = se2.retract(step, d * drift)
        A = se2.adjoint(se2.inverse(step))
        pose, P = se2.compose(pose, step), A @ P @ A.T + np.diag(Q + 1e-10)
        rows.append(PathRow(0.2 * k, pose, P))
    return rows


def mapped(world: World, rng: np.random.Generator) -> tuple[MapperState, np.ndarray]:
    """Drive and map a world; return the mapper at the end, and the true poses of its keyframes."""
    truth, angles = driven(world.way), -np.pi + 2 * np.pi / BEAMS * np.arange(BEAMS)
    ranges = cast(world.walls, truth, angles) + NOISE * rng.standard_normal((len(truth), BEAMS))
    rows, state = odometry(truth, rng), mapper.init(np.eye(4))
    scans = [
        LaserScan(row.stamp, np.where(r < REACH, r, np.inf), -np.pi, 2 * np.pi / BEAMS, range_max=REACH)
        for row, r in zip(rows, ranges, strict=True)
    ]
    state = mapper.settled(mapper.step(state, scans, rows))
    at = {row.stamp: pose for row, pose in zip(rows, truth, strict=True)}
    return state, np.array([at[k.stamp] for k in state.keyframes])


class Judged(NamedTuple):
    """Of one world: accepted closures, false ones, their χ², places to find again, found ones, and ATE [m] after."""

    accepted: int
    false: list[int]
    chi2: list[float]
    again: int
    found: int
    ate: float


def judged(state: MapperState, truth: np.ndarray) -> Judged:
    """Hold what was accepted against the truth."""
    false, chi2, held = list[int](), list[float](), [a for a in state.accepted if a not in state.withdrawn]
    for a in held:
        m = state.matches[a]
        xi = se2.difference(m.pose, se2.between(truth[m.i], truth[m.j]))
        chi2.append(float(xi @ np.linalg.solve(m.covariance, xi)))
        values, vectors = np.linalg.eigh(m.covariance[:2, :2])
        off = math.hypot(*np.abs(vectors.T @ xi[:2])[np.sqrt(values) < OBSERVED])
        if chi2[-1] > CHI2 and (off > FALSE[0] or abs(xi[2]) > FALSE[1]):
            false.append(a)
    way, again, found = np.array([k.way for k in state.keyframes]), 0, 0
    closed = way[[state.matches[a].j for a in held]] if held else np.array([np.inf])
    for k in range(len(truth)):
        old = np.flatnonzero(way < way[k] - 20.0)
        near = np.hypot(*(truth[old, :2] - truth[k, :2]).T) < 1.5
        same = np.abs((truth[old, 2] - truth[k, 2] + np.pi) % (2 * np.pi) - np.pi) < math.radians(60.0)
        if np.any(near & same):
            again += 1
            found += bool(np.min(np.abs(closed - way[k])) < 3.0)
    poses = refined(state.keyframes, state.poses).poses
    error = se2.compose(truth[0], poses)[:, :2] - truth[:, :2]
    return Judged(len(held), false, chi2, again, found, float(np.sqrt(np.mean(np.sum(error**2, axis=1)))))


def main() -> int:
    """Print a line a kind of world; 0 when all bars are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--show", action="store_true", help="print a line a world")
    given = parser.parse_args()
    checks, results, began = Checks(), list[tuple[str, Judged]](), time.process_time()
    for n in range(given.seed, given.seed + given.worlds):
        rng, kind = np.random.default_rng(n), KINDS[n % len(KINDS)]
        state, truth = mapped(kind(rng), rng)
        one = judged(state, truth)
        results.append((kind.__name__, one))
        if given.show or one.false:
            gates = dict(Counter(m.gate or "passed" for m in state.matches))
            print(
                f"{n} {kind.__name__}: {state.way:.0f} m, {one.accepted} accepted, {len(one.false)} false, "
                f"{one.found} of {one.again} found again, ATE {one.ate:.3f} m, {gates}",
                flush=True,
            )
            for a in one.false[:3]:
                m = state.matches[a]
                off = se2.between(m.pose, se2.between(truth[m.i], truth[m.j]))
                print(f"    keyframes {m.i}, {m.j} off by {np.round(off, 2)}, {m.evidence}")
    for kind in [*(k.__name__ for k in KINDS), ""]:
        ones = [one for name, one in results if kind in name]
        again, chi2 = sum(one.again for one in ones), np.concatenate([np.zeros(0), *(one.chi2 for one in ones)])
        name = kind or "all"
        print(f"{name}: {len(ones)} worlds, {sum(one.accepted for one in ones)} closures accepted")
        checks.show(f"{name}, false closures", sum(len(one.false) for one in ones), 0, "")
        checks.show(f"{name}, recall", sum(one.found for one in ones) / max(again, 1), 1.0, "", low=RECALL)
        print(f"{name}, NEES of accepted closures {np.mean(chi2) if len(chi2) else math.nan:.2f}")
        print(f"{name}, ATE: median {np.median([one.ate for one in ones] or [math.nan]):.3f} m")
    print(f"{(time.process_time() - began) / max(given.worlds, 1):.1f} s of processor time a world")
    return 1 if checks.missed else 0


if __name__ == "__main__":
    sys.exit(main())
