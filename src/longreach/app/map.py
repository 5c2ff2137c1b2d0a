"""Mapping: a recording in, a map and an optimised trajectory out. `build_map` reads like a paper's method section."""

import csv
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from longreach.app.configuration import EstimateConfig
from longreach.app.estimate import localized, sensor_mount
from longreach.app.evaluate import Evaluation, Metrics, Progress, Relations, evaluate
from longreach.app.outputs import comparison_figures, write_trajectories
from longreach.app.results import write_results
from longreach.errors import MappingError
from longreach.evaluation import scan_map, style
from longreach.evaluation.relations import long_relation_metrics
from longreach.evaluation.report import CAPTIONS
from longreach.evaluation.tables import metric
from longreach.io.config import to_yaml
from longreach.io.whole_files import whole_folder
from longreach.localization.config import filter_for
from longreach.mapping import loop_closure, mapper, solver
from longreach.mapping.g2o import write_g2o
from longreach.mapping.loop_closure import Match
from longreach.mapping.map_file import Map, Session, save_map
from longreach.mapping.mapper import MapperState, PathRow
from longreach.mapping.occupancy import render, write_map_server
from longreach.mapping.refinement import refined
from longreach.measurement import Recording
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator, description_of
from longreach.trajectory import PoseTrajectory

_BLOCK = 500  # scans between two reports of progress
_CAPTIONS = {
    **CAPTIONS,
    "map": "Every laser return, laid along the optimised path. Lines join the keyframes of closures that were taken, "
    "refused, or wait for another that agrees.",
}
_STATUS = {"accepted": style.GREEN, "refused": style.PURPLE, "waiting": style.ORANGE, "withdrawn": style.BLACK}


class Closure(NamedTuple):
    """A match to a place of before, what became of it, and why: accepted, refused, waiting or withdrawn."""

    match: Match
    status: str
    reason: str


@dataclass(frozen=True, eq=False)
class Mapped:
    """What mapping gives: the map, the closures that were tried, and trajectories with what they are worth.

    trajectories: `mapped` at every scan stamp, and `fused`, the localizer's own path, for comparison.
    """

    recording: Recording
    robot: RobotDescription
    config: EstimateConfig
    map: Map
    closures: tuple[Closure, ...]
    evaluation: Evaluation

    @property
    def metrics(self) -> Metrics:
        """How good each trajectory is, and `map`: how many keyframes and closures there are."""
        return self.evaluation.metrics


def build_map(
    recording: Recording,
    robot: RobotDescription | MobileManipulator,
    config: EstimateConfig | None = None,
    *,
    truth: PoseTrajectory | None = None,
    relations: Relations | None = None,
    progress: Progress | None = None,
) -> Mapped:
    """Map where a recording went; the map begins at the identity.

    Arguments: as of `estimate`.

    Raises:
        MappingError: there are fewer than two scans. EstimationError: a source that was asked for is not there.
    """
    robot, config = description_of(robot), config or EstimateConfig()
    config = config.model_copy(update={"filter": filter_for(config, robot)})
    tell = progress or (lambda stage, fraction: None)
    if len(recording.scans) < 2:
        raise MappingError(f"{recording.name} has {len(recording.scans)} scans; a map takes a LIDAR's, two at least.")

    done = localized(recording, robot, config, tell)
    recording, laser = done.recording, sensor_mount(done.recording, robot, "lidar")
    scans = recording.scans
    stamps = {scan.stamp for scan in scans}
    rows = [PathRow(*row) for row in done.output.rows if row.stamp in stamps]
    state = mapper.init(laser)
    for i in range(0, len(rows), _BLOCK):
        tell("loop closure", i / len(rows))
        low, high = rows[i].stamp, rows[min(i + _BLOCK, len(rows)) - 1].stamp
        state = mapper.step(state, [s for s in scans if low <= s.stamp <= high], rows[i : i + _BLOCK])
    state = mapper.settled(state)
    held = [a for a in state.accepted if a not in state.withdrawn]
    edges = mapper.closure_edges([state.matches[a] for a in held])
    found = refined(state.keyframes, state.poses, edges, lambda fraction: tell("refinement", fraction))
    weights = found.solved.weights
    accepted = {a for a, weight in zip(held, weights, strict=False) if weight > 0.5}  # they come first

    tell("evaluation", 0.0)
    poses, covariances = mapper.on_map(state.keyframes, found.solved.poses, found.marginals, rows)
    clock = np.array([row.stamp for row in rows])
    recorded, fused = recording.as_recorded(clock), np.array([row.pose for row in rows])
    trajectories = {
        "mapped": PoseTrajectory(recorded, poses, covariances, clock),
        "fused": PoseTrajectory(recorded, fused, np.array([row.covariance for row in rows]), clock),
    }
    evaluation = evaluate(trajectories, truth if truth is not None else recording.truth, relations, config.evaluation)
    closures = _closures(state, accepted)
    evaluation = replace(
        evaluation,
        metrics=_with_counts(evaluation, state, closures),
        remarks=(*recording.remarks, *done.remarks, *evaluation.remarks, *_remarks(closures)),
    )
    value = _map_of(recording, robot, laser, state, found.solved)
    return Mapped(recording, robot, config, value, closures, evaluation)


def _map_of(
    recording: Recording, robot: RobotDescription, laser: np.ndarray, state: MapperState, solved: solver.Solved
) -> Map:
    frames = {k.scan.frame for k in state.keyframes}
    session = Session(recording.name, robot.name, {frame: laser for frame in frames}, robot.model_dump(mode="json"))
    n = len(state.keyframes)
    scans, twists = tuple(k.scan for k in state.keyframes), np.array([k.twist for k in state.keyframes])
    return Map(solved.graph, solved.weights, scans, twists, np.zeros(n, dtype=int), (session,))


def _closures(state: MapperState, accepted: set[int]) -> tuple[Closure, ...]:
    """Return what became of each match; accepted: those that have weight in the end."""
    found = []
    for a, match in enumerate(state.matches):
        if a in accepted:
            found.append(Closure(match, "accepted", ""))
        elif a in state.accepted:
            found.append(Closure(match, "withdrawn", "Other closures contradict it."))
        elif match.gate:
            found.append(Closure(match, "refused", loop_closure.reason_of(match)))
        else:
            found.append(Closure(match, "waiting", "No other closure near by agrees with it."))
    return tuple(found)


def _with_counts(evaluation: Evaluation, state: MapperState, closures: tuple[Closure, ...]) -> Metrics:
    """Add errors of long relations to the metrics, and how many keyframes and closures there are."""
    found = {name: dict(one) for name, one in evaluation.metrics.items()}
    for name, errors in evaluation.relation_errors.items():
        found[name] |= long_relation_metrics(errors)
    counts = Counter(c.status for c in closures)
    found["map"] = {"keyframes": metric(len(state.keyframes), "")}
    found["map"] |= {f"closures_{status}": metric(counts[status], "") for status in _STATUS}
    return found


def _remarks(closures: tuple[Closure, ...]) -> list[str]:
    if not any(c.status == "accepted" for c in closures):
        return ["No loop was closed: the map is only as good as odometry."]
    return []


def write_map(mapped: Mapped, out: Path, progress: Progress | None = None) -> None:
    """Write trajectories, the map in its three forms, closures, metrics, figures and a page, whole or not at all."""
    tell = progress or (lambda stage, fraction: None)
    e = mapped.evaluation
    with whole_folder(out) as folder:
        tell("map", 0.0)
        write_trajectories(folder, e.trajectories)
        save_map(folder / "map.lrmap", mapped.map)
        write_map_server(folder / "map.pgm", render(mapped.map))
        write_g2o(folder / "graph.g2o", mapped.map.graph, mapped.map.weights)
        _write_closures(folder / "closures.csv", mapped)
        (folder / "robot.yaml").write_text(to_yaml(mapped.robot), encoding="utf-8")
        drawn = {"map": lambda: _map_figure(mapped)} | comparison_figures(e)
        counts = Counter(c.status for c in mapped.closures)
        introduction = (
            f"Robot {mapped.robot.name}: {len(mapped.recording.scans)} scans, {len(mapped.map.scans)} keyframes; "
            + ", ".join(f"{counts[status]} closures {status}" for status in _STATUS)
            + "."
        )
        config = to_yaml(mapped.config)
        write_results(
            folder,
            f"Map of {mapped.recording.name}",
            introduction,
            e.metrics,
            drawn,
            config,
            tell,
            e.remarks,
            _CAPTIONS,
        )


def _write_closures(path: Path, mapped: Mapped) -> None:
    """Write a row a match: both stamps as recorded, relative pose, covariance, what became of it, and its evidence."""
    stamps = mapped.recording.as_recorded(mapped.map.stamps)
    names = ("xx", "xy", "xt", "yy", "yt", "tt")
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        head = ["stamp_1", "stamp_2", "x", "y", "theta", *(f"covariance_{name}" for name in names)]
        writer.writerow([*head, "status", "gate", "reason", *loop_closure.Evidence._fields])
        for match, status, reason in mapped.closures:
            numbers = [*match.pose.tolist(), *match.covariance[np.triu_indices(3)].tolist()]
            ends = [repr(float(stamps[end])) for end in (match.i, match.j)]
            evidence = [f"{value:.4g}" for value in match.evidence]
            writer.writerow([*ends, *(f"{x:.9g}" for x in numbers), status, match.gate, reason, *evidence])


def _map_figure(mapped: Mapped) -> Figure:
    """Draw the returns along the optimised path, and lines between the keyframes of closures."""
    path = mapped.evaluation.trajectories["mapped"]
    on_clock = replace(path, stamps=path.clock)
    points = scan_map.scan_points(on_clock, mapped.map.scans, sensor_mount(mapped.recording, mapped.robot, "lidar"))
    fig = scan_map.scan_map(path, points, name="mapped")
    axes, at = fig.axes[0], mapped.map.graph.poses[:, :2]
    for status, colour in _STATUS.items():
        ends = np.array([(c.match.i, c.match.j) for c in mapped.closures if c.status == status]).reshape(-1, 2)
        if len(ends):
            lines = np.concatenate([at[ends], np.full((len(ends), 1, 2), np.nan)], axis=1).reshape(-1, 2)
            axes.plot(*lines.T, color=colour, linewidth=0.9, alpha=0.8, label=f"{status} ({len(ends)})")
    style.legend_above(axes)
    return fig
