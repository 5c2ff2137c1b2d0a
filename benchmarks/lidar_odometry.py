"""LIDAR odometry against a local map: accuracy, consistency and time on made scans with exact truth, beside the bars.

    python benchmarks/lidar_odometry.py --bench FOLDER [--seeds N] [--sets NAME ...] [--all] [--method METHOD]

FOLDER holds scan_sim.py, which makes the scans: 60 s each, 270°. ATE: RMSE of the positions after the best rigid
alignment; yaw: RMS of the heading after the same (still: without, as one place tells no rotation). Both are medians
over the seeds. NEES: of each match's pose relative to the newest keyframe, 3 numbers, mean over all seeds (ideal 3).
Time: processor time a scan, the least of the repeats. Beside it range flow (2016) in the same run. Exit code 1: a bar
missed.
"""

import argparse
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, get_args

import numpy as np

from longreach.evaluation.alignment import rigid_alignment
from longreach.geometry import se2
from longreach.measurement import LaserScan, RelativePoseMeasurement
from longreach.odometry import lidar
from longreach.odometry.dead_reckoning import integrate
from longreach.odometry.lidar import LidarConfig, Method
from longreach.odometry.matchers import range_flow
from longreach.trajectory import PoseTrajectory

Matches = list[RelativePoseMeasurement]
REPEATS = 3
TIME_BARS = {360: 0.15, 1081: 0.40}  # ms, covariance included
COVERED = 0.99  # share of scans within 3 σ along the corridor (a normal error: 0.997)
ACROSS, YAW = 0.02, 0.2  # m and ° in the corridor


class Set(NamedTuple):
    """What scan_sim.py is asked for, and the bars: ATE [m] and yaw rms [°]; NaN: none."""

    kind: str
    beams: int
    rate: int = 40
    noise: float = 0.01
    ate: float = math.nan
    yaw: float = math.nan


SETS = {
    "fast": Set("fast", 1081, ate=0.0025, yaw=0.04),
    "slow": Set("slow", 1081, ate=0.0030, yaw=0.02),
    "slow360": Set("slow", 360, ate=0.0045, yaw=0.03),
    "fast360": Set("fast", 360, ate=0.010, yaw=0.06),
    "fast30mm": Set("fast", 1081, noise=0.03, ate=0.011, yaw=0.10),
    "still": Set("still", 1081, ate=0.001, yaw=0.01),
    "corridor": Set("corr", 1081),
}
MORE = {"fast10hz": Set("fast", 1081, 10), "slow10hz": Set("slow", 1081, 10)}  # bars for NEES and time only


def made(simulator: Path, s: Set, seed: int) -> tuple[list[LaserScan], np.ndarray, np.ndarray]:
    """Return the scans of a set, the laser's mount (4, 4), and the true poses (n, 3)."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "scans"
        command = [sys.executable, simulator, out, s.beams, 270, s.rate, 60, s.kind, s.noise, seed]
        subprocess.run([str(word) for word in command], check=True, stdout=subprocess.DEVNULL)
        data, truth = out.with_suffix(".bin").read_bytes(), np.load(f"{out}_gt.npy")
    head = np.frombuffer(data, count=8)
    rows = np.frombuffer(data, np.dtype([("stamp", "f8"), ("ranges", "f4", (s.beams,))]), offset=64)
    x, y, c, sn = head[5], head[6], math.cos(head[7]), math.sin(head[7])
    T = np.array([[c, -sn, 0, x], [sn, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])
    step = float(head[3] - head[2]) / (s.beams - 1)
    low, far = float(head[2]), float(head[4])
    scans = [LaserScan(float(stamp), ranges.astype(float), low, step, range_max=far) for stamp, ranges in rows]
    return scans, T, truth[:, 1:4].copy()


def run(odometry: Callable, scans: list[LaserScan], T: np.ndarray) -> tuple[Matches, PoseTrajectory, float]:
    """Return the measurements, their dead reckoning, and the processor time a scan [ms], the least of the repeats."""
    matches, best = odometry(scans[:20], T), math.inf
    for _ in range(REPEATS):
        began = time.process_time()
        matches = odometry(scans, T)
        best = min(best, time.process_time() - began)
    found = [m.measurement for m in matches if m.measurement]
    return found, integrate(found, [scan.stamp for scan in scans]), 1e3 * best / len(scans)


def errors(poses: np.ndarray, truth: np.ndarray, still: bool) -> tuple[float, float]:
    """Return ATE [m] and yaw rms [°]."""
    motion = rigid_alignment(poses[:, :2], truth[:, :2])
    off = se2.compose(motion, poses) - truth
    heading = poses[:, 2] - truth[:, 2] + (0.0 if still else motion[2])
    heading = np.remainder(heading + np.pi, 2 * np.pi) - np.pi
    return float(np.sqrt((off[:, :2] ** 2).sum(1).mean())), math.degrees(rms(heading))


def rms(e: np.ndarray) -> float:
    return float(np.sqrt(np.mean(e**2)))


def nees(found: Matches, scans: list[LaserScan], truth: np.ndarray) -> np.ndarray:
    """Return the normalised squared error of each match against its keyframe."""
    row = {scan.stamp: i for i, scan in enumerate(scans)}
    real = se2.between(truth[[row[m.stamp_reference] for m in found]], truth[[row[m.stamp] for m in found]])
    xi = se2.log(se2.between(np.array([m.pose for m in found]), real))
    R = np.array([m.covariance for m in found])
    return np.einsum("ni,ni->n", xi, np.linalg.solve(R, xi[..., None])[..., 0])


def corridor(p: PoseTrajectory, truth: np.ndarray) -> tuple[float, float, float, float]:
    """Return the share within 3 σ along, σ/RMS along, RMS across [m] and of yaw [°]; the corridor runs along x."""
    assert p.covariance is not None
    off = (p.poses - truth)[1:]
    along = np.stack([np.cos(p.poses[1:, 2]), -np.sin(p.poses[1:, 2])], axis=1)
    sigma = np.sqrt(np.einsum("ni,nij,nj->n", along, p.covariance[1:, :2, :2], along))
    return (
        float(np.mean(np.abs(off[:, 0]) <= 3 * sigma)),
        rms(sigma) / rms(off[:, 0]),
        rms(off[:, 1]),
        math.degrees(rms(off[:, 2])),
    )


def measure(simulator: Path, name: str, s: Set, seeds: int, config: LidarConfig) -> bool:
    """Print a set's lines; return whether all its bars are met."""
    runs, squares, lost = [], [], 0
    for seed in range(1, seeds + 1):
        scans, T, truth = made(simulator, s, seed)
        found, p, took = run(lambda some, at: lidar.lidar_odometry(some, at, config), scans, T)
        _, other, took_other = run(range_flow.lidar_odometry, scans, T)
        flow = errors(other.poses, truth, s.kind == "still")[0]
        runs.append((took, took_other, flow, *errors(p.poses, truth, s.kind == "still"), *corridor(p, truth)))
        squares.append(nees(found, scans, truth))
        lost += len(scans) - 1 - len(found)
    _, _, flow, ate, yaw, share, ratio, across, turned = np.median(runs, axis=0)
    took, took_other = np.min(runs, axis=0)[:2]
    consistency, corr = float(np.concatenate(squares).mean()), s.kind == "corr"
    checks = [("ATE m", ate, 0, s.ate), ("yaw deg", yaw, 0, s.yaw), ("NEES", consistency, 2, 4)]
    if corr:
        checks = [("in 3 sigma", share, COVERED, 1), ("across m", across, 0, ACROSS), ("yaw deg", turned, 0, YAW)]
    checks.append(("ms a scan", took, 0, TIME_BARS[s.beams]))
    good = [low <= value <= high or math.isnan(high) for _, value, low, high in checks]
    for met, (what, value, low, high) in zip(good, checks, strict=True):
        bar = "no bar" if math.isnan(high) else f"bar {low:g} to {high:<8g} {'met' if met else 'MISSED'}"
        print(f"{name:9s} {what:12s} {value:9.4f}   {bar}")
    extra = f"; sigma/RMS along {ratio:.2f}, ATE {ate:.3f} m, NEES {consistency:.2f}" if corr else ""
    print(f"{name:9s} range flow: ATE {flow:.4f} m ({flow / ate:.1f} x ours), {took_other:.3f} ms", end="")
    print(f" ({took_other / took:.2f} x ours); scans without a match: {lost}{extra}", flush=True)
    return all(good)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bench", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--sets", nargs="+", choices=[*SETS, *MORE])
    parser.add_argument("--all", action="store_true", help="the sets at 10 Hz, too")
    parser.add_argument("--method", default=LidarConfig().method, choices=get_args(Method))
    given = parser.parse_args()
    config = LidarConfig(method=given.method)
    known = SETS | MORE
    names = given.sets or (known if given.all else SETS)
    sys.exit(not all([measure(given.bench / "scan_sim.py", name, known[name], given.seeds, config) for name in names]))


if __name__ == "__main__":
    main()
