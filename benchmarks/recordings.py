"""The real recordings through the command line: errors beside their bars, time and memory of the whole process.

    python benchmarks/recordings.py [--data FOLDER] [--only NAME]

FOLDER (or LONGREACH_DATA) holds intel/, aces/, fr079/, csail/, brenner/ and polimi/. Checked are:

* Relations that span up to 5 s, mean errors: bars for the fused estimate and for LIDAR odometry alone. The bars of the
  LIDAR are what matching to single keyframes gave.
* The law: the fused estimate has at most 1.02 times the error of its best input, and 1 mm or 0.02° more.
* No such relation is off by more than 0.6 m or 12° in the fused estimate.
* The NIS of the LIDAR's matches against the prediction: 3 degrees of freedom, mean 2 to 4.5.
* Wall clock and memory of Intel and FR079 without relations, which is what a user runs: no LIDAR odometry alone.
* Intel with fixes of 5 cm, one every 5 s: RMSE and NEES of `localized`.

One core, kernels warm; exit code 1 when a bar is missed.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from longreach.evaluation.relations import relation_errors, up_to
from longreach.io.relations import read_relations
from longreach.io.trajectory_file import read_poses

SHORT_T, SHORT_R = "relations_5s_translation", "relations_5s_rotation"
SHARE, MARGIN_T, MARGIN_R = 1.02, 0.001, 0.02  # of the law [1, m, deg]
WORST_T, WORST_R = 0.6, 12.0  # of a relation [m, deg]
NIS = 2.0, 4.5
Metrics = Mapping[str, Mapping[str, Mapping]]


class Bars(NamedTuple):
    """Of a log with relations: fused and LIDAR alone, translation [m] and rotation [deg]; seconds [s], None: no bar."""

    fused: tuple[float, float]
    lidar: tuple[float, float]
    seconds: float | None = None


LOGS = {
    "intel": Bars((0.0130, 0.195), (0.0165, 0.197), 10.0),
    "aces": Bars((0.0350, 0.310), (0.0536, 0.322)),
    "fr079": Bars((0.0242, 0.375), (0.0275, 0.526), 6.0),
    "csail": Bars((0.0268, 0.330), (0.0422, 0.500)),
}
MEMORY = 800.0  # MB
FIXES = 0.10, 6.0  # RMSE [m] and NEES of Intel's `localized`
POLIMI = {"bag1": 0.102, "bag3": 0.210}  # ATE of the wheels [m] with nominal radii
BRENNER = 0.429, 0.156  # ATE of the wheels and of LIDAR odometry alone [m]


def on_one_core(verb: str, out: Path, *arguments: str) -> tuple[float, Any]:
    """Run a verb of `longreach` on one core; return its wall clock [s] and what the system says of its resources."""
    command = [sys.executable, "-m", "longreach", verb, *arguments, "--out", str(out)]
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    began = time.perf_counter()
    child = subprocess.Popen(command, env=os.environ | one, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(child.pid, {min(os.sched_getaffinity(0))})
    assert child.stderr is not None
    said = child.stderr.read().decode()
    _, status, usage = os.wait4(child.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(command)} failed:\n{said}")
    return time.perf_counter() - began, usage


def run(out: Path, *arguments: str) -> tuple[Metrics, float, float]:
    """Run `longreach estimate` on one core; return its metrics, wall clock [s] and peak memory [MB]."""
    seconds, usage = on_one_core("estimate", out, *arguments)
    return json.loads((out / "metrics.json").read_text(encoding="utf-8")), seconds, usage.ru_maxrss / 1e3


class Checks:
    """What was measured beside its bars, printed a line a figure; `missed` holds what was not met."""

    def __init__(self) -> None:
        """Start with no figure."""
        self.missed: list[str] = []

    def show(self, what: str, value: float, high: float, unit: str, low: float = float("-inf")) -> None:
        """Print a figure and whether it is between its bars."""
        met = low <= value <= high
        if not met:
            self.missed.append(what)
        bar = f"{high:<9.4g}" if low == float("-inf") else f"{low:g} to {high:g}"
        print(f"{what:58} {value:9.4f} {unit:4} bar {bar:9} {'met' if met else 'MISSED'}", flush=True)

    def law(self, name: str, metrics: Metrics, key: str, margin: float, unit: str) -> None:
        """Hold the fused estimate against the better one of its inputs."""
        best = min(metrics[source][key]["value"] for source in ("wheels", "lidar") if source in metrics)
        self.show(f"{name}, the law, {key}", metrics["fused"][key]["value"], SHARE * best + margin, unit)


def with_relations(checks: Checks, data: Path, out: Path, name: str, bars: Bars) -> None:
    """Check a log that has relations."""
    log = str(data / name / f"{name}.clf.bz2")
    relations = str(data / name / f"{name}.relations")
    metrics, _, _ = run(out / name, log, "--robot", name, "--relations", relations)
    for source, (t, r) in (("fused", bars.fused), ("lidar", bars.lidar)):
        found = metrics[source]
        checks.show(f"{name}, {source}, relations ≤ 5 s, translation", found[f"{SHORT_T}_mean"]["value"], t, "m")
        checks.show(f"{name}, {source}, relations ≤ 5 s, rotation", found[f"{SHORT_R}_mean"]["value"], r, "deg")
    checks.law(name, metrics, f"{SHORT_T}_mean", MARGIN_T, "m")
    checks.law(name, metrics, f"{SHORT_R}_mean", MARGIN_R, "deg")
    path, _ = read_poses(out / name / "fused.tum")
    short = up_to(relation_errors(path, *read_relations(Path(relations))), 5.0)
    checks.show(f"{name}, fused, largest translation error ≤ 5 s", short.translation.max(), WORST_T, "m")
    checks.show(f"{name}, fused, largest rotation error ≤ 5 s", np.degrees(short.rotation.max()), WORST_R, "deg")
    checks.show(f"{name}, NIS of the LIDAR, mean", metrics["fused"]["nis_lidar_mean"]["value"], NIS[1], "", NIS[0])
    if bars.seconds is not None:
        _, seconds, memory = run(out / f"{name}_alone", log, "--robot", name)
        checks.show(f"{name}, without relations, wall clock", seconds, bars.seconds, "s")
        checks.show(f"{name}, without relations, peak memory", memory, MEMORY, "MB")


def with_fixes(checks: Checks, data: Path, out: Path) -> None:
    """Check the Intel log with its corrected poses as fixes."""
    log, corrected = str(data / "intel" / "intel.clf.bz2"), str(data / "intel" / "intel-corrected.log.gz")
    fixes = ("--fixes", corrected, "--fix-sigma", "0.05", "--fix-period", "5", "--truth", corrected)
    metrics, _, _ = run(out / "fixes", log, "--robot", "intel", *fixes)
    localized = metrics["localized"]
    checks.show("intel with fixes, localized, position RMSE", localized["ate_rmse"]["value"], FIXES[0], "m")
    checks.show("intel with fixes, localized, NEES", localized["nees_mean"]["value"], FIXES[1], "")


def main() -> int:
    """Print a line a figure; 0 when all bars are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=os.environ.get("LONGREACH_DATA"))
    parser.add_argument("--only", default="", help="only recordings whose name has this in it")
    given = parser.parse_args()
    if given.data is None:
        print("give --data or LONGREACH_DATA")
        return 2
    data, checks = Path(given.data), Checks()
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        subprocess.run([sys.executable, "-m", "longreach", "warmup"], check=True, capture_output=True)
        for name, bars in LOGS.items():
            if given.only in name:
                with_relations(checks, data, out, name, bars)
        if given.only in "intel":
            with_fixes(checks, data, out)
        for bag, bar in POLIMI.items():
            if given.only in f"polimi {bag}":
                metrics, _, _ = run(out / bag, str(data / "polimi" / f"{bag}.bag"), "--robot", "polimi")
                checks.show(f"polimi {bag}, wheels, ATE", metrics["wheels"]["ate_rmse"]["value"], bar, "m")
                checks.law(f"polimi {bag}", metrics, "ate_rmse", MARGIN_T, "m")
        if given.only in "brenner":
            metrics, _, _ = run(out / "brenner", str(data / "brenner"), "--robot", "brenner")
            for source, bar in zip(("wheels", "lidar"), BRENNER, strict=True):
                checks.show(f"brenner, {source}, ATE", metrics[source]["ate_rmse"]["value"], bar, "m")
            checks.law("brenner", metrics, "ate_rmse", MARGIN_T, "m")
    return 1 if checks.missed else 0


if __name__ == "__main__":
    sys.exit(main())
