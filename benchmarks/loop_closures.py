"""Loop closure in simulation: false closures and recall in worlds built to deceive, NEES and ATE in long drives.

    python benchmarks/loop_closures.py [--worlds 100] [--first 0] [--length 150] [--drift]
    python benchmarks/loop_closures.py --world building [--worlds 20] [--length 300]

The recordings are those of `deceiving_worlds.py`: equal rooms, rings and grids, wheels whose scale is 5 % wrong; or
drives through a shipped world. Each is mapped as `longreach map` does. With --drift the mapper is given a path that
drifts in place of the localizer's: headings by 0.4°/√m and positions by 30 mm/√m, 5 % of a way of 150 m, errors that
last over 20 m, and a covariance that says so.

False: accepted, off by more than 0.3 m or 3° in directions that it observes, and outside 99.9 % of its covariance.
Recall: of the keyframes within 1.5 m and 60° of one that is more than 20 m of path older, those that have an accepted
closure within 3 m of path. NEES: of accepted closures and of final poses, 3 degrees of freedom. Exit code 1 when a bar
is missed.
"""

import argparse
import math
import sys
import time
from collections import Counter
from typing import NamedTuple

import numpy as np
from deceiving_worlds import recording_in
from recordings import Checks

from longreach.app.map import build_map
from longreach.geometry import se2
from longreach.io.robots import load_robot
from longreach.mapping import mapper, solver
from longreach.mapping.loop_closure import CHI2
from longreach.mapping.mapper import PathRow
from longreach.mapping.refinement import refined
from longreach.measurement import Recording
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.long_drive import long_drive, tucked
from longreach.sim.record import record_motion
from longreach.sim.sensors import LidarTiming, SensorConfig
from longreach.sim.worlds import load_world
from longreach.trajectory import PoseTrajectory

RECALL, NEES = 0.8, (2.0, 4.5)
ATE = 0.010  # [m] of drives through a shipped world
DRIFT, TURN = 0.03, math.radians(0.4)  # [m/√m, rad/√m]
LASTS = 20.0  # [m] of path
FALSE = 0.3, math.radians(3.0)  # [m, rad]
OBSERVED = 0.1  # [m]: a direction with a larger deviation is not observed


class Built(NamedTuple):
    """A map: matches that are closures, stamps of the keyframes [s], poses (n, 3), and gates of what was refused."""

    matches: list
    stamps: np.ndarray
    solved: solver.Solved
    gates: Counter


def recorded(world: str, seed: int, length: float) -> Recording:
    """Return a drive of the thing through a shipped world."""
    thing, place = load_robot("thing"), load_world(world)
    sensors = SensorConfig(lidar=LidarTiming(rate=20.0))
    config = KinematicConfig(sensors=sensors, present=("wheels", "imu", "lidar"))
    robot = KinematicRobot(thing, place, seed=seed, q=tucked(thing), config=config)
    return record_motion(robot, long_drive(place, length, seed)).replace(name=f"{world}-{seed}")


def as_the_program_does(recording: Recording) -> Built:
    """Map a recording by the localizer's path."""
    mapped = build_map(recording, load_robot("thing"))
    graph, weights = mapped.map.graph, mapped.map.weights
    accepted = [c.match for c in mapped.closures if c.status == "accepted"]
    gates = Counter(c.match.gate or c.status for c in mapped.closures)
    return Built(accepted, mapped.map.stamps, solver.optimize(graph, weights), gates)


def with_drift(recording: Recording, rng: np.random.Generator) -> Built:
    """Map a recording by a path that drifts from the truth."""
    assert recording.truth is not None
    scans = recording.scans[::2]
    truth, _ = recording.truth.at(np.array([scan.stamp for scan in scans]))
    rows, pose, P = [PathRow(scans[0].stamp, np.zeros(3), np.diag([1e-6] * 3))], np.zeros(3), np.diag([1e-6] * 3)
    sigma = np.array([DRIFT, DRIFT, TURN]) / math.sqrt(2.0 * LASTS)
    drift = sigma * rng.standard_normal(3)
    for scan, step in zip(scans[1:], se2.between(truth[:-1], truth[1:]), strict=True):
        d = math.hypot(step[0], step[1]) + 0.1 * abs(step[2])
        Q, kept = d * np.array([DRIFT**2, DRIFT**2, TURN**2]), math.exp(-d / LASTS)
        drift = kept * drift + math.sqrt(1.0 - kept**2) * sigma * rng.standard_normal(3)
        step = se2.retract(step, d * drift)
        A = se2.adjoint(se2.inverse(step))
        pose, P = se2.compose(pose, step), A @ P @ A.T + np.diag(Q + 1e-10)
        rows.append(PathRow(scan.stamp, pose, P))
    state = mapper.settled(mapper.step(mapper.init(recording.mounts[scans[0].frame]), scans, rows))
    accepted = [state.matches[a] for a in state.accepted if a not in state.withdrawn]
    solved = refined(state.keyframes, state.poses, mapper.closure_edges(accepted)).solved
    gates = Counter(m.gate or "passed" for m in state.matches)
    stamps = np.array([k.stamp for k in state.keyframes])
    return Built(accepted, stamps, solved, gates)


class Judged(NamedTuple):
    """Of one world: closures, false ones, their χ², places to find again, found ones, ATE [m] and NEES of the poses."""

    closures: int
    false: list
    chi2: list[float]
    again: int
    found: int
    ate: float
    nees: float


def judged(built: Built, path: PoseTrajectory) -> Judged:
    """Hold a map against the truth."""
    truth, _ = path.at(built.stamps)
    false, chi2 = list[tuple](), list[float]()
    for m in built.matches:
        xi = se2.difference(m.pose, se2.between(truth[m.i], truth[m.j]))
        chi2.append(float(xi @ np.linalg.solve(m.covariance, xi)))
        values, vectors = np.linalg.eigh(m.covariance[:2, :2])
        off = math.hypot(*np.abs(vectors.T @ xi[:2])[np.sqrt(values) < OBSERVED])
        if chi2[-1] > CHI2 and (off > FALSE[0] or abs(xi[2]) > FALSE[1]):
            false.append((m, xi))
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    closed = way[[m.j for m in built.matches]] if built.matches else np.array([np.inf])
    again = found = 0
    for k in range(len(truth)):
        old = np.flatnonzero(way < way[k] - 20.0)
        near = np.hypot(*(truth[old, :2] - truth[k, :2]).T) < 1.5
        same = np.abs((truth[old, 2] - truth[k, 2] + np.pi) % (2 * np.pi) - np.pi) < math.radians(60.0)
        if np.any(near & same):
            again += 1
            found += bool(np.min(np.abs(closed - way[k])) < 3.0)
    poses = se2.compose(truth[0], se2.between(np.broadcast_to(built.solved.poses[0], truth.shape), built.solved.poses))
    aligned = rigid_alignment(poses[:, :2], truth[:, :2])
    xi, P = se2.difference(poses, truth)[1:], solver.marginals(built.solved)[1:]
    nees = float(np.mean(np.einsum("ki,kij,kj->k", xi, np.linalg.inv(P), xi)))
    error = np.sqrt(np.mean(np.sum((aligned - truth[:, :2]) ** 2, axis=1)))
    return Judged(len(built.matches), false, chi2, again, found, float(error), nees)


def rigid_alignment(points: np.ndarray, to: np.ndarray) -> np.ndarray:
    """Return points (n, 2) moved rigidly as near as can be to others."""
    a, b = points - points.mean(axis=0), to - to.mean(axis=0)
    t = math.atan2(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b)))
    return a @ np.array([[math.cos(t), math.sin(t)], [-math.sin(t), math.cos(t)]]) + to.mean(axis=0)


def main() -> int:
    """Print a line a world, and what all have in common; 0 when all bars are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--length", type=float, default=150.0)
    parser.add_argument("--drift", action="store_true")
    parser.add_argument("--world", default="", help="a shipped world, in place of those built to deceive")
    given = parser.parse_args()
    checks, ones = Checks(), list[Judged]()
    for n in range(given.first, given.first + given.worlds):
        recording = recorded(given.world, n, given.length) if given.world else recording_in(n, given.length)
        assert recording.truth is not None
        began = time.process_time()
        built = with_drift(recording, np.random.default_rng(n)) if given.drift else as_the_program_does(recording)
        seconds, one = time.process_time() - began, judged(built, recording.truth)
        ones.append(one)
        print(
            f"{recording.name}: {one.closures} closures, {len(one.false)} false, NEES {np.mean(one.chi2):.2f}; "
            f"{one.found} of {one.again} found again; ATE {one.ate:.4f} m, NEES {one.nees:.2f}; {dict(built.gates)}; "
            f"{seconds:.0f} s",
            flush=True,
        )
        for m, xi in one.false[:3]:
            print(f"    keyframes {m.i}, {m.j} off by {np.round(xi, 2)}, {m.evidence}")
    again, chi2 = sum(one.again for one in ones), np.concatenate([one.chi2 for one in ones] or [np.zeros(0)])
    checks.show("false closures", sum(len(one.false) for one in ones), 0, "")
    checks.show("recall", sum(one.found for one in ones) / max(again, 1), 1.0, "", low=RECALL)
    checks.show("NEES of accepted closures", float(np.mean(chi2)) if len(chi2) else math.nan, NEES[1], "", low=NEES[0])
    if given.world:
        checks.show("NEES of final poses, mean", float(np.mean([one.nees for one in ones])), NEES[1], "", low=NEES[0])
        checks.show("ATE, largest", max(one.ate for one in ones), ATE, "m")
    return 1 if checks.missed else 0


if __name__ == "__main__":
    sys.exit(main())
