"""Calibration by driving: Censi's tuples beside his own answers, each figure beside its bar.

    python benchmarks/calibration.py [--data FOLDER] [--drives N]

FOLDER (or LONGREACH_DATA) holds calibration/ (l90 and lstraight with their sub-sets) and polimi/. Checked are:

* Parameters of each run against his maximum likelihood, in units of the deviations that he states: 0.5 at most.
* The covariance that we state against the scatter of the three sub-sets of a run: Σ dᵀ Σ⁻¹ d over its 12 degrees of
  freedom, d from their mean, between 0.35 and 2.0. The same of his own covariance, by way of comparison.
* The wheels of both runs are the same: they agree within 3 deviations.
* Polimi's mecanum base with motion capture as the truth, calibrated on one bag: ATE of the wheels on the other one.
* Simulated drives of the Thing, 60 s, each wheel with a slip of 4 % that wanders within 3 s: NEES over its dimension
  between 0.7 and 1.3, ratios of radii within 0.1 %, k within 0.3 %, the laser within 3 mm and 0.1° (root mean squares).

Exit code 1 when a bar is missed.
"""

import argparse
import gzip
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from longreach.app.calibrate import calibrate
from longreach.app.configuration import EvaluationConfig
from longreach.app.evaluate import evaluate
from longreach.app.inputs import open_run
from longreach.calibration.observability import Calibrated, calibrate_motions
from longreach.calibration.wheels import Motions, wheel_model
from longreach.io.config import load_description
from longreach.odometry.dead_reckoning import integrate
from longreach.odometry.wheel import wheel_odometry
from longreach.robot.description import RobotDescription
from longreach.sim.kinematic import make_recording

RUNS = ("l90", "lstraight")
SIGMA, SCATTER, AGREE = 0.5, (0.35, 2.0), 3.0
POLIMI = {"bag1": 0.035, "bag3": 0.085}  # ATE of the wheels [m], calibrated on the other one
BARS = (0.1, 0.3, 3.0, 0.1)  # ratios of radii and k [%], laser [mm, deg]
K_REFUSED = {"bag1": (1.0, 1.0), "bag3": (0.0, 0.0)}
CART: dict[str, Any] = {"kind": "differential", "wheel_radius": 0.02, "track_width": 0.1}  # near enough to start


def read_tuples(path: Path) -> Motions:
    """Read a tuple file; a few lines hold two records."""
    with gzip.open(path, "rt", encoding="utf-8") as file:
        text, decoder, records, at = file.read().strip(), json.JSONDecoder(), [], 0
    while at < len(text):
        record, at = decoder.raw_decode(text, at)
        records.append((record["T"] * record["phi_l"], record["T"] * record["phi_r"], *record["sm"]))
        at += len(text[at:]) - len(text[at:].lstrip())
    rows = np.array(records)
    k = np.arange(len(rows))
    return Motions(rows[:, :2], np.column_stack((k, k + 1)), rows[:, 2:])


def stated_by_censi(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return his parameters and their covariance, radii in place of diameters."""
    said = json.loads(path.read_text(encoding="utf-8"))
    values = [said["l_diam"] / 2, said["r_diam"] / 2, said["axle"], said["l_x"], said["l_y"], said["l_theta"]]
    return np.array(values), np.array(said["covariance"])


def scatter(parts: list[Calibrated], covariances: list[np.ndarray]) -> float:
    """Return Σ dᵀ Σ⁻¹ d over its degrees of freedom."""
    values = np.array([part.values for part in parts])
    d = values - values.mean(axis=0)
    total = sum(float(e @ np.linalg.solve(P, e)) for e, P in zip(d, covariances, strict=True))
    return total / (d.size - d.shape[1])


def shown(what: str, value: float, low: float, high: float) -> bool:
    """Print a figure beside its bar; return whether it is met."""
    met = low <= value <= high
    bar = f"{low:g} to {high:g}" if low > 0.0 else f"at most {high:g}"
    print(f"{what:58} {value:8.3f}   {bar:14} {'' if met else 'MISSED'}")
    return met


def censi(folder: Path) -> bool:
    """Check his runs."""
    model = wheel_model(RobotDescription.model_validate({"name": "censi", "base": CART}))
    wheels, met = [], True
    for run in RUNS:
        whole = calibrate_motions(model, read_tuples(folder / f"{run}.tuple.gz"))
        parts = [calibrate_motions(model, read_tuples(folder / f"{run}_{i}.tuple.gz")) for i in range(3)]
        his, P = stated_by_censi(folder / f"{run}_results.json")
        sigma = np.sqrt(np.diag(whole.covariance))
        off = np.abs(whole.values - his) / np.sqrt(np.diag(P))
        for name, value, deviation, d in zip(whole.names, whole.values, sigma, off, strict=True):
            met &= shown(f"{run} {name} {value:.6f} ± {deviation:.6f}, off his by [his σ]", d, 0.0, SIGMA)
        met &= shown(f"{run} scatter of sub-sets", scatter(parts, [p.covariance for p in parts]), *SCATTER)
        print(f"{run + ' scatter of sub-sets by his covariance':58} {scatter(parts, [3.0 * P] * 3):8.3f}")
        wheels.append((whole.values[:3], whole.covariance[:3, :3]))
    d, P = wheels[0][0] - wheels[1][0], wheels[0][1] + wheels[1][1]
    for name, value in zip(model.names, np.abs(d) / np.sqrt(np.diag(P)), strict=True):
        met &= shown(f"{name} of both runs, apart by [σ]", value, 0.0, AGREE)
    print(f"{'all three, Mahalanobis distance (3 dof: 3.76 is 3 σ)':58} {np.sqrt(d @ np.linalg.solve(P, d)):8.3f}")
    return met


def polimi(folder: Path) -> bool:
    """Calibrate on one bag, judge by the other; bag 1 turns only within 12°, so k must be refused there."""
    runs = {name: open_run(folder / f"{name}.bag", "polimi") for name in POLIMI}
    met = True
    for name, other in (("bag1", "bag3"), ("bag3", "bag1")):
        found = calibrate(runs[name].recording, runs[name].robot, use_truth=True)
        judged = runs[other].recording
        path = integrate(
            wheel_odometry(judged.wheels, found.robot).measurements, [record.stamp for record in judged.wheels]
        )
        ate = evaluate({"wheels": path}, judged.truth, None, EvaluationConfig()).metrics["wheels"]["ate_rmse"]["value"]
        met &= shown(
            f"polimi calibrated on {name}: ATE of the wheels on {other} [m]", ate or np.inf, 0.0, POLIMI[other]
        )
        met &= shown(f"polimi {name}: k is refused", not found.parameters["k"].observable, *K_REFUSED[name])
    return met


def simulated(drives: int) -> bool:
    """Calibrate the Thing on drives of the simulator; its description is the truth."""
    thing, errors, nees = load_description("thing"), [], []
    for seed in range(200, 200 + drives):
        recording = make_recording(thing, seed=seed, duration=60.0, lidar_rate=10.0, beams=361)
        found = calibrate(recording, thing)
        e = np.array([p.value - p.nominal for p in found.parameters.values()])
        shown_of_it = np.array([p.observable for p in found.parameters.values()])
        P = found.covariance[np.ix_(shown_of_it, shown_of_it)]
        nees.append(e[shown_of_it] @ np.linalg.solve(P, e[shown_of_it]) / shown_of_it.sum())
        radii, k = e[:4] / thing.base.wheel_radius, e[4] / thing.base.lever
        ratio = np.abs(radii - radii.mean()).max()
        errors.append([100.0 * ratio, 100.0 * k, 1e3 * np.hypot(e[5], e[6]), np.degrees(e[7])])
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    met = shown(f"{drives} drives: NEES over its dimension", float(np.mean(nees)), 0.7, 1.3)
    print(f"{'its median':58} {np.median(nees):8.3f}")
    for what, value, bar in zip(("ratios of radii [%]", "k [%]", "laser [mm]", "laser [deg]"), rms, BARS, strict=True):
        met &= shown(f"{drives} drives: {what}", float(value), 0.0, bar)
    return met


def main() -> int:
    """Print everything; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=os.environ.get("LONGREACH_DATA"))
    parser.add_argument("--drives", type=int, default=8, help="simulated drives")
    arguments = parser.parse_args()
    data = arguments.data
    if data is None:
        parser.error("name the folder of recordings with --data or LONGREACH_DATA")
    results = [censi(Path(data) / "calibration"), polimi(Path(data) / "polimi"), simulated(arguments.drives)]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
