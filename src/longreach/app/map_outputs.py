"""What mapping leaves behind: trajectories, the map in three forms, closures, metrics, figures and one page."""

import csv
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from longreach.app.map import STATUSES, BuiltMap, numbered
from longreach.app.outputs import comparison_figures, write_trajectories
from longreach.app.results import Progress, write_results
from longreach.evaluation import map_figures
from longreach.evaluation.report import CAPTIONS
from longreach.io.config import to_yaml
from longreach.io.whole_files import whole_folder
from longreach.mapping import loop_closure
from longreach.mapping.g2o import write_g2o
from longreach.mapping.map_file import save_map
from longreach.mapping.occupancy import beams, render, write_map_server
from longreach.trajectory import PoseTrajectory

_CAPTIONS = {
    **CAPTIONS,
    "map": "The laser returns of all keyframes, and the optimised paths. Thin lines join keyframes of loop closures "
    "that were accepted, refused, wait for another one that agrees, or were withdrawn because others contradict them.",
    "closures": "How well closures fit the map as solved: χ² of what each measured against where its keyframes are. "
    "Accepted ones left of the expected line say that their covariance is too large, right of it that it is too small.",
    "uncertainty": "The optimised paths and how uncertain positions along them are, seen from the start of the map.",
    "spans": "Errors of relations by the time that they span: short ones show odometry, those over 60 s show whether "
    "loops were closed. One false closure hides in a mean, and shows in the 99th percentile.",
}


def write_map(built: BuiltMap, out: str | Path, progress: Progress | None = None) -> None:
    """Write what docs/outputs.md names for `longreach map` into a folder, which is made if it is not there."""
    tell = progress or (lambda stage, fraction: None)
    with whole_folder(Path(out)) as folder:
        tell("map", 0.0)
        write_trajectories(folder, built.trajectories)
        save_map(folder / "map.lrmap", built)
        write_map_server(folder / "map.pgm", render(built))
        write_g2o(folder / "graph.g2o", built.graph, built.weights)
        _write_closures(folder / "closures.csv", built)
        (folder / "robot.yaml").write_text(to_yaml(built.robot), encoding="utf-8")
        title = f"Map of {', '.join(session.name for session in built.sessions)}"
        config = to_yaml(built.config)
        write_results(
            folder, title, _introduction(built), built.metrics, _figures(built), config, tell, built.remarks, _CAPTIONS
        )


def _introduction(built: BuiltMap) -> str:
    counts = Counter(closure.status for part in built.parts for closure in part.closures)
    scans = sum(len(part.recording.scans) for part in built.parts)
    closures = ", ".join(f"{counts[status]} closures {status}" for status in STATUSES)
    return f"Robot {built.robot.name}: {scans} scans, {len(built.scans)} keyframes; {closures}."


def _write_closures(path: Path, built: BuiltMap) -> None:
    """Write a row a match: both stamps as recorded, relative pose, covariance, what became of it, and its evidence."""
    names = ("xx", "xy", "xt", "yy", "yt", "tt")
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        head = ["stamp_1", "stamp_2", "x", "y", "theta", *(f"covariance_{name}" for name in names)]
        evidence = loop_closure.Evidence._fields
        writer.writerow([*head, "status", "gate", "reason", *evidence, "recording", "chi2_solved"])
        for part in built.parts:
            for match, stamps, status, reason, chi2 in part.closures:
                numbers = [*match.pose.tolist(), *match.covariance[np.triu_indices(3)].tolist()]
                row = [*map(repr, stamps), *(f"{x:.9g}" for x in numbers), status, match.gate, reason]
                row += [f"{value:.4g}" for value in match.evidence]
                writer.writerow([*row, part.recording.name, f"{chi2:.4g}"])


def _figures(built: BuiltMap) -> dict[str, Callable[[], Figure]]:
    """Return how to draw the map, its closures, its uncertainty, and what compares its trajectories."""
    paths, points = _paths(built), _points(built)
    inside = [closure for part in built.parts if part.first is not None for closure in part.closures]
    ends = {s: np.array([(c.match.i, c.match.j) for c in inside if c.status == s], dtype=int) for s in STATUSES}
    lines = {status: built.graph.poses[rows.reshape(-1, 2), :2] for status, rows in ends.items()}
    chi2 = {s: np.array([c.chi2 for c in inside if c.status == s]) for s in ("accepted", "withdrawn")}
    drawn: dict[str, Callable[[], Figure]] = {"map": lambda: map_figures.closure_map(points, paths, lines)}
    if len(chi2["accepted"]):
        drawn["closures"] = lambda: map_figures.closure_residuals(chi2, loop_closure.CHI2)
    drawn["uncertainty"] = lambda: map_figures.uncertainty_map(points, paths)
    for k, part in enumerate(built.parts):
        end = f"_{k + 1}" if k else ""
        e = numbered(part.evaluation, k) if k else part.evaluation
        if e.relation_errors:
            drawn[f"spans{end}"] = lambda e=e: map_figures.errors_by_span(e.relation_errors)
        drawn |= {f"{name}{end}": draw for name, draw in comparison_figures(part.evaluation).items()}
    return drawn


def _paths(built: BuiltMap) -> dict[str, PoseTrajectory]:
    """Return the optimised paths of the new sessions after the keyframes of those that were there before."""
    new = {name: path for name, path in built.trajectories.items() if name.startswith("mapped")}
    firsts = [part.first for part in built.parts if part.first is not None]
    before = min(firsts, default=len(built.scans))
    old = {}
    for number in np.unique(built.session[:before]).tolist():
        rows = built.session == number
        stamps = built.stamps[rows]
        old[built.sessions[number].name] = PoseTrajectory(stamps, built.graph.poses[rows], clock=stamps)
    return old | new


def _points(built: BuiltMap) -> np.ndarray:
    """Return where the returns of all keyframes lie on the map (n, 2) [m]."""
    found = []
    for k, scan in enumerate(built.scans):
        mount = built.sessions[int(built.session[k])].mounts[scan.frame]
        _, ends, hit = beams(scan, mount, built.graph.poses[k], built.twists[k])
        found.append(ends[hit])
    return np.concatenate(found)
