"""The main path: a recording in, a fused trajectory out. `estimate` reads like the method section of a paper."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.app import map_localization, plausibility
from longreach.app.configuration import EstimateConfig
from longreach.app.doctor import examine
from longreach.app.evaluate import Evaluation, Metrics, Progress, Relations, evaluate, innovations, match_consistency
from longreach.app.map_localization import Start
from longreach.errors import EstimationError
from longreach.estimation.planar import filter as planar_filter
from longreach.estimation.planar.smoother import smooth
from longreach.estimation.planar.state import Correction
from longreach.evaluation.consistency import consistency_metrics
from longreach.geometry import se2
from longreach.localization import localizer
from longreach.localization.config import Source, filter_for
from longreach.localization.localizer import LocalizerState, Output, Reading, Row
from longreach.mapping.map_file import Map
from longreach.mapping.map_localizer import SOURCE
from longreach.mapping.occupancy import Occupancy
from longreach.measurement import Recording, RelativePoseMeasurement
from longreach.odometry.dead_reckoning import integrate
from longreach.odometry.lidar import ScanMatch, lidar_odometry
from longreach.odometry.wheel import WheelOdometry, wheel_odometry
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator, description_of
from longreach.trajectory import PoseTrajectory

_FILTERED = ("fused", "localized", "smoothed")
_BLOCK = 500  # readings between two reports of progress
_FAULTS = 4  # of a recording's sources that are found at most; each costs a run
_WIDER = 3.0  # the fixes are smoothed as well, so what they say of the start is taken with a larger deviation


@dataclass(frozen=True, eq=False)
class Estimate:
    """What an estimation gives: trajectories by name, what they are worth, the matches and corrections behind them.

    verdict: by its own innovations, where its covariance does not hold, a sentence; "" where it does.
    """

    recording: Recording
    robot: RobotDescription
    config: EstimateConfig
    matches: Sequence[ScanMatch]
    corrections: Sequence[Correction]
    evaluation: Evaluation
    verdict: str = ""

    @property
    def trajectories(self) -> Mapping[str, PoseTrajectory]:
        """`fused` (frame odom), with fixes `localized` (frame map), and as far as there are such sensors `wheels` (raw
        integration), `lidar` (LIDAR alone), `truth`.
        """
        return self.evaluation.trajectories

    @property
    def metrics(self) -> Metrics:
        """How good each trajectory is: name → metric → value and unit."""
        return self.evaluation.metrics

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was repaired, left out or refused, a sentence each; the first one where the covariance does not hold."""
        return (self.verdict, *self.evaluation.remarks) if self.verdict else self.evaluation.remarks

    @property
    def lidar_measurements(self) -> tuple[RelativePoseMeasurement, ...]:
        """The matches that succeeded, as the filter got them."""
        return _found(self.matches)


def estimate(
    recording: Recording,
    robot: RobotDescription | MobileManipulator,
    config: EstimateConfig | None = None,
    *,
    truth: PoseTrajectory | None = None,
    relations: Relations | None = None,
    map: Map | Occupancy | None = None,
    start: Start | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Estimate where the base went, and how well that agrees with the truth where there is one.

    The truth is used for evaluation alone. Estimates start at the identity; `localized` is where a map, or absolute
    fixes, put it.

    Arguments:
        config: None takes the defaults. truth: None takes the recording's own, where it has one.
        relations: stamps_1 (m,), stamps_2 (m,) [s] as recorded and relative poses (m, 3) [m, m, rad].
        map: in which to localise, in place of fixes; an occupancy grid serves, too. start: where the base is on it at
            first; None: it is searched for.
        progress: called with the name of a stage and how far it is, 0 to 1.

    Raises:
        EstimationError: a source that was asked for is not in the recording, or nothing is there to fuse.
        MappingError: the map is of another robot or scanner, shows nothing, or the start is not on it.
    """
    robot, config = description_of(robot), config or EstimateConfig()
    known = None if map is None else map_localization.opened(map, robot, recording, start)
    if known is not None and recording.fixes:
        said = f"{len(recording.fixes)} fixes were left out: with a map, `localized` is by its scans."
        recording = recording.replace(fixes=(), remarks=(*recording.remarks, said))
    config = config.model_copy(update={"filter": filter_for(config, robot)})
    tell = progress or (lambda stage, fraction: None)
    compared = config.compare or truth is not None or recording.truth is not None or relations is not None

    done = localized(recording, robot, config, tell)  # (3.27)-(3.29)
    recording = done.recording
    wheels = wheel_odometry(recording.wheels, robot, config.wheels)  # by themselves, as a comparison: (3.21), (3.22)
    alone = _lidar_alone(recording, robot, config, tell) if compared and "wheels" in done.sources else ()
    estimated = {"fused": _path(done.output.rows), "localized": _path(done.output.rows_on_map)}
    verdict, said, on_map = plausibility.verdict(done.output.corrections), list[str](), None
    if known is not None:
        laser = sensor_mount(recording, robot, "lidar")
        on_map = map_localization.followed(known, laser, recording.scans, done.output.rows, start, tell)
        given, corrections, said = on_map
        estimated["localized"] = _path([Row(row.stamp, row.pose, row.covariance) for row in given])
        done = done._replace(output=done.output._replace(corrections=[*done.output.corrections, *corrections]))
    if config.smooth:
        estimated["smoothed"] = _smoothed(done)

    tell("evaluation", 0.0)
    rows = {name: _at_rows(path, recording) for name, path in estimated.items() if len(path)}
    found = _found(alone if "wheels" in done.sources else done.output.matches)
    steps = {"lidar": (found, recording.scans), "wheels": (wheels.measurements, recording.wheels)}
    dead_reckoning = {
        name: integrate(motions, [record.stamp for record in records])
        for name, (motions, records) in steps.items()
        if motions
    }
    trajectories = _as_recorded(rows | dead_reckoning, recording)
    evaluation = evaluate(trajectories, truth if truth is not None else recording.truth, relations, config.evaluation)
    if map is not None and on_map is not None:
        evaluation = map_localization.judged(evaluation, map, on_map)
    metrics = _with_consistency(evaluation, done, {SOURCE, *(fix.source for fix in recording.fixes)})
    remarks = (*recording.remarks, *done.remarks, *_remarks(wheels, done), *said, *evaluation.remarks)
    evaluation = replace(evaluation, metrics=metrics, remarks=remarks)
    return Estimate(recording, robot, config, done.output.matches, done.output.corrections, evaluation, verdict)


class Done(NamedTuple):
    """The localizer after all readings, and all that it gave out.

    recording, sources: what was fused, after what was wrong with it was put right or left out; remarks: of that.
    """

    state: LocalizerState
    output: Output
    recording: Recording
    sources: tuple[Source, ...]
    remarks: tuple[str, ...]


def localized(recording: Recording, robot: RobotDescription, config: EstimateConfig, tell: Progress) -> Done:
    """Examine a recording and estimate; where a source contradicts the others, put it right or leave it out, and again.

    Sources that were asked for by name are not left out.
    """
    recording, found = examine(recording, robot, sensor_mount(recording, robot, "imu"))
    sources, remarks = _sources(recording, robot, config), list(found)
    while True:
        state, output = _folded(recording, robot, config, sources, tell)
        done = Done(state, output, recording, sources, tuple(remarks))
        said = plausibility.motions(output.matches, output.events)
        fault = plausibility.fault(said, has_mount(recording, robot, "lidar"))
        if fault is None or len(remarks) == len(found) + _FAULTS:
            return done
        remarks.append(fault.remark)
        if fault.mend == "note" or (fault.mend == "leave" and config.sources is not None):
            return done._replace(remarks=tuple(remarks))
        if fault.mend == "leave":
            sources = tuple[Source, ...](source for source in sources if source != fault.source)
        recording = plausibility.mended(recording, fault)


def _folded(
    recording: Recording, robot: RobotDescription, config: EstimateConfig, sources: Sequence[Source], tell: Progress
) -> tuple[LocalizerState, Output]:
    """Fold the localizer's step over all readings; they are in order, so it needs no history."""
    found = {"wheels": recording.wheels, "imu": recording.imu, "fixes": recording.fixes, "lidar": recording.scans}
    readings: list[Reading] = [reading for name in found if name in sources for reading in found[name]]
    readings.sort(key=lambda reading: reading.stamp)
    ordered = config.model_copy(update={"filter": config.filter.changed(history=0.0)})
    laser, imu = (sensor_mount(recording, robot, sensor) for sensor in ("lidar", "imu"))
    state = localizer.init(robot, ordered, T_base_laser=laser, T_base_imu=imu)
    parts: list[Output] = []
    for i in range(0, len(readings), _BLOCK):
        tell("fusion", i / len(readings))
        state, part = localizer.step(state, readings[i : i + _BLOCK])
        parts.append(part)
    parts.append(localizer.settled(state))
    output = Output(*(list(chain.from_iterable(column)) for column in zip(*parts, strict=True)))
    names = {fix.source for fix in recording.fixes}
    if not any(correction.dof and correction.source not in names for correction in output.corrections):
        raise EstimationError(
            f"There is nothing to fuse: {len(recording.wheels)} wheel records, {len(recording.scans)} scans, "
            f"{len(recording.imu)} IMU readings and {len(recording.fixes)} fixes show no motion; it takes two good "
            "wheel records or scans."
        )
    return state, output


def _path(rows: Sequence[Row]) -> PoseTrajectory:
    stamps, poses, covariances = zip(*rows, strict=True) if rows else ((), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    return PoseTrajectory(np.array(stamps), np.array(poses), np.array(covariances))


def _smoothed(done: Done) -> PoseTrajectory:
    """Look back over all events; with fixes from where the start is on the map."""
    rows, on_map, events = done.output.rows, done.output.rows_on_map, planar_filter.in_order(done.output.events)
    pose, P = np.zeros(3), None
    if on_map:
        moved = next(row.pose for row in reversed(rows) if row.stamp <= on_map[0].stamp)
        A = se2.adjoint(moved)
        pose, P = se2.compose(on_map[0].pose, se2.inverse(moved)), _WIDER**2 * A @ on_map[0].covariance @ A.T
    return smooth(planar_filter.init(events[0].stamp, pose, P, done.state.now.settings), events)


def _lidar_alone(
    recording: Recording, robot: RobotDescription, config: EstimateConfig, tell: Progress
) -> tuple[ScanMatch, ...]:
    scans, mount = recording.scans, sensor_mount(recording, robot, "lidar")
    if len(scans) < 2:
        return ()
    return lidar_odometry(scans, mount, config.lidar, lambda i: tell("LIDAR odometry", i / len(scans)))


def sensor_mount(recording: Recording, robot: RobotDescription, sensor: str) -> Float[np.ndarray, "4 4"]:
    """Return T_base_sensor: from the robot's description, else from the recording's own tf, else the identity."""
    described = getattr(robot, sensor)
    if described is not None and described.mount is not None:
        return described.mount.matrix()
    return np.asarray(recording.mounts.get(_frame(recording, sensor), np.eye(4)))


def has_mount(recording: Recording, robot: RobotDescription, sensor: str) -> bool:
    """Whether anything says where a sensor is mounted."""
    described = getattr(robot, sensor)
    return (described is not None and described.mount is not None) or _frame(recording, sensor) in recording.mounts


def _frame(recording: Recording, sensor: str) -> str:
    records = {"lidar": recording.scans, "imu": recording.imu}[sensor]
    return records[0].frame if records else ""


def _sources(recording: Recording, robot: RobotDescription, config: EstimateConfig) -> tuple[Source, ...]:
    """Return what is fused, of what can be.

    Raises:
        EstimationError: what is asked for is not there, or cannot be used.
    """
    if any(later.stamp < scan.stamp for scan, later in pairwise(recording.scans)):
        raise EstimationError("The stamps of the scans run backwards; repair them with monotone_clock.")
    there: dict[Source, bool] = {
        "wheels": len(recording.wheels) > 1,
        "lidar": len(recording.scans) > 1,
        "imu": len(recording.imu) > 0,
        "fixes": len(recording.fixes) > 0,
    }
    sources = config.sources or tuple(source for source in there if there[source])
    missing = [source for source in sources if not there[source]]
    if missing:
        have = ", ".join(source for source in there if there[source]) or "nothing that can be fused"
        raise EstimationError(f"The recording has no {' and no '.join(missing)} to fuse; it has {have}.")
    if "imu" in sources and robot.imu is None:
        raise EstimationError(f"The recording has an IMU, but the description of {robot.name} does not say what it is.")
    return sources


def _found(matches: Sequence[ScanMatch]) -> tuple[RelativePoseMeasurement, ...]:
    return tuple(match.measurement for match in matches if match.measurement is not None)


def _with_consistency(evaluation: Evaluation, done: Done, fixes: set[str]) -> Metrics:
    """Add the NIS of each source to the metrics of what it corrects, and the NEES of matches to those of the LIDAR."""
    metrics, matches = {name: dict(one) for name, one in evaluation.metrics.items()}, _found(done.output.matches)
    for source, consistency in innovations(done.output.corrections).items():
        name = "localized" if source in fixes else "fused"
        metrics.setdefault(name, {}).update(consistency_metrics(f"nis_{source}", consistency))
    truth = evaluation.trajectories.get("truth")
    if matches and "lidar" in metrics and truth is not None and truth.has_heading:
        metrics["lidar"] |= consistency_metrics("match_nees", match_consistency(matches, truth))
    return metrics


def _at_rows(fused: PoseTrajectory, recording: Recording) -> PoseTrajectory:
    """Keep the rows at wheel and scan stamps; where there is neither, all of them."""
    stamps = {scan.stamp for scan in recording.scans} | {wheel.stamp for wheel in recording.wheels}
    keep = np.array([stamp in stamps for stamp in fused.clock.tolist()])
    if not keep.any():
        return fused
    assert fused.covariance is not None
    return PoseTrajectory(fused.stamps[keep], fused.poses[keep], fused.covariance[keep], fused.clock[keep])


def _as_recorded(paths: Mapping[str, PoseTrajectory], recording: Recording) -> dict[str, PoseTrajectory]:
    """Give the paths that there are the stamps as recorded, in the order of all tables."""
    return {
        name: PoseTrajectory(recording.as_recorded(path.clock), path.poses, path.covariance, path.clock)
        for name, path in ((name, paths[name]) for name in (*_FILTERED, "wheels", "lidar") if name in paths)
        if name in _FILTERED or len(path) > 1
    }


def _remarks(wheels: WheelOdometry, done: Done) -> list[str]:
    remarks, matches = [], done.output.matches
    if wheels.refused:
        remarks.append(f"{wheels.refused} records of the wheels are not finite; they were passed over.")
    if wheels.wraps:
        remarks.append(
            f"The wheels' readings start again after {wheels.wrap_range:g}; they were continued {wheels.wraps} times."
        )
    if wheels.breaks:
        remarks.append(f"The wheels' counts jumped {wheels.breaks} times; nothing was taken across the jumps.")
    if done.state.now.fixed:
        remarks.append("The fixes lie too near each other to show the heading on the map, so nothing is localized.")
    if done.state.buffer.waiting:
        remarks.append(f"{len(done.state.buffer.waiting)} readings after a long pause were too few to be believed.")
    failed = [match for match in matches if match.measurement is None]
    if failed:
        remarks.append(f"{len(failed)} of {len(matches)} scans gave no match; the first because {failed[0].reason}.")
    for source, tally in done.state.tallies.items():
        if tally.gated or tally.refused or tally.inflated:
            total = tally.used + tally.gated + tally.refused
            remarks.append(
                f"{source}: of {total} measurements {tally.inflated} were taken with a larger covariance, "
                f"{tally.gated} gated and {tally.refused} refused."
            )
    return remarks
