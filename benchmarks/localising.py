"""Localising in a map of simulated drives and of halves of real logs: errors, global start, lost and found again.

    python benchmarks/localising.py [--only tracking|starts|lost|grid|halves] [--seeds N] [--first N] [--data FOLDER]

* tracking: laboratory and building with physics. A drive makes the map, others are localised in it: RMS and NEES while
  moving and at rest for 60 s, time a scan. In the building all go the mapping drive's way, with other noise and slip.
* starts: single scans of other drives, searched for on the whole map; 200 a world with `--seeds 5`. Right: within 0.5 m
  and 5° with a weight above 0.9, where the world has no place alike and the map covers 90 % of the beams. Ambiguous: no
  such weight, where it has. Wrong: any such weight elsewhere, also of scans from beyond the map.
* lost: 5 times a drive, the base is carried away by 2 m or more, which odometry does not see: seconds until the alarm,
  and whether it was found again. Drives without that: false alarms an hour, and a Kolmogorov-Smirnov test of p-values a
  window apart.
* grid: the same drives in the map that `longreach map` draws for map_server, in cells of 5 cm.
* halves: Intel, FR079 and CSAIL (FOLDER, or LONGREACH_DATA): the first half in time is the map, the second is localised
  in it. Relations with one end in each, beside the same of the whole log mapped; what is off unnoticed.

Truth is carried into the map's frame by the rigid alignment of the mapping run. Parameters were chosen on seeds 101,
102 and 401 to 408. Exit code 1 when a bar is missed.
"""

import argparse
import math
import os
import sys
import time
from collections import Counter
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from recordings import Checks
from scipy.stats import kstest

from longreach.app.configuration import EstimateConfig
from longreach.app.estimate import localized, sensor_mount
from longreach.app.inputs import open_run
from longreach.app.map import build_map
from longreach.evaluation.alignment import rigid_alignment
from longreach.evaluation.relations import relation_errors
from longreach.geometry import se2
from longreach.io.robots import load_robot
from longreach.localization.config import filter_for
from longreach.mapping import global_start, known_map, lost, map_localizer
from longreach.mapping.known_map import KnownMap
from longreach.mapping.map_file import Map
from longreach.mapping.mapper import PathRow
from longreach.mapping.occupancy import read_map_server, render, write_map_server
from longreach.measurement import LaserScan, Recording
from longreach.odometry.scan_geometry import scan_geometry
from longreach.robot.description import RobotDescription
from longreach.sim.drive import make_drive, middle, move
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.long_drive import long_drive, tucked
from longreach.sim.physics import Simulation
from longreach.sim.record import record, steered
from longreach.sim.worlds import load_world
from longreach.trajectory import PoseTrajectory

THING = load_robot("thing")
POSITION, HEADING, NEES, MS = 8.0, 0.2, (2.0, 4.5), 2.0  # bars [mm, deg, -, ms a scan]
SHARE, SECONDS, ALARM, RATIO = 0.95, 2.0, 5.0, 1.3  # bars of starts [1, s], an alarm [s], and halves [1]
REST = 60.0  # [s]
MAPPED, COVERED = 2.0, 0.9  # [m] from a keyframe, and of the beams: else the map does not show where the base is
RIGHT = 0.5, math.radians(5.0)  # [m, rad]
SIGMAS = np.diag([0.2**2, 0.2**2, 0.1**2])
LENGTHS = {"laboratory": (60.0, 60.0), "building": (250.0, 60.0), "storehouse": (250.0, 60.0), "twins": (250.0, 60.0)}
STARTS = 40  # a drive
KIDNAPS, AROUND = 5, 500  # a drive; scans before and after


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
    rows, laser = path_of(recording, THING.description)
    assert recording.truth is not None
    truth, _ = recording.truth.at(np.array([row.stamp for row in rows]))
    truth = se2.compose(np.broadcast_to(T_map_truth, truth.shape), truth)
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


@dataclass(frozen=True, eq=False)
class Drive:
    """A drive in a world that was mapped: scans with the rows of odometry's path, and where the base was on the map."""

    scans: tuple[LaserScan, ...]
    rows: list[PathRow]
    laser: np.ndarray
    truth: np.ndarray
    in_world: np.ndarray
    still: float


def path_of(recording: Recording, robot: RobotDescription) -> tuple[list[PathRow], np.ndarray]:
    """Return the rows of odometry's path at the scans, and the laser's mount."""
    config = EstimateConfig()
    done = localized(recording, robot, config.model_copy(update={"filter": filter_for(config, robot)}), lambda *_: None)
    stamps = {scan.stamp for scan in recording.scans}
    return [PathRow(*row) for row in done.output.rows if row.stamp in stamps], sensor_mount(recording, robot, "lidar")


def kinematic(world: str, seed: int, length: float, rest: float) -> tuple[Recording, float]:
    """Return a drive without forces, another way with each seed, and from when on the base stands [s]."""
    place, shift = load_world(world), np.zeros(2)
    if world == "laboratory":
        drive = make_drive(THING.description, length, np.random.default_rng(seed).spawn(2)[0])
        shift = np.array(middle(drive))
        place = place.moved(*shift)
    robot = KinematicRobot(THING, place, seed=seed, config=KinematicConfig(present=("wheels", "imu", "lidar")))
    rate = robot.capabilities.base_rate
    steps = np.arange(math.ceil(length * rate) + 1) / rate
    motion = move(drive, steps) if world == "laboratory" else long_drive(place, length, seed, rate)
    at, duration = steered(robot, motion), len(motion.poses) / rate
    found = record(robot, lambda t: at(t) if t < duration else np.zeros(3), duration + rest)
    assert found.truth is not None
    poses = np.array(found.truth.poses)
    poses[:, :2] -= shift
    return found.replace(truth=type(found.truth)(found.truth.stamps, poses)), duration + 1.0


@cache
def mapped(world: str) -> tuple[Map, KnownMap]:
    """Return the map that a drive of seed 0 makes of a world."""
    made = build_map(kinematic(world, 0, LENGTHS[world][0], 0.1)[0], THING)
    return made, known_map.prepared(made)


@cache
def driven_in(world: str, seed: int) -> Drive:
    """Return a drive in a world that is mapped."""
    recording, still = kinematic(world, seed, LENGTHS[world][1], REST)
    rows, laser = path_of(recording, THING.description)
    assert recording.truth is not None
    truth, _ = recording.truth.at(np.array([row.stamp for row in rows]))
    motion = mapped(world)[0].T_truth_map
    assert motion is not None
    on_map = se2.compose(np.broadcast_to(se2.inverse(motion), truth.shape), truth)
    by_stamp = {scan.stamp: scan for scan in recording.scans}
    return Drive(tuple(by_stamp[row.stamp] for row in rows), rows, laser, on_map, truth, still)


def is_right(pose: np.ndarray, truth: np.ndarray) -> bool:
    """Whether a pose is where the base is."""
    off = se2.difference(pose, truth)
    return bool(math.hypot(off[0], off[1]) < RIGHT[0] and abs(off[2]) < RIGHT[1])


def starts(world: str, seeds: range, checks: Checks) -> None:
    """Search single scans on the whole map."""
    known, place, times = mapped(world)[1], load_world(world), []
    counts: dict[str, Counter[str]] = {"unique": Counter(), "alike": Counter(), "not shown": Counter()}
    for drive in (driven_in(world, seed) for seed in seeds):
        geometry = scan_geometry(drive.scans[0], drive.laser, 5)
        moving = [k for k, row in enumerate(drive.rows) if row.stamp < drive.still]
        for k in moving[:: len(moving) // STARTS][:STARTS]:
            scan, truth = known_map.features_of(drive.scans[k], geometry, np.zeros(3)), drive.truth[k]
            begun = time.process_time()
            found = global_start.search(known, scan)
            times.append(time.process_time() - begun)
            nearest, distance = known.nearest(truth)
            shown = distance < MAPPED and known.evidence(nearest, scan, truth).covered > COVERED
            kind = "not shown" if not shown else "alike" if len(place.twin_poses(drive.in_world[k])) else "unique"
            settled = bool(found) and found[0].weight > 0.9
            counts[kind]["open" if not settled else "right" if is_right(found[0].pose, truth) else "wrong"] += 1
    print(f"{world}, starts: " + "; ".join(f"{kind} {dict(count)}" for kind, count in counts.items()))
    for kind, what in (("unique", "right"), ("alike", "open")):
        if total := sum(counts[kind].values()):
            checks.show(f"{world}, {kind} places {what}", counts[kind][what] / total, 1.0, "", SHARE)
    checks.show(f"{world}, wrong", sum(count["wrong"] for count in counts.values()), 0, "")
    checks.show(f"{world}, search, longest", max(times), SECONDS, "s")


def kidnapped(drive: Drive, a: int, b: int) -> tuple[list[LaserScan], list[PathRow], np.ndarray]:
    """Carry the base from row a to row b within a scan, and let odometry go on as if nothing were."""
    rows, scans = drive.rows[a - AROUND : a + 1], list(drive.scans[a - AROUND : a + 1])
    for k in range(b, b + AROUND):
        stamp = rows[AROUND].stamp + 0.025 + drive.rows[k].stamp - drive.rows[b].stamp
        moved = se2.between(drive.rows[b].pose, drive.rows[k].pose)
        grown = np.maximum(np.diag(drive.rows[k].covariance - drive.rows[b].covariance), 0.0)
        rows.append(PathRow(stamp, se2.compose(rows[AROUND].pose, moved), rows[AROUND].covariance + np.diag(grown)))
        scans.append(replace(drive.scans[k], stamp=stamp))
    return scans, rows, np.concatenate([drive.truth[a - AROUND : a + 1], drive.truth[b : b + AROUND]])


def at_start(known: KnownMap, drive: Drive, pose: np.ndarray) -> global_start.GlobalStartState:
    """Return a localizer that knows where it starts."""
    settled = map_localizer.init(known, drive.laser, pose, SIGMAS)
    return replace(global_start.init(known, drive.laser), settled=settled)


def lost_and_found(world: str, seeds: range, checks: Checks) -> None:
    """Carry the base away, and let it drive where it is not."""
    known, late, found = mapped(world)[1], [], []
    alarms, hours, ps = 0, 0.0, []
    for seed in seeds:
        drive, rng = driven_in(world, seed), np.random.default_rng(seed)
        on = np.array([known.nearest(pose)[1] < MAPPED for pose in drive.truth])
        last = sum(row.stamp < drive.still for row in drive.rows) - AROUND
        places = [k for k in range(AROUND, last) if on[k - AROUND : k + AROUND].mean() > 0.9]
        for a, b in rng.choice(places, (KIDNAPS, 2)) if places else ():
            if np.hypot(*(drive.truth[a] - drive.truth[b])[:2]) < 2.0:
                continue
            scans, rows, truth = kidnapped(drive, a, b)
            _, given, said = global_start.step(at_start(known, drive, truth[0]), scans, rows)
            when = [c.stamp for c in said if c.reason.startswith(global_start.LOST)]
            late.append(min(when, default=math.inf) - rows[AROUND].stamp)
            found.append(is_right(given[-1].pose, truth[-1]) and not given[-1].lost)
        state, windows = at_start(known, drive, drive.truth[0]), []
        for scan, row in zip(drive.scans, drive.rows, strict=True):
            before = None if state.settled is None else state.settled.test.since
            state, _, said = global_start.step(state, [scan], [row])
            alarms += sum(c.reason.startswith(global_start.LOST) for c in said)
            if state.settled is not None and state.settled.test.since != before and row.stamp < drive.still:
                windows.append(state.settled.test.p)
        ps += windows[2 * lost.WINDOW - 1 :: lost.WINDOW]
        hours += (drive.rows[-1].stamp - drive.rows[0].stamp) / 3600.0
    if late:
        print(f"{world}: carried away {len(late)} times, alarms after {np.round(np.sort(late), 1).tolist()} s")
        checks.show(f"{world}, carried away, alarm at the latest", max(late), ALARM, "s")
        checks.show(f"{world}, found again", float(np.mean(found)), 1.0, "", 1.0)
    print(f"{world}: {hours:.2f} hours, {alarms} alarms, {len(ps)} windows")
    checks.show(f"{world}, false alarms an hour", alarms / hours, max(1.0, 1.0 / hours), "")  # one is within any bar
    checks.show(f"{world}, p-values uniform, Kolmogorov-Smirnov", float(kstest(ps, "uniform").pvalue), 1.0, "", 0.01)


def on_grid(world: str, seeds: range) -> None:
    """Localise in the grid of a map."""
    made, known = mapped(world)
    with TemporaryDirectory() as folder:
        write_map_server(Path(folder) / "map.pgm", render(made))
        grid = known_map.drawn(read_map_server(Path(folder) / "map.yaml"))
    for seed in seeds:
        drive = driven_in(world, seed)
        _, given, _ = global_start.step(at_start(grid, drive, drive.truth[0]), drive.scans, drive.rows)
        xi = se2.difference(np.array([row.pose for row in given]), drive.truth)
        P = np.array([row.covariance for row in given])
        kept = np.array([known.nearest(pose)[1] < MAPPED for pose in drive.truth]) & [not row.lost for row in given]
        nees = np.einsum("ki,kij,kj->k", xi, np.linalg.inv(P), xi)[kept].mean()
        rms = 1e3 * math.sqrt(np.mean(np.sum(xi[kept, :2] ** 2, axis=1)))
        missing = float(np.mean([row.lost for row in given]))
        print(f"{world}, seed {seed}, grid: RMS {rms:.1f} mm, NEES {nees:.2f}, lost {missing:.1%}")


def halves(name: str, data: Path, checks: Checks) -> None:
    """Localise the second half of a real log in a map of its first one."""
    run = open_run(data / name / f"{name}.clf.bz2", name, relations=data / name / f"{name}.relations")
    recording, stamps = run.recording, [scan.stamp for scan in run.recording.scans]
    half, assumed = stamps[len(stamps) // 2], run.relations
    assert assumed is not None

    def part(low: float, high: float) -> Recording:
        kept = {of: tuple(x for x in getattr(recording, of) if low <= x.stamp < high) for of in ("wheels", "scans")}
        return recording.replace(name=f"{name} from {low}", **kept)

    made, whole = build_map(part(-np.inf, half), run.robot, run.config), build_map(recording, run.robot, run.config)
    one, all_of_it = made.trajectories["mapped"], whole.trajectories["mapped"]
    known, second = known_map.prepared(made), part(half, np.inf)
    rows, laser = path_of(second, run.robot)
    _, given, _ = global_start.step(global_start.init(known, laser), second.scans, rows)
    clock, poses = np.array([row.stamp for row in given]), np.array([row.pose for row in given])
    motion = rigid_alignment(all_of_it.at(one.clock)[0][:, :2], one.poses[:, :2])
    expected = all_of_it.at(clock)[0]
    expected = se2.compose(np.broadcast_to(motion, expected.shape), expected)
    on = np.array([known.nearest(pose)[1] < known_map.FAR for pose in expected]) & [not row.lost for row in given]
    off = se2.difference(poses, expected)[on]
    wrong = (np.hypot(off[:, 0], off[:, 1]) > RIGHT[0]) | (np.abs(off[:, 2]) > RIGHT[1])
    both = PoseTrajectory(np.concatenate([one.clock, clock[on]]), np.concatenate([one.poses, poses[on]]))
    first, last, relations = assumed
    across = (np.minimum(first, last) < half) & (np.maximum(first, last) >= half)
    at = all_of_it.clock_at(np.maximum(first, last))
    across &= np.array([np.min(np.abs(clock[on] - t)) < 0.3 for t in at])
    ends = all_of_it.clock_at(first[across]), all_of_it.clock_at(last[across])
    ours = relation_errors(both, *ends, relations[across])
    theirs = relation_errors(all_of_it, first[across], last[across], relations[across])
    lost_for = np.mean([row.lost for row in given])
    print(f"{name}: found after {clock[0] - rows[0].stamp:.1f} s; lost {lost_for:.1%}; {ours.used} relations across")
    for what, a, b, unit in (
        ("translation", ours.translation.mean(), theirs.translation.mean(), "m"),
        ("rotation", np.degrees(ours.rotation.mean()), np.degrees(theirs.rotation.mean()), "deg"),
    ):
        print(f"{name}, {what}: {a:.4f} {unit}, the whole log mapped {b:.4f} {unit}")
        checks.show(f"{name}, {what} over the whole log's", a / b, RATIO, "")
    checks.show(f"{name}, rows off by 0.5 m or 5° and not lost", float(np.mean(wrong)), 0.0, "")


def tracking(world: str, seeds: range, checks: Checks) -> None:
    """Map a world with physics, and localise in it."""
    made, _ = driven(world, 0, 60.0, 0.1)
    map_ = build_map(made, THING)
    assert map_.T_truth_map is not None
    known = known_map.prepared(map_)
    for seed in seeds:
        print(f"{world}, seed {seed}: a map of {len(known.poses)} keyframes")
        recording, still = driven(world, seed, 60.0, REST)
        errors(known, se2.inverse(map_.T_truth_map), recording, still, world, checks)


def main() -> int:
    """Measure what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=["tracking", "starts", "lost", "grid", "halves"])
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--first", type=int, default=301)
    parser.add_argument("--data", type=Path, default=os.environ.get("LONGREACH_DATA"))
    options = parser.parse_args()
    checks, seeds = Checks(), range(options.first, options.first + options.seeds)

    def asked(name: str, *needs: object) -> bool:
        return options.only in (None, name) and all(needs)

    for world in ("laboratory", "building") if asked("tracking") else ():
        tracking(world, seeds, checks)
    for world in ("building", "storehouse", "twins") if asked("starts") else ():
        starts(world, seeds, checks)
    for world in ("laboratory", "building", "storehouse") if asked("lost") else ():
        lost_and_found(world, seeds, checks)
    for world in ("laboratory", "building", "storehouse") if asked("grid") else ():
        on_grid(world, seeds)
    for name in ("csail", "fr079", "intel") if asked("halves", options.data) else ():
        halves(name, options.data, checks)
    return 1 if checks.missed else 0


if __name__ == "__main__":
    sys.exit(main())
