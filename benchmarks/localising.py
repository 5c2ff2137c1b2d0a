"""Localising in a map of simulated drives: errors and their covariance, moving and at rest, time a scan, global start.

    python benchmarks/localising.py [--seeds N] [--world laboratory|building]

Each world is mapped by one drive with physics and localised in by others: other seeds of everything random, in the
laboratory another drive, too. In the building, whose drives go elsewhere with each seed, they go the mapping drive's
way, with other noise and slip. The truth is carried into the map's frame by the rigid alignment of the mapping run. At
rest the base stands for 60 s where its drive ends. Every 50th scan is searched for on the whole map by itself.
Exit code 1 when a bar is missed.
"""

import argparse
import math
import sys
import time

import numpy as np
from recordings import Checks

from longreach.app.configuration import EstimateConfig
from longreach.app.estimate import localized, sensor_mount
from longreach.app.map import build_map
from longreach.geometry import se2
from longreach.io.robots import load_robot
from longreach.localization.config import filter_for
from longreach.mapping import global_start, known_map, map_localizer
from longreach.mapping.mapper import PathRow
from longreach.measurement import Recording
from longreach.odometry.scan_geometry import scan_geometry
from longreach.sim.drive import make_drive, middle, move
from longreach.sim.long_drive import long_drive, tucked
from longreach.sim.physics import Simulation
from longreach.sim.record import record, steered
from longreach.sim.worlds import load_world

THING = load_robot("thing")
POSITION, HEADING, NEES, MS = 8.0, 0.2, (2.0, 4.5), 2.0  # bars [mm, deg, -, ms a scan]
REST = 60.0  # [s]
MAPPED = 2.0  # [m] from a keyframe: further off the map does not show where the base is
SIGMAS = np.diag([0.2**2, 0.2**2, 0.1**2])


def driven(world: str, seed: int, length: float, rest: float) -> tuple[Recording, float]:
    """Return a drive with its truth in one frame for all seeds, and from when on the base stands [s]."""
    shift = np.zeros(2)
    if world == "laboratory":
        drive = make_drive(THING.description, length, np.random.default_rng(seed).spawn(2)[0])
        shift = np.array(middle(drive))
        room = load_world("laboratory").moved(*shift)
        simulation = Simulation(THING, room, seed=seed)
        rate = simulation.capabilities.base_rate
        motion = move(drive, np.arange(math.ceil(length * rate) + 1) / rate)
    else:
        simulation = Simulation(THING, load_world(world), seed=seed, q=tucked(THING))
        rate = simulation.capabilities.base_rate
        motion = long_drive(load_world(world), length, 0, rate)
    duration = len(motion.poses) / rate
    at = steered(simulation, motion)
    found = record(simulation, lambda t: at(t) if t < duration else np.zeros(3), duration + rest)
    assert found.truth is not None
    poses = np.array(found.truth.poses)
    poses[:, :2] -= shift
    return found.replace(truth=type(found.truth)(found.truth.stamps, poses)), duration + 1.0


def errors(known, T_map_truth: np.ndarray, recording: Recording, still: float, world: str, checks: Checks) -> None:
    """Localise a recording and print what that is worth."""
    robot = THING.description
    config = EstimateConfig()
    config = config.model_copy(update={"filter": filter_for(config, robot)})
    done = localized(recording, robot, config, lambda stage, fraction: None)
    stamps = {scan.stamp for scan in recording.scans}
    rows = [PathRow(*row) for row in done.output.rows if row.stamp in stamps]
    assert recording.truth is not None
    truth, _ = recording.truth.at(np.array([row.stamp for row in rows]))
    truth = se2.compose(np.broadcast_to(T_map_truth, truth.shape), truth)
    laser = sensor_mount(recording, robot, "lidar")
    begun = time.perf_counter()
    state = map_localizer.init(known, laser, se2.compose(truth[0], np.array([0.1, -0.1, 0.05])), SIGMAS)
    state, given, corrections = map_localizer.step(state, recording.scans, rows)
    ms = 1e3 * (time.perf_counter() - begun) / len(rows)
    xi = se2.difference(np.array([row.pose for row in given]), truth)
    P = np.array([row.covariance for row in given])
    nees = np.einsum("ki,ki->k", xi, np.linalg.solve(P, xi[:, :, None])[:, :, 0])
    on = np.array([known.nearest(pose)[1] < MAPPED for pose in truth])
    at = np.array([row.stamp for row in given])
    moving, rest = on & (at < still) & (at > at[0] + 1.0), on & (at >= still)
    position = 1e3 * math.sqrt(np.mean(np.sum(xi[moving, :2] ** 2, axis=1)))
    heading = math.degrees(math.sqrt(np.mean(xi[moving, 2] ** 2)))
    refused = sum(c.status != "used" for c in corrections)
    print(f"  {np.mean(on):.0%} of the way on the map; {refused} of {len(corrections)} fits not taken")
    checks.show(f"{world}, RMS while moving", position, POSITION, "mm")
    checks.show(f"{world}, heading while moving", heading, HEADING, "deg")
    for name, part in (("moving", moving), ("at rest", rest)):
        if part.any():
            checks.show(f"{world}, NEES {name}", float(np.mean(nees[part])), NEES[1], "", NEES[0])
    checks.show(f"{world}, time a scan", ms, MS, "ms")
    searched(known, recording, laser, rows, truth, on, world)


def searched(known, recording, laser, rows, truth, on, world) -> None:
    """Print what the search over the whole map says of single scans."""
    by_stamp, geometry = {scan.stamp: scan for scan in recording.scans}, scan_geometry(recording.scans[0], laser, 5)
    counts, times = {"right": 0, "wrong": 0, "ambiguous": 0, "nowhere": 0}, []
    for k in np.flatnonzero(on)[::50].tolist():
        scan = known_map.features_of(by_stamp[rows[k].stamp], geometry, np.zeros(3))
        begun = time.perf_counter()
        found = global_start.search(known, scan)
        times.append(time.perf_counter() - begun)
        if not found or found[0].weight <= 0.9:
            counts["ambiguous" if found else "nowhere"] += 1
            continue
        off = se2.difference(found[0].pose, truth[k])
        counts["right" if math.hypot(off[0], off[1]) < 0.5 and abs(off[2]) < math.radians(5.0) else "wrong"] += 1
    said = ", ".join(f"{count} {name}" for name, count in counts.items())
    print(f"  {world} global start: {said}; {np.median(times):.2f} s, at most {max(times):.2f} s (bar 2 s)")


def main() -> None:
    """Map and localise, world by world."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--world", choices=["laboratory", "building"])
    options = parser.parse_args()
    checks = Checks()
    for world, length in (("laboratory", 60.0), ("building", 60.0)):  # [s] and [m]
        if options.world not in (None, world):
            continue
        made, _ = driven(world, 0, length, 0.1)
        map_ = build_map(made, THING)
        assert map_.T_truth_map is not None
        known = known_map.prepared(map_)
        for seed in range(1, options.seeds + 1):
            print(f"{world}, seed {seed}: a map of {len(known.poses)} keyframes")
            recording, still = driven(world, seed, length, REST)
            errors(known, se2.inverse(map_.T_truth_map), recording, still, world, checks)
    if checks.missed:
        sys.exit(1)


if __name__ == "__main__":
    main()
