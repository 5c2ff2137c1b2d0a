"""Maps of simulated drives against the truth: are covariances as large as the errors, and how large are these?

    python benchmarks/map_consistency.py [--seeds 20] [--first 0] [--length 300] [--world building --world storehouse]

The Thing without forces drives with wheels, IMU and a 10 mm laser through worlds with loops. For each drive:

* NEES of accepted closures, and of the keyframes' final poses relative to the first; 3 is ideal.
* ATE of all scans, aligned: of the batch, and while driving, where each pose is the one known when its scan came.
* Closures accepted and refused, false ones; keyframes, and the processor time that each cost early and late: a longer
  drive shows how cost grows with their number.

A closure is false where it is outside 99.9 % of its own covariance and off by more than 0.3 m or 3° in directions that
it observes. Bars are for the means over a world's drives; exit code 1 when one is missed.
"""

import argparse
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from longreach.app.configuration import EstimateConfig
from longreach.app.estimate import localized, sensor_mount
from longreach.evaluation.alignment import rigid_alignment
from longreach.geometry import se2
from longreach.io.robots import load_robot
from longreach.localization.config import filter_for
from longreach.mapping import mapper
from longreach.mapping.loop_closure import CHI2, Match
from longreach.mapping.mapper import MapperState, PathRow
from longreach.mapping.refinement import refined
from longreach.mapping.solver import Solved
from longreach.measurement import Recording
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.long_drive import long_drive
from longreach.sim.record import record_motion
from longreach.sim.worlds import load_world

ROBOT = "thing"
NEES = 2.0, 4.5
ATE_BATCH, ATE_DRIVING = 0.010, 0.020  # [m]
FALSE = 0.3, math.radians(3.0)  # [m, rad]
OBSERVED = 0.1  # [m]: a direction with a larger deviation is not observed


@dataclass(frozen=True, eq=False)
class Drive:
    """A drive that was mapped scan by scan.

    rows: the localizer's path at the scans. driving (k, 3): their poses on the map as known then. took (k,): processor
    time of the mapper's step [s]. solved, marginals (n, 3, 3): after the refinement, which took `refinement` [s].
    """

    recording: Recording
    state: MapperState
    solved: Solved
    marginals: np.ndarray
    rows: Sequence[PathRow]
    driving: np.ndarray
    took: np.ndarray
    refinement: float

    @property
    def truth(self) -> np.ndarray:
        """Where the base was at the rows (k, 3)."""
        return self._true([row.stamp for row in self.rows])

    @property
    def true_keyframes(self) -> np.ndarray:
        """Where the keyframes were (n, 3)."""
        return self._true([k.stamp for k in self.state.keyframes])

    def _true(self, stamps: Sequence[float]) -> np.ndarray:
        assert self.recording.truth is not None
        return self.recording.truth.at(np.array(stamps))[0]

    @property
    def closures(self) -> list[Match]:
        """What was accepted and not withdrawn."""
        kept = set(self.state.accepted) - set(self.state.withdrawn)
        return [self.state.matches[a] for a in sorted(kept)]


def drive_in(world: str, seed: int, length: float) -> Recording:
    """Drive the Thing through a world and return what was recorded."""
    config = KinematicConfig(present=("wheels", "imu", "lidar"))
    place = load_world(world)
    robot = KinematicRobot(load_robot(ROBOT), place, seed=seed, config=config)
    return record_motion(robot, long_drive(place, length, seed)).replace(name=f"{world}-{seed}")


def mapped(recording: Recording) -> Drive:
    """Map a recording as `build_map` does, but scan by scan."""
    robot = load_robot(ROBOT).description
    config = EstimateConfig()
    config = config.model_copy(update={"filter": filter_for(config, robot)})
    done = localized(recording, robot, config, lambda stage, fraction: None)
    scans = {scan.stamp: scan for scan in done.recording.scans}
    rows = [PathRow(*row) for row in done.output.rows if row.stamp in scans]
    state, driving, took = mapper.init(sensor_mount(done.recording, robot, "lidar")), [], []
    for row in rows:
        began = time.process_time()
        state = mapper.step(state, [scans[row.stamp]], [row])
        took.append(time.process_time() - began)
        driving.append(se2.compose(state.T_map_odom, row.pose))
    began = time.process_time()
    state = mapper.settled(state)
    closures = [state.matches[a] for a in state.accepted if a not in state.withdrawn]
    found = refined(state.keyframes, state.poses, mapper.closure_edges(closures))
    last = time.process_time() - began
    return Drive(done.recording, state, found.solved, found.marginals, rows, np.array(driving), np.array(took), last)


def closure_errors(drive: Drive, closures: Sequence[Match]) -> np.ndarray:
    """Return ξ of closures (m, 3)."""
    true, i, j = drive.true_keyframes, [m.i for m in closures], [m.j for m in closures]
    return se2.difference(np.array([m.pose for m in closures]).reshape(-1, 3), se2.between(true[i], true[j]))


def false_closures(drive: Drive) -> int:
    """Return how many accepted closures are false."""
    return sum(is_false(m, xi) for m, xi in zip(drive.closures, closure_errors(drive, drive.closures), strict=True))


def is_false(match: Match, xi: np.ndarray) -> bool:
    """Whether a match with an error ξ (3,) is elsewhere, and said to be sure."""
    values, vectors = np.linalg.eigh(match.covariance[:2, :2])
    off = np.abs(vectors.T @ xi[:2])[np.sqrt(values) < OBSERVED]
    large = math.hypot(*off) > FALSE[0] or abs(xi[2]) > FALSE[1]
    return bool(large and xi @ np.linalg.solve(match.covariance, xi) > CHI2)


def nees(xi: np.ndarray, covariance: np.ndarray) -> float:
    """Return the mean of ξᵀ P⁻¹ ξ."""
    return float(np.mean(np.einsum("ka,ka->k", xi, np.linalg.solve(covariance, xi[:, :, None])[:, :, 0])))


def nees_of_closures(drive: Drive) -> float:
    """Return the mean NEES of the closures that hold."""
    return nees(closure_errors(drive, drive.closures), np.array([m.covariance for m in drive.closures]))


def nees_of_poses(drive: Drive) -> float:
    """Return the mean NEES of the keyframes' final poses, in the frame of the first."""
    true = drive.true_keyframes
    xi = se2.difference(se2.between(drive.solved.poses[:1], drive.solved.poses), se2.between(true[:1], true))
    return nees(xi[1:], drive.marginals[1:])


def ate(poses: np.ndarray, truth: np.ndarray) -> float:
    """Return the root mean square of the position's error [m], aligned."""
    off = se2.compose(rigid_alignment(poses[:, :2], truth[:, :2]), poses)[:, :2] - truth[:, :2]
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def milliseconds(drive: Drive, low: float, high: float) -> float:
    """Return the mapper's mean processor time a keyframe [ms] between two parts of a drive, 0 to 1."""
    n = len(drive.took)
    stamps = np.array([k.stamp for k in drive.state.keyframes])
    first, last = drive.rows[int(low * n)].stamp, drive.rows[int(high * n) - 1].stamp
    keyframes = np.count_nonzero((stamps >= first) & (stamps <= last))
    return 1e3 * float(drive.took[int(low * n) : int(high * n)].sum()) / max(keyframes, 1)


def figures(drive: Drive) -> dict[str, float]:
    """Return what the benchmark prints of a drive."""
    batch, _ = mapper.on_map(drive.state.keyframes, drive.solved.poses, drive.marginals, drive.rows)
    accepted = len(drive.closures)
    return {
        "NEES closures": nees_of_closures(drive) if accepted else math.nan,
        "NEES poses": nees_of_poses(drive),
        "ATE batch m": ate(batch, drive.truth),
        "ATE driving m": ate(drive.driving, drive.truth),
        "ATE odometry m": ate(np.array([row.pose for row in drive.rows]), drive.truth),
        "accepted": accepted,
        "refused": len(drive.state.matches) - len(drive.state.accepted),
        "false": false_closures(drive),
        "keyframes": len(drive.state.keyframes),
        "ms a keyframe, second fifth": milliseconds(drive, 0.2, 0.4),
        "last fifth": milliseconds(drive, 0.8, 1.0),
        "s mapper": float(drive.took.sum()),
        "s refinement": drive.refinement,
    }


def bars_missed(rows: Sequence[dict[str, float]]) -> list[str]:
    """Return the bars that the means over a world's drives miss."""
    mean = {name: float(np.nanmean([row[name] for row in rows])) for name in rows[0]}
    missed = [name for name in ("NEES closures", "NEES poses") if not NEES[0] <= mean[name] <= NEES[1]]
    missed += [name for name, bar in (("ATE batch m", ATE_BATCH), ("ATE driving m", ATE_DRIVING)) if mean[name] > bar]
    return missed + ["false"] * (mean["false"] > 0)


def show(name: str, row: dict[str, float]) -> None:
    """Print a line of the table."""
    print(f"| {name} | " + " | ".join(f"{value:.4g}" for value in row.values()) + " |", flush=True)


def main() -> int:
    """Print a line a drive, and the means; 0 when all bars are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--length", type=float, default=300.0)
    parser.add_argument("--world", action="append")
    asked, missed, heads = parser.parse_args(), list[str](), False
    for world in asked.world or ["building", "storehouse"]:
        rows = []
        for seed in range(asked.first, asked.first + asked.seeds):
            rows.append(figures(mapped(drive_in(world, seed, asked.length))))
            if not heads:
                print("| drive | " + " | ".join(rows[0]) + " |\n" + "|---" * (len(rows[0]) + 1) + "|")
                heads = True
            show(f"{world} {seed}", rows[-1])
        show(f"**{world}, mean**", {name: float(np.nanmean([row[name] for row in rows])) for name in rows[0]})
        missed += [f"{world}: {name}" for name in bars_missed(rows)]
    print("\n" + (f"Missed: {', '.join(missed)}." if missed else "All bars are met."))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
