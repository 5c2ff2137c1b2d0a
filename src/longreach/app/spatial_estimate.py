"""A drop-in for robot_localization: its parameter file and a bag in, its 15-state estimate out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.figure import Figure

from longreach.app.results import write_results
from longreach.app.warmup import warm_up
from longreach.estimation.spatial.batch import SpatialEstimate, estimate_in_space
from longreach.evaluation import figures, spatial_figures
from longreach.evaluation.consistency import Consistency, consistency_metrics
from longreach.evaluation.tables import Metric, metric
from longreach.io.robot_localization import ParameterFile, read_parameters
from longreach.io.robot_localization_bag import read_spatial_recording
from longreach.io.tum import write_spatial_tum
from longreach.io.whole_files import whole_folder
from longreach.spatial_measurement import AccelerationReading, PoseReading, SpatialRecording, TwistReading

Progress = Callable[[str, float], None]
_MAIN = ("path_length", "duration", *(f"final_{axis}" for axis in ("x", "y", "z", "roll", "pitch", "yaw")))


@dataclass(frozen=True, eq=False)
class SpatialRun:
    """A recording, the parameters that ran over it, and what came of it."""

    recording: SpatialRecording
    parameters: ParameterFile
    estimate: SpatialEstimate
    metrics: Mapping[str, Mapping[str, Metric]]
    remarks: tuple[str, ...]

    @property
    def main(self) -> Mapping[str, Mapping[str, Metric]]:
        """The few metrics that tell most."""
        return {"fused": {name: m for name, m in self.metrics["fused"].items() if name in _MAIN}}


def estimate_from_parameters(
    recording: str | Path,
    parameters: str | Path,
    *,
    node: str | None = None,
    filter: str | None = None,
    transforms: Sequence[str] = (),
    as_robot_localization: bool = False,
    progress: Progress | None = None,
) -> SpatialRun:
    """Estimate a bag by a parameter file of robot_localization.

    Arguments:
        node: of the file, where it has several. filter: ekf or ukf; None: as the file or the node's name says.
        transforms: PARENT:CHILD=x,y,z,roll,pitch,yaw [m, rad], which go before the recording's tf.
        as_robot_localization: take over the defects of the original that change a number.

    Raises:
        LongreachError: a file, a key or a frame that cannot be used; one sentence says why.
    """
    tell = progress or (lambda stage, fraction: None)
    changes: dict[str, Any] = {"filter": filter} if filter is not None else {}
    if as_robot_localization:
        changes["as_robot_localization"] = True
    read = read_parameters(Path(parameters), node, changes)
    # The last of two transforms of one frame counts.
    read = replace(read, transforms=(*read.transforms, *transforms))
    bag = read_spatial_recording(Path(recording), read.settings, read.transforms, lambda part: tell("reading", part))
    warm_up(progress, "estimation in space")  # after what can be wrong with the files
    tell("fusion", 0.0)
    estimate = estimate_in_space(bag, read.settings)
    return SpatialRun(bag, read, estimate, {"fused": _metrics(estimate)}, (*read.remarks, *estimate.remarks))


def _consistency(estimate: SpatialEstimate) -> dict[str, Consistency]:
    return {
        source: Consistency(stamps, values, np.full(len(values), float(rows)))
        for source, (stamps, values, rows) in estimate.nis.items()
        if len(values)
    }


def _metrics(estimate: SpatialEstimate) -> dict[str, Metric]:
    """Return where it ended, how far it went, and what became of the measurements."""
    states, last = estimate.states, estimate.states[-1].tolist()
    found = {
        "path_length": metric(float(np.linalg.norm(np.diff(states[:, :3], axis=0), axis=1).sum()), "m"),
        "duration": metric(float(estimate.stamps[-1] - estimate.stamps[0]), "s"),
        "rows": metric(len(states), ""),
        **{f"final_{axis}": metric(value, "m") for axis, value in zip("xyz", last[:3], strict=True)},
        **{
            f"final_{angle}": metric(float(np.degrees(value)), "deg")
            for angle, value in zip(("roll", "pitch", "yaw"), last[3:6], strict=True)
        },
    }
    for source, (used, gated, refused) in estimate.used.items():
        found |= {
            f"{source}_{what}": metric(n, "") for what, n in (("used", used), ("gated", gated), ("refused", refused))
        }
    for source, consistency in _consistency(estimate).items():
        found |= consistency_metrics(f"nis_{source}", consistency)
    return found


def write_spatial_run(run: SpatialRun, out: str | Path, progress: Progress | None = None) -> None:
    """Write fused.tum, covariance.npz, metrics.json, config.yaml, figures and report.html into a folder."""
    tell = progress or (lambda stage, fraction: None)
    estimate = run.estimate
    with whole_folder(Path(out)) as folder:
        write_spatial_tum(folder / "fused.tum", estimate.stamps, estimate.poses)
        np.savez_compressed(
            folder / "covariance.npz", fused_stamps=estimate.stamps, fused_covariance=estimate.covariance
        )
        title = f"Estimate of {run.recording.name}"
        write_results(
            folder,
            title,
            _introduction(run),
            run.metrics,
            _figures(run),
            _config(run),
            tell,
            run.remarks,
            spatial_figures.CAPTIONS,
            run.main,
        )


def _introduction(run: SpatialRun) -> str:
    settings, counted = run.parameters.settings, []
    names = {PoseReading: "poses", TwistReading: "twists", AccelerationReading: "accelerations"}
    for sensor in settings.sensors:
        own = [reading for reading in run.recording.readings if reading.source == sensor.name]
        parts = [f"{sum(isinstance(r, kind) for r in own)} {name}" for kind, name in names.items()]
        counted.append(f"{sensor.name} ({sensor.topic}): {', '.join(p for p in parts if not p.startswith('0 '))}")
    how = (
        "as robot_localization has it"
        if settings.as_robot_localization
        else "without robot_localization's known defects"
    )
    return f"Node {run.parameters.node}, {settings.filter.upper()} of 15 states, {how}.\n\n" + "; ".join(counted) + "."


def _figures(run: SpatialRun) -> dict[str, Callable[[], Figure]]:
    e, nis = run.estimate, _consistency(run.estimate)
    drawn: dict[str, Callable[[], Figure]] = {
        "plane": lambda: spatial_figures.plane(e.states, e.state_covariance),
        "height": lambda: spatial_figures.height(e.stamps, e.states, e.state_covariance),
        "angles": lambda: spatial_figures.angles(e.stamps, e.states, e.state_covariance),
        "velocity": lambda: spatial_figures.velocity(e.stamps, e.states),
    }
    if nis:
        drawn["innovation"] = lambda: figures.innovation(nis)
    return drawn


def _config(run: SpatialRun) -> str:
    """Return the parameters that ran in the layout of ROS 2; the run can be repeated from it."""
    values = dict(run.parameters.values)
    if run.parameters.transforms:
        values["transforms"] = list(run.parameters.transforms)
    content = {run.parameters.node: {"ros__parameters": values}}
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
