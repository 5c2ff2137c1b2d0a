"""The real recordings through the command line: errors beside their bars, time and memory of the whole process.

    python benchmarks/recordings.py [--data FOLDER]

FOLDER (or LONGREACH_DATA) holds intel/, aces/, brenner/ and polimi/. Bars: wheels alone have 0.0220 m / 1.46° on
Intel's relations spanning up to 5 s, rf2o's C++ alone 0.0256 m / 0.262°; nominal wheels 0.102 m and 0.210 m ATE on
polimi's bags 1 and 3, 0.429 m on brenner. One core, kernels warm; exit code 1 when a bar is missed.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SHORT_T, SHORT_R = "relations_5s_translation_mean", "relations_5s_rotation_mean"


def run(out: Path, *arguments: str) -> tuple[dict, float, float]:
    """Run `longreach estimate` on one core; return its metrics, wall clock [s] and peak memory [MB]."""
    command = [sys.executable, "-m", "longreach", "estimate", *arguments, "--out", str(out)]
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
    seconds = time.perf_counter() - began
    return json.loads((out / "metrics.json").read_text(encoding="utf-8")), seconds, usage.ru_maxrss / 1e3


def main() -> int:
    """Print a line a figure; 0 when all bars are met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=os.environ.get("LONGREACH_DATA"))
    data = parser.parse_args().data
    if data is None:
        print("give --data or LONGREACH_DATA")
        return 2
    missed = []

    def show(what: str, value: float, bar: float, unit: str) -> None:
        met = value <= bar
        if not met:
            missed.append(what)
        print(f"{what:58} {value:9.4f} {unit:4} bar {bar:<8g} {'met' if met else 'MISSED'}", flush=True)

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        subprocess.run([sys.executable, "-m", "longreach", "warmup"], check=True, capture_output=True)
        for name, bars, lidar_bars in (
            ("intel", (0.0220, 0.262), (0.0256, 0.262)),
            ("aces", (0.0380, 0.36), (0.0491, 0.358)),
        ):
            log, corrected = str(data / name / f"{name}.clf.bz2"), str(data / name / f"{name}-corrected.log.gz")
            relations = str(data / name / f"{name}.relations")
            metrics, seconds, memory = run(out / name, log, "--robot", name, "--relations", relations)
            for source, (t, r) in (("fused", bars), ("lidar", lidar_bars)):
                show(f"{name}, {source}, relations ≤ 5 s, translation", metrics[source][SHORT_T]["value"], t, "m")
                show(f"{name}, {source}, relations ≤ 5 s, rotation", metrics[source][SHORT_R]["value"], r, "deg")
            if name == "intel":
                lidar = metrics["lidar"]
                show("intel, lidar, median translation", lidar[SHORT_T.replace("mean", "median")]["value"], 0.0133, "m")
                show("intel, lidar, median rotation", lidar[SHORT_R.replace("mean", "median")]["value"], 0.195, "deg")
                rows = [(out / name / f"{n}.tum").read_text().count("\n") - 1 for n in ("fused", "wheels", "lidar")]
                print(f"intel, rows of fused, wheels, lidar: {rows} (13631 scans)")
                show("intel, wall clock", seconds, 15.0, "s")
                show("intel, peak memory", memory, 800.0, "MB")
                fixes = ("--fixes", corrected, "--fix-period", "5", "--truth", corrected)
                metrics, _, _ = run(out / "fixes", log, "--robot", name, *fixes)
                show(
                    "intel with fixes of 5 cm at 0.2 Hz, position RMSE",
                    metrics["fused"]["ate_rmse"]["value"],
                    0.15,
                    "m",
                )
        for bag, bar in (("bag1", 0.102), ("bag3", 0.210)):
            metrics, _, _ = run(out / bag, str(data / "polimi" / f"{bag}.bag"), "--robot", "polimi")
            show(f"polimi {bag}, wheels, ATE", metrics["wheels"]["ate_rmse"]["value"], bar, "m")
        metrics, _, _ = run(out / "brenner", str(data / "brenner"), "--robot", "brenner")
        show("brenner, fused, ATE", metrics["fused"]["ate_rmse"]["value"], 0.429, "m")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
