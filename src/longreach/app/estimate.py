"""The main path: a recording in, a fused trajectory out. `estimate` reads like the method section of a paper."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from longreach.app.configuration import EstimateConfig, Source, filter_for
from longreach.app.evaluate import (
    Evaluation,
    Metrics,
    Progress,
    Relations,
    evaluate,
    innovations,
    match_consistency,
)
from longreach.app.filter_events import lidar_events, wheel_events
from longreach.app.start import start_pose
from longreach.errors import EstimationError
from longreach.estimation import fusion, offline
from longreach.estimation.fusion import Correction, Event
from longreach.estimation.observation import PlanarImu, planar_imu
from longreach.estimation.smoother import smooth
from longreach.evaluation.consistency import consistency_metrics
from longreach.measurement import Recording, RelativePoseMeasurement
from longreach.odometry import motion_prior
from longreach.odometry.dead_reckoning import integrate
from longreach.odometry.lidar import lidar_odometry
from longreach.odometry.scan_match import ScanMatch
from longreach.odometry.wheel import wheel_odometry
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator, description_of
from longreach.trajectory import PoseTrajectory

_FILTERED = ("fused", "localized", "smoothed")


@dataclass(frozen=True, eq=False)
class Estimate:
    """What an estimation gives: trajectories by name, what they are worth, the matches and corrections behind them."""

    recording: Recording
    robot: RobotDescription
    config: EstimateConfig
    matches: Sequence[ScanMatch]
    corrections: Sequence[Correction]
    evaluation: Evaluation

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
        """What was repaired, left out or refused, a sentence each."""
        return self.evaluation.remarks

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
    progress: Progress | None = None,
) -> Estimate:
    """Estimate where the base went, and how well that agrees with the truth where there is one.

    The truth is used for evaluation alone. Estimates start at the identity; `localized` is where absolute fixes put it.

    Arguments:
        config: None takes the defaults. truth: None takes the recording's own, where it has one.
        relations: stamps_1 (m,), stamps_2 (m,) [s] as recorded and relative poses (m, 3) [m, m, rad].
        progress: called with the name of a stage and how far it is, 0 to 1.

    Raises:
        EstimationError: a source that was asked for is not in the recording, or nothing is there to fuse.
    """
    robot, config = description_of(robot), config or EstimateConfig()
    config = config.model_copy(update={"filter": filter_for(config, robot, recording)})
    tell = progress or (lambda stage, fraction: None)
    sources = _sources(recording, config)

    wheels = wheel_odometry(recording.wheels, robot, config.wheels)  # (3.21), (3.22)
    compared = config.compare or truth is not None or recording.truth is not None or relations is not None
    prior = wheels.measurements if "wheels" in sources else ()
    alone, matches = None, ()
    if "lidar" in sources or (compared and len(recording.scans) > 1):
        alone, matches = _matches(recording, robot, config, prior, compared, tell)
    dead_reckoning = {
        "lidar": integrate(_found(alone or ()), [scan.stamp for scan in recording.scans]),
        "wheels": integrate(wheels.measurements, [record.stamp for record in recording.wheels]),
    }

    odometry = {"wheels": wheel_events(wheels.measurements), "lidar": lidar_events(matches)}
    events = _events(recording, robot, sources, odometry)
    start = fusion.init(events[0].stamp, np.zeros(3), None, config.filter)
    state, fused, corrections = offline.run(start, events, lambda i: tell("fusion", i / len(events)))  # (3.27)–(3.29)
    estimated, judged, tallies = {"fused": fused}, {"fused": corrections}, state.counters
    if "fixes" in sources:  # by a filter of its own, so that no fix moves the smooth path
        paths = {**dead_reckoning, "lidar": integrate(_found(matches), [scan.stamp for scan in recording.scans])}
        start, events = _with_fixes(recording, sources, paths, events, config)
        state, estimated["localized"], all_ = offline.run(start, events, lambda i: tell("fusion", i / len(events)))
        names = {fix.source for fix in recording.fixes}
        judged["localized"] = [correction for correction in all_ if correction.source in names]
        tallies |= {name: state.counters[name] for name in names}
    if config.smooth:
        estimated["smoothed"] = smooth(start, events)

    tell("evaluation", 0.0)
    rows = {name: _at_rows(path, recording) for name, path in estimated.items()}
    trajectories = _as_recorded(rows | dead_reckoning, recording)
    evaluation = evaluate(trajectories, truth if truth is not None else recording.truth, relations, config.evaluation)
    metrics = _with_consistency(evaluation, judged, _found(matches))
    corrections = [correction for name in judged for correction in judged[name]]
    remarks = (*recording.remarks, *_remarks(wheels.breaks, matches, tallies), *evaluation.remarks)
    return Estimate(
        recording, robot, config, matches, corrections, replace(evaluation, metrics=metrics, remarks=remarks)
    )


def _with_fixes(
    recording: Recording,
    sources: Sequence[Source],
    dead_reckoning: Mapping[str, PoseTrajectory],
    events: Sequence[Event],
    config: EstimateConfig,
) -> tuple[fusion.FusionState, list[Event]]:
    """Return a filter that starts on the map, where fixes put it, and the events with them."""
    events = fusion.in_order([*events, *recording.fixes])
    begin = events[0].stamp
    paths = [path for name, path in dead_reckoning.items() if name in sources]
    return fusion.init(begin, *start_pose(recording.fixes, paths, begin), config.filter), events


def sensor_mount(recording: Recording, robot: RobotDescription, sensor: str) -> Float[np.ndarray, "4 4"]:
    """Return T_base_sensor: from the robot's description, else from the recording's own tf, else the identity."""
    described = getattr(robot, sensor)
    if described is not None and described.mount is not None:
        return described.mount.matrix()
    records = {"lidar": recording.scans, "imu": recording.imu}[sensor]
    frame = records[0].frame if records else ""
    return np.asarray(recording.mounts.get(frame, np.eye(4)))


def _sources(recording: Recording, config: EstimateConfig) -> tuple[Source, ...]:
    there: dict[Source, bool] = {
        "wheels": len(recording.wheels) > 1,
        "lidar": len(recording.scans) > 1,
        "imu": len(recording.imu) > 0,
        "fixes": len(recording.fixes) > 0,
    }
    if config.sources is None:
        return tuple(source for source in there if there[source])
    missing = [source for source in config.sources if not there[source]]
    if missing:
        have = ", ".join(source for source in there if there[source]) or "nothing that can be fused"
        raise EstimationError(f"The recording has no {' and no '.join(missing)} to fuse; it has {have}.")
    return config.sources


def _matches(
    recording: Recording,
    robot: RobotDescription,
    config: EstimateConfig,
    wheels: Sequence[RelativePoseMeasurement],
    alone: bool,
    tell: Progress,
) -> tuple[tuple[ScanMatch, ...] | None, tuple[ScanMatch, ...]]:
    """Match the scans by LIDAR alone, where that is asked for, and for the filter with a prior from the wheels.

    Of scans of one stamp the last is taken, for between them is no time to move.
    """
    scans = recording.scans
    if any(later.stamp < scan.stamp for scan, later in pairwise(scans)):
        raise EstimationError("The stamps of the scans run backwards; repair them with monotone_clock.")
    some = [scan for scan, later in pairwise(scans) if later.stamp > scan.stamp] + list(scans[-1:])
    mount, runs = sensor_mount(recording, robot, "lidar"), 2 if wheels and alone else 1

    def odometry(priors: Sequence[np.ndarray | None] | None, run: int) -> tuple[ScanMatch, ...]:
        show = lambda i: tell("LIDAR odometry", (run + i / len(some)) / runs)  # noqa: E731
        return lidar_odometry(some, mount, config.lidar, show, priors)

    matches = odometry(motion_prior.between_scans(wheels, [scan.stamp for scan in some]) if wheels else None, 0)
    return odometry(None, 1) if wheels and alone else None if wheels else matches, matches


def _found(matches: Sequence[ScanMatch]) -> tuple[RelativePoseMeasurement, ...]:
    return tuple(match.measurement for match in matches if match.measurement is not None)


def _events(
    recording: Recording,
    robot: RobotDescription,
    sources: Sequence[Source],
    odometry: Mapping[str, Sequence[Event]],
) -> list[Event]:
    """Return what the sources measured, as the filter takes it."""
    events: list[Event] = []
    if "imu" in sources:
        events += _imu(recording, robot)
    for source in sources:
        events += odometry.get(source, ())
    if not events:
        raise EstimationError(
            f"There is nothing to fuse: {len(recording.wheels)} wheel records, {len(recording.scans)} scans, "
            f"{len(recording.imu)} IMU readings and {len(recording.fixes)} fixes tell of no motion; it takes two good "
            "wheel records or scans."
        )
    return fusion.in_order(events)


def _imu(recording: Recording, robot: RobotDescription) -> tuple[PlanarImu, ...]:
    if robot.imu is None:
        raise EstimationError(f"The recording has an IMU, but the description of {robot.name} does not say what it is.")
    T = sensor_mount(recording, robot, "imu")
    noise = robot.imu
    R = (noise.gyro_deviation**2, noise.acceleration_deviation**2)
    with np.errstate(invalid="ignore"):  # the filter refuses what is not finite, and counts it
        return tuple(planar_imu(imu, T, *R) for imu in recording.imu)


def _with_consistency(
    evaluation: Evaluation,
    judged: Mapping[str, Sequence[Correction]],
    matches: Sequence[RelativePoseMeasurement],
) -> Metrics:
    """Add the NIS of each source to the metrics of what it corrects, and the NEES of matches to those of the LIDAR."""
    metrics = {name: dict(one) for name, one in evaluation.metrics.items()}
    for name, corrections in judged.items():
        for source, consistency in innovations(corrections).items():
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


def _remarks(breaks: int, matches: Sequence[ScanMatch], tallies: Mapping[str, fusion.Tally]) -> list[str]:
    remarks = []
    if breaks:
        remarks.append(f"The wheels' counts jumped {breaks} times; nothing was taken across the jumps.")
    failed = [match for match in matches if match.measurement is None]
    if failed:
        remarks.append(f"{len(failed)} of {len(matches)} scans gave no match; the first because {failed[0].reason}.")
    for source, tally in tallies.items():
        if tally.gated or tally.refused or tally.inflated:
            total = tally.used + tally.gated + tally.refused
            remarks.append(
                f"{source}: of {total} measurements {tally.inflated} were taken with a larger covariance, "
                f"{tally.gated} gated and {tally.refused} refused."
            )
    return remarks
