"""Real logs made harder in ways that others are hard: does the map hold?

    python benchmarks/perturbed_logs.py [--data FOLDER] [--only NAME] [WAY ...]

FOLDER (or LONGREACH_DATA) holds intel/, aces/, fr079/ and csail/. Each log is written anew with one thing changed, and
mapped by the command line with the configuration of all. The relations stay what they are. The table shows the mean
errors of those that span more than 60 s, in the log as it is and in the changed one; a row is a miss where the error of
position is more than twice as large, and 2 cm more. Exit code 1 then.

Scans that are left out make headings worse by themselves: relations are between scans, and of one that is missing the
pose is interpolated.
"""

import argparse
import bz2
import json
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from recordings import on_one_core

from longreach.geometry import se2

LOGS = ("csail", "fr079", "aces", "intel")
FAR = 81.91  # [m] what a SICK says where nothing returns
PEOPLE, WIDTH = 3, (4, 12)  # passers-by in a scan, and how many beams each takes
FACTOR, MARGIN = 2.0, 0.02  # of a miss [1, m]


class Line(NamedTuple):
    """A FLASER line: ranges (n,) [m], pose (3,) of the base by its wheels, the laser's (3,) in the base, the rest."""

    ranges: np.ndarray
    pose: np.ndarray
    laser: np.ndarray
    rest: str


Change = Callable[[list[Line], np.random.Generator], list[Line]]


def read(path: Path) -> list[Line]:
    """Read the FLASER lines of a log."""
    lines = []
    with bz2.open(path, "rt") as file:
        for words in map(str.split, file):
            if words[:1] == ["FLASER"]:
                n = int(words[1])
                numbers = np.array(words[2 : n + 8], dtype=float)
                laser, pose = numbers[n : n + 3], numbers[n + 3 :]
                lines.append(Line(numbers[:n], pose, se2.between(pose, laser), " ".join(words[n + 8 :])))
    return lines


def write(path: Path, lines: list[Line]) -> None:
    """Write a log of FLASER lines."""
    with path.open("w", encoding="utf-8") as file:
        for line in lines:
            ranges = " ".join(f"{r:.2f}" for r in line.ranges)
            poses = " ".join(f"{v:.6f}" for v in (*se2.compose(line.pose, line.laser), *line.pose))
            file.write(f"FLASER {len(line.ranges)} {ranges} {poses} {line.rest}\n")


def by_ranges(change: Callable[[np.ndarray, np.random.Generator], np.ndarray]) -> Change:
    """Change the ranges of each scan."""
    return lambda lines, rng: [line._replace(ranges=change(line.ranges, rng)) for line in lines]


def by_motions(change: Callable[[np.ndarray, np.random.Generator], np.ndarray]) -> Change:
    """Change what the wheels say of each motion."""

    def changed(lines: list[Line], rng: np.random.Generator) -> list[Line]:
        made, pose = lines[:1], lines[0].pose
        for before, now in pairwise(lines):
            pose = se2.compose(pose, change(se2.between(before.pose, now.pose), rng))
            made.append(now._replace(pose=pose))
        return made

    return changed


def with_people(ranges: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Let some groups of beams end on passers-by, who stand elsewhere in each scan."""
    ranges = ranges.copy()
    for first in rng.integers(0, len(ranges) - WIDTH[1], PEOPLE):
        part = slice(first, first + rng.integers(*WIDTH))
        ranges[part] = rng.uniform(0.7, 3.0, len(ranges[part]))
    return ranges


def noisy(ranges: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Add 3 cm of noise to returns."""
    return np.where(ranges < FAR - 1.0, np.maximum(ranges + 0.03 * rng.standard_normal(len(ranges)), 0.02), ranges)


def with_noise(motion: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Let wheels scatter by 15 % of their way."""
    way, turn = np.hypot(*motion[:2]), np.array([0.0, 0.0, 0.1 * abs(motion[2])])
    return motion + (way * np.array([0.15, 0.05, 0.15]) + turn) * rng.standard_normal(3)


def with_slip(motion: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Let wheels be wrong by any amount up to 2.5 times, one step in a hundred."""
    if rng.uniform() > 0.01:
        return motion
    moves = float(np.hypot(*motion[:2]) > 0.02)
    return motion * rng.uniform(0.0, 2.5, 3) + moves * np.array([0.2, 0.0, 0.2]) * rng.standard_normal(3)


WAYS: Mapping[str, Change] = {
    "every second scan": lambda lines, rng: lines[::2],
    "half of the beams": by_ranges(lambda ranges, rng: ranges[::2]),
    "noise of 3 cm": by_ranges(noisy),
    "range of 8 m": by_ranges(lambda ranges, rng: np.where(ranges < 8.0, ranges, FAR)),
    "passers-by": by_ranges(with_people),
    "wheels 5 % and 10 % off": by_motions(
        lambda m, rng: np.array([1.05, 1.05, 1.1]) * m + np.array([0.0, 0.0, 0.03 * m[0]])
    ),
    "wheels scatter by 15 %": by_motions(with_noise),
    "wheels slip": by_motions(with_slip),
}


def errors(log: Path, relations: Path, name: str, out: Path) -> tuple[float, float]:
    """Map a log and return the mean errors [m, deg] of relations that span more than 60 s."""
    on_one_core("map", out, str(log), "--robot", name, "--relations", str(relations))
    mapped = json.loads((out / "metrics.json").read_text(encoding="utf-8"))["mapped"]
    position, heading = (mapped[f"relations_over_60s_{kind}_mean"]["value"] for kind in ("translation", "rotation"))
    return position, heading


def main() -> int:
    """Print the table; 1 where a row is a miss."""
    assert __doc__ is not None
    parser = argparse.ArgumentParser(
        description=__doc__.partition("\n")[0], formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("ways", nargs="*", metavar="WAY", help=f"of {', '.join(WAYS)}")
    parser.add_argument("--data", type=Path, default=os.environ.get("LONGREACH_DATA"))
    parser.add_argument("--only", default="", help="only logs whose name has this in it")
    asked = parser.parse_args()
    if asked.data is None or not set(asked.ways) <= WAYS.keys():
        parser.error("give --data, and ways that are listed")
    misses = 0
    print("| log | changed | over 60 s, as it is | changed |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as made:
        for name in [name for name in LOGS if asked.only in name]:
            folder, out = Path(asked.data) / name, Path(made)
            relations, lines = folder / f"{name}.relations", read(folder / f"{name}.clf.bz2")
            usual = errors(folder / f"{name}.clf.bz2", relations, name, out / name)
            for i, way in enumerate(asked.ways or WAYS):
                write(out / f"{name}-{i}.clf", WAYS[way](lines, np.random.default_rng(1)))
                found = errors(out / f"{name}-{i}.clf", relations, name, out / f"{name}-{i}")
                is_miss = found[0] > FACTOR * usual[0] and found[0] > usual[0] + MARGIN
                misses += is_miss
                pair = (f"{position:.3f} m, {heading:.2f}°" for position, heading in (usual, found))
                print(f"| {name} | {way} | {' | '.join(pair)} |{' MISS' if is_miss else ''}", flush=True)
    return int(misses > 0)


if __name__ == "__main__":
    sys.exit(main())
