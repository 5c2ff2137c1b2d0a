"""Mapping of the real logs with relations, through the command line: errors, closures and time beside their bars.

    python benchmarks/mapping.py [--data FOLDER] [--only NAME]

FOLDER (or LONGREACH_DATA) holds intel/, aces/, fr079/ and csail/. One configuration for all logs. Checked are:

* Relations, mean errors of all, and of those that span more than 60 s, and the 99th percentile of all; the localizer's
  own path (`fused`) beside it, and relations up to 5 s, without bars.
* False closures: accepted, outside 99.9 % of its own covariance plus the reference's, and off by more than 0.3 m or 3°
  in directions that it observes. The reference is the graph of odometry and relations, without closures; it judges
  where both ends are within 2 m of path of a relation's stamp.
* Wall clock of the whole process without relations, which is what a user runs, and its processor time, which a busy
  machine changes less. One core, kernels warm.

Exit code 1 when a bar is missed.
"""

import argparse
import csv
import json
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from recordings import Checks, on_one_core

from longreach.geometry import se2
from longreach.io.relations import read_relations
from longreach.io.trajectory_file import read_poses
from longreach.mapping.loop_closure import CHI2
from longreach.mapping.map_file import load_map
from longreach.mapping.pose_graph import Edges, PoseGraph
from longreach.mapping.solver import optimize, relative_covariances


class Bars(NamedTuple):
    """All relations; those over 60 s; the 99th percentile [m, deg]; whole log on one core [s]."""

    all: tuple[float, float]
    long: tuple[float, float]
    p99: tuple[float, float]
    seconds: float


LOGS = {
    "csail": Bars((0.0290, 0.345), (0.0460, 0.41), (0.135, 1.45), 15.0),
    "fr079": Bars((0.0315, 0.44), (0.0430, 0.50), (0.125, 2.5), 20.0),
    "aces": Bars((0.0358, 0.32), (0.0460, 0.47), (0.17, 1.40), 20.0),
    "intel": Bars((0.0148, 0.23), (0.0172, 0.28), (0.060, 1.05), 40.0),
}
RELATION = np.diag([0.03**2, 0.03**2, math.radians(0.4) ** 2])  # covariance of relations: their floors and more
DRIFT = np.diag([0.01**2, 0.01**2, math.radians(0.2) ** 2])  # of odometry in the reference, a metre
NEAR = 2.0  # [m] of path from a relation's stamp, where the reference judges
FALSE = 0.3, math.radians(3.0)  # [m, rad]
OBSERVED = 0.1  # [m]: a direction with a larger deviation is not observed


def run(out: Path, *arguments: str) -> tuple[float, float]:
    """Run `longreach map` on one core; return its wall clock and processor time [s]."""
    seconds, usage = on_one_core("map", out, *arguments)
    return seconds, usage.ru_utime + usage.ru_stime


class Reference:
    """Keyframes held together by odometry and verified relations alone."""

    def __init__(self, out: Path, relations: Path) -> None:
        """Solve it; `near` (n,) says of which keyframes it can judge."""
        (fused, _), self.stamps = read_poses(out / "fused.tum"), load_map(out / "map.lrmap").stamps
        first, second, poses = read_relations(relations)
        odom, _ = fused.at(self.stamps)
        way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(odom[:, :2], axis=0).T))])
        n, step = len(odom), np.maximum(np.diff(way), 0.05)[:, None, None]
        odometry = Edges(np.arange(n - 1), np.arange(1, n), se2.between(odom[:-1], odom[1:]), step * DRIFT)
        clocks = fused.clock_at(first), fused.clock_at(second)
        ends = [np.clip(np.searchsorted(self.stamps, clock, side="right") - 1, 0, n - 1) for clock in clocks]
        a, b = (se2.between(odom[end], fused.at(clock)[0]) for end, clock in zip(ends, clocks, strict=True))
        apart = ends[0] != ends[1]
        z = se2.compose(se2.compose(a, poses), se2.inverse(b))[apart]
        i, j = ends[0][apart], ends[1][apart]
        self.solved = optimize(PoseGraph(odom, odometry, Edges(i, j, z, np.stack([RELATION] * len(z)))))
        at = np.interp(np.concatenate(clocks), self.stamps, way)
        self.near = np.array([np.min(np.abs(at - w)) < NEAR for w in way])

    def judge(self, out: Path) -> tuple[int, int, int]:
        """Return how many closures were accepted, how many of them it can judge, and how many of these are false."""
        with (out / "closures.csv").open(encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if row["status"] == "accepted"]
        judged = false = 0
        order = {f"{stamp:.6f}": k for k, stamp in enumerate(self.recorded(out))}
        for row in rows:
            i, j = (order[f"{float(row[name]):.6f}"] for name in ("stamp_1", "stamp_2"))
            if not (self.near[i] and self.near[j]):
                continue
            judged += 1
            upper = [float(row[f"covariance_{name}"]) for name in ("xx", "xy", "xt", "yy", "yt", "tt")]
            S = np.zeros((3, 3))
            S[np.triu_indices(3)] = upper
            S = S + np.triu(S, 1).T
            z = np.array([float(row[name]) for name in ("x", "y", "theta")])
            xi = se2.difference(z, se2.between(self.solved.poses[i], self.solved.poses[j]))
            P = S + relative_covariances(self.solved, np.array([i]), np.array([j]))[0]
            values, vectors = np.linalg.eigh(S[:2, :2])
            off = np.abs(vectors.T @ xi[:2])[np.sqrt(values) < OBSERVED]
            large = math.hypot(*off) > FALSE[0] or abs(xi[2]) > FALSE[1]
            false += bool(large and xi @ np.linalg.solve(P, xi) > CHI2)
        return len(rows), judged, false

    def recorded(self, out: Path) -> np.ndarray:
        """Return the keyframes' stamps as recorded."""
        path, _ = read_poses(out / "mapped.tum")
        return path.stamps[np.argmin(np.abs(path.clock[None] - self.stamps[:, None]), axis=1)]


def check(checks: Checks, data: Path, out: Path, name: str, bars: Bars) -> None:
    """Check one log."""
    log, relations = str(data / name / f"{name}.clf.bz2"), data / name / f"{name}.relations"
    seconds, processor = run(out / "alone", log, "--robot", name)
    run(out / name, log, "--robot", name, "--relations", str(relations))
    metrics = json.loads((out / name / "metrics.json").read_text(encoding="utf-8"))
    groups = (("", "_mean", bars.all), ("over_60s_", "_mean", bars.long), ("", "_p99", bars.p99))
    for kind, ending, bar in groups:
        for what, high, unit in zip(("translation", "rotation"), bar, ("m", "deg"), strict=True):
            key = f"relations_{kind}{what}{ending}"
            checks.show(f"{name}, mapped, {key}", metrics["mapped"][key]["value"], high, unit)
    for source in ("mapped", "fused"):
        found = (f"{metrics[source][f'relations_{k}_mean']['value']:.4f}" for k in ("5s_translation", "5s_rotation"))
        print(f"{name}, {source}, relations up to 5 s: {' m, '.join(found)} deg")
    accepted, judged, false = Reference(out / name, relations).judge(out / name)
    counts = {key: found["value"] for key, found in metrics["map"].items()}
    print(f"{name}: {counts}; of {accepted} accepted closures {judged} can be judged")
    checks.show(f"{name}, false closures", false, 0, "")
    checks.show(f"{name}, without relations, wall clock", seconds, bars.seconds, "s")
    print(f"{name}, without relations, processor time: {processor:.1f} s")


def main() -> int:
    """Print a line a figure; 0 when all bars are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=os.environ.get("LONGREACH_DATA"))
    parser.add_argument("--only", default="", help="only logs whose name has this in it")
    given = parser.parse_args()
    if given.data is None:
        print("give --data or LONGREACH_DATA")
        return 2
    checks = Checks()
    subprocess.run([sys.executable, "-m", "longreach", "warmup"], check=True, capture_output=True)
    for name, bars in LOGS.items():
        if given.only in name:
            with tempfile.TemporaryDirectory() as folder:
                check(checks, Path(given.data), Path(folder), name, bars)
    return 1 if checks.missed else 0


if __name__ == "__main__":
    sys.exit(main())
