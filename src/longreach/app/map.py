"""Mapping: recordings in, a map and optimised trajectories out. `build_map` reads like a paper's method section."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from longreach.app.configuration import EstimateConfig
from longreach.app.estimate import Done, localized, sensor_mount
from longreach.app.evaluate import Evaluation, Metrics, Progress, Relations, carried_to_truth, evaluate
from longreach.errors import LongreachError, MappingError
from longreach.evaluation.relations import long_relation_metrics
from longreach.evaluation.tables import metric
from longreach.localization.config import filter_for
from longreach.mapping import loop_closure, mapper, sessions, solver
from longreach.mapping.loop_closure import Match
from longreach.mapping.map_file import Map, Session
from longreach.mapping.mapper import MapperState, PathRow
from longreach.mapping.refinement import refined
from longreach.measurement import Recording
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator, description_of
from longreach.trajectory import PoseTrajectory

_BLOCK = 500  # scans between two reports of progress
STATUSES = ("accepted", "refused", "waiting", "withdrawn")


class Closure(NamedTuple):
    """A match to a place of before, what became of it, and why: accepted, refused, waiting or withdrawn.

    stamps: of both keyframes as recorded [s]. chi2: of its residual in the map as solved, with 3 degrees of freedom.
    """

    match: Match
    stamps: tuple[float, float]
    status: str
    reason: str
    chi2: float


@dataclass(frozen=True, eq=False)
class Mapped:
    """One recording, and what mapping made of it.

    first: its first keyframe in the map, None where nothing joins it with the map: it is left out then. closures: all
    matches that were tried. evaluation: trajectories `mapped` at every scan stamp, and `fused`, the localizer's own.
    """

    recording: Recording
    first: int | None
    closures: tuple[Closure, ...]
    evaluation: Evaluation


@dataclass(frozen=True, eq=False, kw_only=True)
class BuiltMap(Map):
    """A map that was just built, with what it was made of: a `Mapped` for each recording, in their order."""

    robot: RobotDescription
    config: EstimateConfig
    parts: tuple[Mapped, ...]

    @property
    def left_out(self) -> tuple[str, ...]:
        """The names of recordings that nothing joins with the map."""
        return tuple(part.recording.name for part in self.parts if part.first is None)

    @property
    def trajectories(self) -> Mapping[str, PoseTrajectory]:
        """`mapped` and `fused`, of a second recording `mapped_2` and `fused_2`, and so on."""
        return {name: path for e in self._evaluations for name, path in e.trajectories.items()}

    @property
    def metrics(self) -> Metrics:
        """How good each trajectory is, and `map`: how many keyframes and closures there are."""
        counts = Counter(closure.status for part in self.parts for closure in part.closures)
        found = {"keyframes": metric(len(self.scans), ""), "sessions": metric(len(self.sessions), "")}
        found |= {f"closures_{status}": metric(counts[status], "") for status in STATUSES}
        return {name: one for e in self._evaluations for name, one in e.metrics.items()} | {"map": found}

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was left out, repaired or refused, a sentence each."""
        said = [
            f"{name} is left out of the map: no {mapper.JOIN} of its places, over {mapper.JOIN_WAY:g} m of path, fit "
            "the map at one place alone and agree with each other. It may be of another building."
            for name in self.left_out
        ]
        for part in self.parts:
            of = f"{part.recording.name}: " if len(self.parts) > 1 else ""
            said += [of + remark for remark in (*part.evaluation.remarks, *_remarks(part))]
        return tuple(said)

    @property
    def _evaluations(self) -> list[Evaluation]:
        return [numbered(part.evaluation, k) for k, part in enumerate(self.parts)]


def build_map(
    recordings: Recording | Sequence[Recording],
    robot: RobotDescription | MobileManipulator,
    config: EstimateConfig | None = None,
    *,
    add_to: Map | None = None,
    truth: PoseTrajectory | None = None,
    relations: Relations | None = None,
    progress: Progress | None = None,
) -> BuiltMap:
    """Map where recordings went; the map begins at the identity, where the first of them does.

    Each further recording is a session of its own, and joined with the map where loop closures show that it is of the
    same place, and else left out: see `BuiltMap.left_out`.

    Arguments:
        add_to: a map that is there already, as of `load_map`; it is not changed. truth: of the only recording; None
        takes each recording's own, where it has one. relations: between stamps of one recording. Others: as of
        `estimate`.

    Raises:
        MappingError: a recording has fewer than two scans, is in the map already, or has another laser than the map.
        EstimationError: a source that was asked for is not there.
    """
    recordings = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    robot, config = description_of(robot), config or EstimateConfig()
    config = config.model_copy(update={"filter": filter_for(config, robot)})
    tell = progress or (lambda stage, fraction: None)
    _check(recordings, robot, add_to, truth, relations)

    done = [localized(recording, robot, config, tell) for recording in recordings]
    map_, states, refined_ = add_to, dict[int, MapperState](), dict[int, _Refined]()
    while True:  # what nothing joins with the map may be joined once another recording is
        before, left = map_, [k for k in range(len(done)) if k not in states or not states[k].is_joined]
        for k in left:
            map_, states[k], refined_[k] = _added(map_, done[k], robot, tell)
        if map_ is before or before is add_to is None or all(state.is_joined for state in states.values()):
            break
    assert map_ is not None
    tell("evaluation", 0.0)
    solved = solver.optimize(map_.graph, map_.weights)
    parts = [
        _judged(done[k], states[k], refined_[k], solved, map_.stamps, truth, relations, config)
        for k in range(len(done))
    ]
    if add_to is None:
        map_ = replace(map_, T_truth_map=carried_to_truth(parts[0].evaluation, "mapped"))
    names = ("graph", "weights", "scans", "twists", "session", "sessions", "T_truth_map")
    return BuiltMap(**{name: getattr(map_, name) for name in names}, robot=robot, config=config, parts=tuple(parts))


class _Refined(NamedTuple):
    """Of a session: the matches that have weight in the end, and the noise (n, 3, 3) of each keyframe's own scan."""

    held: set[int]
    noise: np.ndarray


def _added(
    before: Map | None, done: Done, robot: RobotDescription, tell: Progress
) -> tuple[Map | None, MapperState, _Refined]:
    """Add a session to a map, and say what came of it; where nothing joins it, return the map as it was."""
    recording, laser = done.recording, sensor_mount(done.recording, robot, "lidar")
    if before is not None:
        sessions.check_robot(before, robot.name, recording.scans[0], laser)
        sessions.check_new(before, recording.name, recording.scans)
    start = mapper.init(laser) if before is None else sessions.begin(before, laser)
    state = _folded(start, recording, _path(done), tell)
    accepted = [a for a in state.accepted if a not in state.withdrawn]
    if not state.is_joined:
        return before, state, _Refined(set(accepted), np.zeros((len(state.keyframes), 3, 3)))
    edges = mapper.closure_edges([state.matches[a] for a in accepted])
    solved, noise = refined(state.keyframes, state.poses, edges, lambda fraction: tell("refinement", fraction))
    held = {a for a, weight in zip(accepted, solved.weights, strict=False) if weight > 0.5}  # they come first
    frames = {k.scan.frame for k in state.keyframes[state.first :]}
    session = Session(recording.name, robot.name, {frame: laser for frame in frames}, robot.model_dump(mode="json"))
    return sessions.map_of(solved, state, session, before), state, _Refined(held, noise)


def _path(done: Done) -> list[PathRow]:
    stamps = {scan.stamp for scan in done.recording.scans}
    return [PathRow(*row) for row in done.output.rows if row.stamp in stamps]


def _folded(state: MapperState, recording: Recording, rows: Sequence[PathRow], tell: Progress) -> MapperState:
    for i in range(0, len(rows), _BLOCK):
        tell("loop closure", i / len(rows))
        low, high = rows[i].stamp, rows[min(i + _BLOCK, len(rows)) - 1].stamp
        scans = [scan for scan in recording.scans if low <= scan.stamp <= high]
        state = mapper.step(state, scans, rows[i : i + _BLOCK])
    return mapper.settled(state)


def _judged(
    done: Done,
    state: MapperState,
    found: _Refined,
    solved: solver.Solved,
    stamps: np.ndarray,
    truth: PoseTrajectory | None,
    relations: Relations | None,
    config: EstimateConfig,
) -> Mapped:
    """Hold a session's trajectories against what references there are.

    found: of its keyframes in the map; stamps: of the map's keyframes [s].
    """
    recording, rows = done.recording, _path(done)
    clock = np.array([row.stamp for row in rows])
    recorded, fused = recording.as_recorded(clock), np.array([row.pose for row in rows])
    own, trajectories = slice(state.first, len(state.keyframes)), {}
    if state.is_joined:
        covariances = solver.marginals(solved)[own] + found.noise[own]
        path = mapper.on_map(state.keyframes[own], solved.poses[own], covariances, rows)
        trajectories["mapped"] = PoseTrajectory(recorded, *path, clock)
    trajectories["fused"] = PoseTrajectory(recorded, fused, np.array([row.covariance for row in rows]), clock)
    within = _within(relations, recorded)
    evaluation = evaluate(trajectories, truth if truth is not None else recording.truth, within, config.evaluation)
    metrics = {name: dict(one) for name, one in evaluation.metrics.items()}
    for name, errors in evaluation.relation_errors.items():
        metrics[name] |= long_relation_metrics(errors)
    remarks = (*recording.remarks, *done.remarks, *evaluation.remarks)
    new = recording.as_recorded(np.array([k.stamp for k in state.keyframes[own]]))
    closures = _closures(
        state, found.held, solved.poses if state.is_joined else state.poses, np.concatenate([stamps[: own.start], new])
    )
    first = state.first if state.is_joined else None
    return Mapped(recording, first, closures, replace(evaluation, metrics=metrics, remarks=remarks))


def _closures(state: MapperState, held: set[int], poses: np.ndarray, stamps: np.ndarray) -> tuple[Closure, ...]:
    """Return what became of each match, where keyframes are at poses (n, 3); held: those with weight in the end."""
    found = []
    chi2 = loop_closure.chi2_of(state.matches, poses)
    for a, match in enumerate(state.matches):
        if a in held:
            became = "accepted", ""
        elif a in state.accepted:
            became = "withdrawn", "Other closures contradict it."
        elif match.gate:
            became = "refused", loop_closure.reason_of(match)
        else:
            became = "waiting", "No other closure near by agrees with it."
        found.append(Closure(match, (float(stamps[match.i]), float(stamps[match.j])), *became, float(chi2[a])))
    return tuple(found)


def _check(
    recordings: Sequence[Recording],
    robot: RobotDescription,
    add_to: Map | None,
    truth: PoseTrajectory | None,
    relations: Relations | None,
) -> None:
    """Say before long work what cannot be mapped."""
    if not recordings:
        raise MappingError("There is no recording to map; give one at least.")
    if truth is not None and len(recordings) > 1:
        raise MappingError("A truth is of one recording; map one at a time to compare with it.")
    for k, recording in enumerate(recordings):
        n = len(recording.scans)
        if n < 2:
            what = "1 scan" if n == 1 else "no scans"
            raise MappingError(f"{recording.name} has {what}; a map takes two scans of a LIDAR at least.")
        for other in recordings[:k]:
            if other.scans[0].stamp == recording.scans[0].stamp and np.array_equal(
                other.scans[0].ranges, recording.scans[0].ranges, equal_nan=True
            ):
                raise MappingError(f"{recording.name} is there twice; give each recording once.")
        if add_to is not None:
            laser = sensor_mount(recording, robot, "lidar")
            sessions.check_robot(add_to, robot.name, recording.scans[0], laser)
            sessions.check_new(add_to, recording.name, recording.scans)
    recorded = [r.as_recorded(np.array([scan.stamp for scan in r.scans])) for r in recordings]
    if relations is not None and all(_within(relations, stamps) is None for stamps in recorded):
        raise LongreachError("No relation has both stamps within a recording; are they of this one?")


def _within(relations: Relations | None, stamps: np.ndarray) -> Relations | None:
    """Return the relations with both stamps within a recording's, None where there are none."""
    if relations is None:
        return None
    first, second, _ = relations
    low, high = stamps.min(), stamps.max()
    inside = (np.minimum(first, second) >= low) & (np.maximum(first, second) <= high)
    return Relations(*(column[inside] for column in relations)) if np.any(inside) else None


def numbered(evaluation: Evaluation, k: int) -> Evaluation:
    """Return the evaluation of recording k with names that say which one it is of: none of the first, _2 and so on."""
    if k == 0:
        return evaluation

    def named(values: Mapping) -> dict:
        return {f"{name}_{k + 1}": value for name, value in values.items()}

    e = evaluation
    return replace(
        e,
        trajectories=named(e.trajectories),
        metrics=named(e.metrics),
        relation_errors=named(e.relation_errors),
    )


def _remarks(part: Mapped) -> list[str]:
    if part.first is not None and not any(closure.status == "accepted" for closure in part.closures):
        return ["No loop was closed: the map is only as good as odometry."]
    return []
