"""Is the fused estimate never worse than its best input? Real logs, four floors, four worlds, one sensor failing.

    python benchmarks/never_worse.py [--data FOLDER] [--seeds 3] [--first 1] [--duration 120] [--keep FOLDER]

Prints a table (markdown): errors of position and heading of the wheels, of LIDAR odometry alone, and of the fused
estimate. The law: the fused estimate has at most 1.02 times the error of the better input, and 1 mm or 0.02° more.

* Simulated drives: RMS over the run, from the true first pose on; the mean over the seeds, and in how many of them the
  law holds: against the wheels all along, against the LIDAR at its scans, for while it is blind it has no path. A
  failure lasts for 15 % of the time (the LIDAR sees nothing; all wheels turn 30 % too far) or begins at half the time
  (an offset of 0.05 rad/s in the gyro and of 0.3 m/s² in the accelerometer).
* Intel, ACES, FR079 and CSAIL: mean over the relations that span up to 5 s. Brenner: ATE.

FOLDER (or LONGREACH_DATA) holds intel/, aces/, fr079/, csail/ and brenner/; without it there are no real logs. --keep
holds the simulated recordings for the next time. Exit code 1 where the law is broken.
"""

import argparse
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from drives import kept_recording

from longreach.app.configuration import EstimateConfig, EvaluationConfig
from longreach.app.estimate import Estimate, estimate
from longreach.app.inputs import open_run
from longreach.evaluation.alignment import associate
from longreach.evaluation.metrics import ate
from longreach.evaluation.relations import summary
from longreach.io.robots import load_robot
from longreach.measurement import Recording, WheelTicks
from longreach.trajectory import PoseTrajectory

PLACES = (
    ("laboratory", "good"),
    ("laboratory", "worn"),
    ("laboratory", "wet"),
    ("laboratory", "slippery"),
    ("office", None),
    ("corridor", None),
    ("warehouse", None),
)
LOGS = {name: f"{name}/{name}.clf.bz2" for name in ("intel", "aces", "fr079", "csail")} | {"brenner": "brenner"}
IN_ONE_WORLD = EstimateConfig(evaluation=EvaluationConfig(align="none"))
Errors = Mapping[str, tuple[float, float]]  # name → position [m], heading [deg]


def _window(recording: Recording) -> tuple[float, float]:
    first, last = recording.scans[0].stamp, recording.scans[-1].stamp
    return first + 0.4 * (last - first), first + 0.55 * (last - first)


def blinded(recording: Recording) -> Recording:
    """Let the LIDAR see nothing for a while."""
    a, b = _window(recording)
    scans = [replace(s, ranges=np.zeros_like(s.ranges)) if a <= s.stamp < b else s for s in recording.scans]
    return recording.replace(scans=tuple(scans))


def slipping(recording: Recording) -> Recording:
    """Let all wheels turn 30 % too far for a while."""
    a, b = _window(recording)
    added, last, wheels = 0.0, None, []
    for record in recording.wheels:
        assert isinstance(record, WheelTicks)
        if last is not None and a <= record.stamp < b:
            added = added + 0.3 * (record.ticks - last)
        last = record.ticks
        wheels.append(replace(record, ticks=record.ticks + added))
    return recording.replace(wheels=tuple(wheels))


def biased(recording: Recording) -> Recording:
    """Let the IMU be off from half the time on."""
    half = 0.5 * (recording.imu[0].stamp + recording.imu[-1].stamp)
    turn, push = np.array([0.0, 0.0, 0.05]), np.array([0.3, 0.3, 0.0])
    imu = [
        replace(m, angular_velocity=m.angular_velocity + turn, acceleration=m.acceleration + push)
        if m.stamp >= half
        else m
        for m in recording.imu
    ]
    return recording.replace(imu=tuple(imu))


FAILURES: Mapping[str, Callable[[Recording], Recording]] = {
    "none": lambda recording: recording,
    "LIDAR blinded": blinded,
    "wheels slip 30 %": slipping,
    "IMU bias step": biased,
}


def against_truth(result: Estimate) -> Errors:
    """Return RMS errors of each path, and of the fused one at the scans: a LIDAR that is blind has no path."""
    found, paths = result.metrics, result.evaluation.trajectories
    errors = {
        name: (found[name]["ate_rmse"]["value"], found[name].get("heading_rms", {}).get("value", np.nan))
        for name in ("wheels", "lidar", "fused")
    }
    fused, truth = paths["fused"], paths.get("truth")
    if truth is not None and truth.has_heading:
        seen = np.isin(fused.stamps, paths["lidar"].stamps)
        config = result.evaluation.config
        pairs = associate(PoseTrajectory(fused.stamps[seen], fused.poses[seen]), truth, config.longest_gap)
        off = ate(pairs, config.align)
        assert off.heading is not None
        rms = [float(np.sqrt(np.mean(np.square(e)))) for e in (off.position, np.degrees(off.heading))]
        errors["fused at scans"] = rms[0], rms[1]
    return errors


def against_relations(result: Estimate) -> Errors:
    """Return mean errors over the relations of up to 5 s."""
    found = {}
    for name in ("wheels", "lidar", "fused"):
        s = summary(result.evaluation.relation_errors[name], 5.0)
        found[name] = s.translation.mean, float(np.degrees(s.rotation.mean))
    return found


def holds(errors: Errors) -> tuple[bool, bool]:
    """Whether the law holds in position and in heading; what is not known holds."""
    fused, at_scans = errors["fused"], errors.get("fused at scans", errors["fused"])
    pairs = (fused, errors["wheels"]), (at_scans, errors["lidar"])
    kept = [not any(a[i] > 1.02 * b[i] + margin for a, b in pairs) for i, margin in enumerate((0.001, 0.02))]
    return kept[0], kept[1]


def row(what: str, failure: str, runs: list[Errors], nees: list[float]) -> bool:
    """Print a line of the table."""
    mean = {name: np.mean([run[name] for run in runs], axis=0) for name in ("wheels", "lidar", "fused")}
    kept = np.array([holds(run) for run in runs])
    cells = [f"{1e3 * mean[name][0]:.1f} / {mean[name][1]:.3f}" for name in ("wheels", "lidar", "fused")]
    sure = f"{np.mean(nees):.1f}" if nees else ""
    counts = f"{kept[:, 0].sum()} / {kept[:, 1].sum()} of {len(runs)}"
    print(f"| {what} | {failure} | {' | '.join(cells)} | {sure} | {counts} |", flush=True)
    return bool(kept.all())


def logs(folder: Path, only: str) -> bool:
    """Print a line for each real log."""
    kept = True
    for name, file in LOGS.items():
        relations = folder / name / f"{name}.relations"
        known = relations if relations.is_file() else None
        if only not in name:
            continue
        run = open_run(folder / file, name, relations=known)
        result = estimate(run.recording, run.robot, run.config, truth=run.truth, relations=run.relations)
        errors = against_relations(result) if known else against_truth(result)
        kept &= row(name, "none", [errors], [])
    return kept


def main() -> int:
    """Print the table; 0 where the law holds everywhere."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=os.environ.get("LONGREACH_DATA"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--duration", type=float, default=120.0)
    parser.add_argument("--keep", type=Path, default=None)
    parser.add_argument("--only", default="", help="only rows whose name has this in it")
    asked = parser.parse_args()
    print("| where | failing | wheels mm / ° | LIDAR mm / ° | fused mm / ° | NEES | law holds: position / heading |")
    print("|---|---|---|---|---|---|---|")
    kept = logs(Path(asked.data), asked.only) if asked.data is not None else True
    robot = load_robot("thing")
    for world, floor in PLACES:
        name = world if floor is None else f"{world}, {floor} floor"
        if asked.only not in name:
            continue
        found: dict[str, tuple[list[Errors], list[float]]] = {failure: ([], []) for failure in FAILURES}
        for seed in range(asked.first, asked.first + asked.seeds):
            recording = kept_recording(asked.keep, world, floor, seed, asked.duration)
            for failure, fail in FAILURES.items():
                result = estimate(fail(recording), robot, IN_ONE_WORLD)
                found[failure][0].append(against_truth(result))
                found[failure][1].append(result.metrics["fused"]["nees_mean"]["value"])
        for failure, (runs, nees) in found.items():
            kept &= row(name, failure, runs, nees)
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
