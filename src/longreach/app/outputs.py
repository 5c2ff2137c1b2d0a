"""What a run leaves behind: trajectories, covariances, metrics, the settings that ran, figures and one page.

Everything is made in a temporary folder first and then put in its place: a run that fails or is interrupted leaves
nothing half-written.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from longreach.app.estimate import Estimate, Progress, sensor_mount
from longreach.app.evaluate import Evaluation, innovations
from longreach.app.results import write_results
from longreach.evaluation import figures, scan_map
from longreach.evaluation.alignment import align_pairs, associate, moved
from longreach.evaluation.consistency import pose_errors
from longreach.evaluation.metrics import mse_over_time
from longreach.evaluation.relations import RelationErrors
from longreach.io.config import to_yaml
from longreach.io.tum import write_tum
from longreach.io.whole_files import whole_folder
from longreach.measurement import RelativePoseMeasurement
from longreach.trajectory import PoseTrajectory

_MOST_SCANS = 4000  # laid into the map: more darken it, and add nothing


def write_estimate(estimate: Estimate, out: str | Path, progress: Progress | None = None) -> None:
    """Write what docs/outputs.md names into a folder, which is made if it is not there."""
    tell = progress or (lambda stage, fraction: None)
    config = to_yaml(estimate.config)
    e = estimate.evaluation
    with whole_folder(Path(out)) as folder:
        write_trajectories(folder, e.trajectories)
        _write_matches(folder / "lidar_matches.npz", estimate)
        (folder / "robot.yaml").write_text(to_yaml(estimate.robot), encoding="utf-8")
        drawn = comparison_figures(e) | estimate_figures(estimate)
        title = f"Estimate of {estimate.recording.name}"
        write_results(folder, title, _introduction(estimate), e.metrics, drawn, config, tell, e.remarks)


def _introduction(estimate: Estimate) -> str:
    r = estimate.recording
    held = {"wheel records": r.wheels, "scans": r.scans, "IMU readings": r.imu, "absolute fixes": r.fixes}
    counted = ", ".join(f"{len(records)} {name}" for name, records in held.items() if records)
    return f"Robot {estimate.robot.name}: {counted}."


def write_evaluation(evaluation: Evaluation, out: Path, progress: Progress | None = None) -> None:
    """Write metrics, figures and a page of trajectories that were held against a reference."""
    tell = progress or (lambda stage, fraction: None)
    with whole_folder(out) as folder:
        introduction, config = f"Trajectories: {', '.join(evaluation.trajectories)}.", to_yaml(evaluation.config)
        e, drawn = evaluation, comparison_figures(evaluation)
        write_results(folder, "Evaluation", introduction, e.metrics, drawn, config, tell, e.remarks)


def write_trajectories(folder: Path, trajectories: Mapping[str, PoseTrajectory]) -> None:
    """Write a TUM file each, and covariance.npz, into a folder that is there."""
    arrays = {}
    for name, trajectory in trajectories.items():
        write_tum(folder / f"{name}.tum", trajectory)
        if trajectory.covariance is not None:
            arrays[f"{name}_stamps"] = trajectory.stamps
            arrays[f"{name}_covariance"] = trajectory.covariance
    np.savez_compressed(folder / "covariance.npz", **arrays)


def _write_matches(path: Path, estimate: Estimate) -> None:
    """Write every match as the filter got it, stamps as recorded."""
    found = estimate.lidar_measurements
    if not found:
        return
    as_recorded = estimate.recording.as_recorded
    np.savez_compressed(
        path,
        stamp_keyframe=as_recorded(np.array([m.stamp_reference for m in found])),
        stamp=as_recorded(np.array([m.stamp for m in found])),
        relative=np.array([m.pose for m in found]),
        covariance=np.array([m.covariance for m in found]),
        degenerate=np.array([is_degenerate(m) for m in found]),
    )


def is_degenerate(match: RelativePoseMeasurement) -> bool:
    """Whether a scan matcher could tell less than 1 m or 1 rad in some direction."""
    return bool(np.linalg.eigvalsh(match.covariance)[-1] > 1.0)


def comparison_figures(evaluation: Evaluation) -> dict[str, Callable[[], Figure]]:
    """Return how to draw what compares trajectories with each other and with the references."""
    trajectories, truth = evaluation.trajectories, evaluation.trajectories.get("truth")
    drawn: dict[str, Callable[[], Figure]] = {"paths": lambda: figures.paths(_in_one_frame(evaluation))}
    compared = {name: t for name, t in trajectories.items() if name != "truth"}
    if truth is not None:
        config = evaluation.config
        pairs = {name: associate(t, truth, config.longest_gap) for name, t in compared.items()}
        headings = all(p.has_heading for p in pairs.values())
        align = config.align if config.align == "none" else "first" if headings else "rigid"
        squared = {name: mse_over_time(p, align) for name, p in pairs.items()}
        drawn["squared_errors"] = lambda: figures.squared_errors(squared)
        fused = pairs.get("fused")
        if fused is not None and fused.has_heading and fused.covariance is not None:
            drawn["error_bounds"] = lambda: figures.error_with_bounds(pose_errors(fused, config.align != "none"))
    if evaluation.relation_errors:
        drawn["relations"] = lambda: figures.relation_distributions(_nonempty(evaluation.relation_errors))
    return drawn


def _nonempty(errors: Mapping[str, RelationErrors]) -> dict[str, RelationErrors]:
    return {name: e for name, e in errors.items() if e.used}


def estimate_figures(estimate: Estimate) -> dict[str, Callable[[], Figure]]:
    """Return how to draw what only a whole estimation knows: the scan map and the innovations."""
    drawn: dict[str, Callable[[], Figure]] = {}
    nis = innovations(estimate.corrections)
    if nis:
        drawn["innovation"] = lambda: figures.innovation(nis)
    scans: Sequence = estimate.recording.scans
    if scans:
        fused, mount = estimate.trajectories["fused"], sensor_mount(estimate.recording, estimate.robot, "lidar")
        some = scans[:: max(1, len(scans) // _MOST_SCANS)]
        drawn["scan_map"] = lambda: scan_map.scan_map(fused, scan_map.scan_points(fused, some, mount))
    return drawn


def _in_one_frame(evaluation: Evaluation) -> dict[str, PoseTrajectory]:
    """Carry the trajectories to the truth as ATE does; without one, all start where they start."""
    truth = evaluation.trajectories.get("truth")
    if truth is None:
        return dict(evaluation.trajectories)
    carried = {}
    for name, trajectory in evaluation.trajectories.items():
        if name != "truth":
            _, motion = align_pairs(
                associate(trajectory, truth, evaluation.config.longest_gap), evaluation.config.align
            )
            trajectory = moved(trajectory, motion)
        carried[name] = trajectory
    return carried
