"""What a command line names, read and checked: a recording, a robot, settings, references."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from longreach.app.configuration import EstimateConfig
from longreach.app.evaluate import Relations
from longreach.errors import ConfigError, RecordingError
from longreach.io.config import assuming, load_description, read_config, validated
from longreach.io.recording import read_recording
from longreach.io.relations import read_relations
from longreach.io.trajectory_file import has_stamps, read_poses
from longreach.measurement import PoseMeasurement, Recording
from longreach.robot.description import RobotDescription
from longreach.trajectory import PoseTrajectory

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class Run:
    """All that an estimation needs; truth and relations are for evaluation alone."""

    recording: Recording
    robot: RobotDescription
    config: EstimateConfig
    truth: PoseTrajectory | None
    relations: Relations | None


def open_run(
    recording: Path,
    robot: str | Path,
    *,
    config: Path | None = None,
    truth: str | None = None,
    relations: Path | None = None,
    sources: str | None = None,
    fixes: Path | None = None,
    fix_sigma: float = 0.05,
    fix_period: float = 0.0,
    smooth: bool = False,
    compare: bool = False,
    assume: Mapping[str, str] | None = None,
    topics: Mapping[str, str] | None = None,
    clock: Literal["header", "record"] = "header",
    progress: Progress | None = None,
) -> Run:
    """Read everything, the small files first, so that what is wrong with them is said at once.

    Arguments: truth: a file, or else a topic of the recording. sources: names with commas between. fixes: positions in
    a file, taken no more often than every `fix_period` [s] with a standard deviation of `fix_sigma` [m]. assume: keys
    of the description that the recording cannot say, and their values as YAML. topics, clock: as of `read_recording`.
    """
    description = assuming(load_description(robot), assume)
    settings = read_config(config, EstimateConfig) if config is not None else EstimateConfig()
    if sources is not None:
        names = [name.strip() for name in sources.split(",") if name.strip()]
        settings = validated(EstimateConfig, settings.model_dump(exclude_unset=True) | {"sources": names}, "--sources")
    asked = {name: True for name, given in (("smooth", smooth), ("compare", compare)) if given}
    settings = settings.model_copy(update=asked)
    compared = Relations(*read_relations(relations)) if relations is not None else None
    is_file = truth is not None and Path(truth).exists()
    if truth is not None and not is_file and "." in truth:  # no topic has a dot in its name
        raise ConfigError(f"{truth} is not there; the truth is a file or a topic of the recording.")
    if fixes is not None and not fixes.is_file():
        raise ConfigError(f"{fixes} is not there.")
    if not 0 < fix_sigma < np.inf:
        raise ConfigError(f"--fix-sigma is {fix_sigma:g}; a standard deviation is finite and larger than 0 m.")
    if not 0 <= fix_period < np.inf:
        raise ConfigError(f"--fix-period is {fix_period:g}; a period is finite and not less than 0 s.")
    tell = progress or (lambda stage, fraction: None)
    read = read_recording(
        recording,
        description,
        lambda fraction: tell("reading", min(fraction, 1.0)),
        truth_topic=None if is_file else truth,
        topics=topics,
        clock=clock,
    )
    if fixes is not None:
        positions, said = _stamped_poses(fixes, read)
        read = read.replace(fixes=_fixes(positions, fix_sigma, fix_period), remarks=(*read.remarks, *said))
    reference = None
    if truth is not None and is_file:
        reference, said = _stamped_poses(Path(truth), read)
        read = read.replace(remarks=(*read.remarks, *said))
    return Run(read, description, settings, reference, compared)


def _stamped_poses(path: Path, recording: Recording) -> tuple[PoseTrajectory, tuple[str, ...]]:
    if not has_stamps(path):
        raise RecordingError(f"The poses of KITTI in {path} have no stamps; put their times.txt beside it.")
    return read_poses(path, recording)


def _fixes(path: PoseTrajectory, sigma: float, period: float) -> tuple[PoseMeasurement, ...]:
    covariance = np.diag([sigma**2, sigma**2, np.inf])
    taken: list[PoseMeasurement] = []
    last = -np.inf
    for stamp, pose in zip(path.clock.tolist(), path.poses, strict=True):
        if stamp - last >= period:
            taken.append(PoseMeasurement(stamp, pose, covariance, source="fixes"))
            last = stamp
    return tuple(taken)
