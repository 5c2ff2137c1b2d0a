"""Simulated worlds built to deceive a loop closure: equal rooms, rings of equal corridors, halls of columns in a grid.

    python benchmarks/deceiving_worlds.py [--count 100] [--first 0] [--length 150]

`recording_in(seed)` returns the recording in the world of a seed with its truth: wheels whose scale is 5 % wrong,
either way in each axis, and scans; no IMU. Each is mapped; a line for each seed has its kind, the length of the drive,
how far the wheels were off at its end, closures accepted, refused and waiting, false ones as `map_consistency` counts
them, and

* recall: of all passes of a place that was passed before, 1 m beside it at most, with a similar view and more than 10 m
  of path earlier, the share that an accepted closure joins: one with each end within 5 m of path;
* ATE while driving, and of the batch.

Exit code 1 when there is a false closure, or the recall of all together is below 0.8.
"""

import argparse
import math
import sys
import time

import numpy as np
from map_consistency import Drive, ate, false_closures, mapped

from longreach.geometry import se2
from longreach.io.robots import load_robot
from longreach.mapping import mapper
from longreach.mapping.keyframes import ways
from longreach.measurement import Recording
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.long_drive import long_drive
from longreach.sim.record import record_motion
from longreach.sim.sensors import LidarTiming, SensorConfig
from longreach.sim.worlds import Box, Column, Copies, Gap, Wall, World, WorldDescription

DRIFT = 0.05
KINDS = ("rooms", "ring", "hall")
_THICK = 0.12  # of walls [m]
BESIDE, TURNED, EARLIER = 1.0, math.radians(45.0), 10.0  # a place that was passed before [m, rad, m of path]
JOINED = 5.0  # [m] of path from a closure's ends
RECALL = 0.8


def world_of(seed: int) -> World:
    """Return the world of a seed; the robot starts at its origin."""
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    world = _hall(rng) if kind == "hall" else _around(rng, with_rooms=kind == "rooms")
    start = world.stations["start"]
    return world.model_copy(update={"name": f"{kind}-{seed}"}).world().moved(-start[0], -start[1])


def recording_in(seed: int, length: float = 150.0) -> Recording:
    """Drive the thing through the world of a seed, its wheels' scale wrong by 5 %, and return what was recorded."""
    world, rng = world_of(seed), np.random.default_rng([seed, 1])
    slip = (DRIFT * rng.choice([-1.0, 1.0], 3)).tolist()
    sensors = SensorConfig(lidar=LidarTiming(rate=20.0))
    config = KinematicConfig(sensors=sensors, present=("wheels", "lidar"), slip=tuple(slip))
    robot = KinematicRobot(load_robot("thing"), world, seed=seed, config=config)
    return record_motion(robot, long_drive(world, length, seed)).replace(name=world.name)


def _furniture(rng: np.random.Generator, half_width: float, half_depth: float) -> tuple[list[Box], list[Column]]:
    """Draw what stands in each of the equal rooms: one thing in its middle, others along its walls."""
    middle = Box(x=0.0, y=0.2, length=rng.uniform(0.4, 0.9), width=rng.uniform(0.3, 0.7), yaw=rng.uniform(-0.5, 0.5))
    shelf = Box(x=0.25 - half_width, y=rng.uniform(-0.5, 1.0), length=0.3, width=rng.uniform(0.8, 2.0))
    board = Box(x=rng.uniform(-0.8, 0.8), y=half_depth - 0.3, length=rng.uniform(0.8, 2.0), width=0.35)
    return [middle, shelf, board], [Column(x=half_width - 0.3, y=half_depth - 0.4, radius=0.15)]


def _around(rng: np.random.Generator, with_rooms: bool) -> WorldDescription:
    """Return a ring of corridors around a block, with or without equal rooms on two sides, symmetric by half a turn."""
    count, period, depth, wide = int(rng.integers(3, 6)), rng.uniform(6.0, 7.0), rng.uniform(5.8, 6.6), 2.4
    length = count * period
    broad = rng.uniform(6.0, 12.0) if with_rooms else length  # without rooms a square: a quarter turn looks the same
    low, high = -wide, broad + wide
    at = [(period * (k + 0.5), high + 0.5 * depth, 0.0) for k in range(count)]
    at += [(length - x, broad - y, math.pi) for x, y, _ in at]
    stations = {"start": (1.2, -0.5 * wide, 0.0)}
    corners = [(-0.5 * wide, -0.5 * wide), (length + 0.5 * wide, -0.5 * wide)]
    corners += [(x, broad + 0.5 * wide) for x, _ in corners[::-1]]
    stations |= {f"corner{i}": (x, y, 0.2) for i, (x, y) in enumerate(corners)}
    ways, gaps = [], []
    for k, pose in enumerate(at if with_rooms else []):
        local = {"out": (0.0, -0.5 * wide, 0.2), "gap": (0.0, 0.0, 0.0), "in": (0.0, 1.5, 0.0)}
        local |= {"a": (-1.6, 1.5, 0.1), "b": (-1.6, 4.4, 0.1), "c": (1.6, 4.4, 0.1), "d": (1.6, 1.5, 0.1)}
        for name, (x, y, slack) in local.items():
            stations[f"{name}{k}"] = (*se2.compose(np.array(pose), np.array([x, y - 0.5 * depth, 0.0]))[:2], slack)
        ways.append([f"{name}{k}" for name in ("out", "gap", "in", "a", "b", "c", "d", "in")])
        gaps.append(Gap(x=stations[f"gap{k}"][0], y=stations[f"gap{k}"][1], width=1.0))
    for axis, across in ((0, corners[0][1]), (0, corners[2][1]), (1, corners[0][0]), (1, corners[1][0])):
        along = [name for name, place in stations.items() if abs(place[1 - axis] - across) < 1e-6]
        ways.append(sorted(along, key=lambda name, axis=axis: stations[name][axis]))
    outer = [(low, low), (length + wide, low), (length + wide, high), (low, high)]
    block = [(0.0, 0.0), (length, 0.0), (length, broad), (0.0, broad)]
    walls = [Wall(corners=tuple(outer), gaps=tuple(gaps), thickness=_THICK, closed=True)]
    walls.append(Wall(corners=tuple(block), thickness=_THICK, closed=True))
    copies = ()
    if with_rooms:
        half = (0.5 * period, 0.5 * depth)
        shell = Wall(corners=((-half[0], -half[1]), (-half[0], half[1]), half, (half[0], -half[1])), thickness=_THICK)
        boxes, columns = _furniture(rng, *half)
        copies = (Copies(at=tuple(at), walls=(shell,), boxes=tuple(boxes), columns=tuple(columns)),)
    chains = tuple(tuple(way) for way in ways)
    return WorldDescription(name="ring", walls=tuple(walls), copies=copies, stations=stations, ways=chains)


def _hall(rng: np.random.Generator) -> WorldDescription:
    """Return a hall of columns in a grid, all alike, and ways between them."""
    columns, rows = (int(n) for n in rng.integers(4, 7, 2))
    period, radius = rng.uniform(4.0, 6.0), rng.uniform(0.2, 0.4)
    at = [(period * (i + 1), period * (j + 1), 0.0) for i in range(columns - 1) for j in range(rows - 1)]
    stations = {f"{i}-{j}": (period * (i + 0.5), period * (j + 0.5), 0.4) for i in range(columns) for j in range(rows)}
    names = {"0-0": "start"}
    stations = {names.get(name, name): place for name, place in stations.items()}
    ways = [tuple(names.get(f"{i}-{j}", f"{i}-{j}") for i in range(columns)) for j in range(rows)]
    ways += [tuple(names.get(f"{i}-{j}", f"{i}-{j}") for j in range(rows)) for i in range(columns)]
    wall = [(0.0, 0.0), (columns * period, 0.0), (columns * period, rows * period), (0.0, rows * period)]
    pillars = Copies(at=tuple(at), columns=(Column(x=0.0, y=0.0, radius=radius),))
    walls = (Wall(corners=tuple(wall), closed=True),)
    return WorldDescription(name="hall", walls=walls, copies=(pillars,), stations=stations, ways=tuple(ways))


def _by_wheels(recording: Recording) -> np.ndarray:
    """Return where the wheels alone say that the drive ended."""
    described, pose = load_robot("thing").description, np.zeros(3)
    ticks = np.array([record.ticks for record in recording.wheels])
    turned = np.diff(ticks, axis=0) * described.encoder.radians_per_tick
    for step in turned @ np.linalg.pinv(described.base.inverse_matrix).T:
        pose = se2.retract(pose, step)
    return pose


def passed_again(drive: Drive) -> list[tuple[int, int]]:
    """Return pairs of keyframes: each with the nearest one of every earlier pass of the same place."""
    way, true = ways(drive.state.keyframes), drive.true_keyframes
    found = []
    for j in range(len(way)):
        distance = np.hypot(*(true[:j, :2] - true[j, :2]).T)
        turned = np.abs(np.mod(true[:j, 2] - true[j, 2] + math.pi, 2 * math.pi) - math.pi)
        near = np.flatnonzero((distance < BESIDE) & (turned < TURNED) & (way[j] - way[:j] > EARLIER))
        passes = np.split(near, np.flatnonzero(np.diff(way[near]) > JOINED) + 1)
        found += [(int(one[np.argmin(distance[one])]), j) for one in passes if len(one)]
    return found


def recalled(drive: Drive) -> tuple[int, int]:
    """Return how many passes of places that were passed before a closure joins, and how many there are."""
    way, pairs = ways(drive.state.keyframes), passed_again(drive)
    ends = np.array([(way[m.i], way[m.j]) for m in drive.closures]).reshape(-1, 2)
    joined = [np.any(np.all(np.abs(ends - [way[i], way[j]]) < JOINED, axis=1)) for i, j in pairs]
    return int(np.sum(joined)), len(pairs)


def main() -> int:
    """Print a line for each world; 0 when there is no false closure and enough recall."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--length", type=float, default=150.0)
    asked = parser.parse_args()
    print("| world | way m | wheels off m / ° | accepted | refused | waiting | false | recall | ATE m | s |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    total = np.zeros(3, dtype=int)  # false, joined, pairs
    for seed in range(asked.first, asked.first + asked.count):
        began, recording = time.perf_counter(), recording_in(seed, asked.length)
        off = se2.difference(_by_wheels(recording), recording.truth.poses[-1])
        total += show(mapped(recording), f"{np.hypot(*off[:2]):.2f} / {abs(math.degrees(off[2])):.1f}", began)
    recall = total[1] / max(total[2], 1)
    print(f"\n{total[0]} false closures in {asked.count} worlds (bar 0); recall {recall:.3f} (bar {RECALL})")
    return 1 if total[0] or recall < RECALL else 0


def show(drive: Drive, wheels: str, began: float) -> tuple[int, int, int]:
    """Print the line of a world; return false closures, and passes that are joined and that there are."""
    state, solved = drive.state, drive.solved
    refused, false, (joined, pairs) = sum(bool(m.gate) for m in state.matches), false_closures(drive), recalled(drive)
    batch, _ = mapper.on_map(state.keyframes, solved.poses, drive.marginals, drive.rows)
    print(
        f"| {drive.recording.name} | {state.way:.0f} | {wheels} | {len(drive.closures)} | {refused} "
        f"| {len(state.matches) - refused - len(state.accepted)} | {false} | {joined / max(pairs, 1):.2f} of {pairs} "
        f"| {ate(drive.driving, drive.truth):.3f}, {ate(batch, drive.truth):.3f} | {time.perf_counter() - began:.0f} |",
        flush=True,
    )  # fmt: skip
    return false, joined, pairs


if __name__ == "__main__":
    sys.exit(main())
