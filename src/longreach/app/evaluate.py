"""How good trajectories are: every metric that the references at hand allow."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.app.configuration import EvaluationConfig
from longreach.errors import LongreachError, RecordingError
from longreach.estimation.planar.state import Correction
from longreach.evaluation import metrics as errors
from longreach.evaluation.alignment import associate
from longreach.evaluation.consistency import Consistency, PoseErrors, consistency_metrics, nees, nis, pose_errors
from longreach.evaluation.glitches import drop_glitches
from longreach.evaluation.relations import RelationErrors, relation_errors, relation_metrics
from longreach.evaluation.tables import Metric, metric
from longreach.geometry import se2
from longreach.io.relations import read_relations
from longreach.io.trajectory_file import has_stamps, read_poses, stamped_like
from longreach.io.tum import read_tum
from longreach.measurement import RelativePoseMeasurement
from longreach.trajectory import PoseTrajectory

Metrics = Mapping[str, Mapping[str, Metric]]
Progress = Callable[[str, float], None]


class Relations(NamedTuple):
    """Relative reference poses (k, 3) [m, m, rad] between stamps as recorded, (k,) each [s]."""

    stamps_1: Float[np.ndarray, " k"]
    stamps_2: Float[np.ndarray, " k"]
    poses: Float[np.ndarray, "k 3"]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Trajectories, `truth` among them where there is one, what they are worth, and what there is to say about it."""

    trajectories: Mapping[str, PoseTrajectory]
    metrics: Metrics
    relation_errors: Mapping[str, RelationErrors]
    config: EvaluationConfig
    remarks: tuple[str, ...] = ()


def evaluate(
    trajectories: Mapping[str, PoseTrajectory],
    truth: PoseTrajectory | None = None,
    relations: Relations | None = None,
    config: EvaluationConfig | None = None,
) -> Evaluation:
    """Compare each trajectory with the references: path length, ATE, RPE, final errors, NEES, relations, as known."""
    config = config or EvaluationConfig()
    remarks: tuple[str, ...] = ()
    if truth is not None:
        truth, remarks = _cleaned(truth, config)
    metrics, compared = {}, {}
    for name, trajectory in trajectories.items():
        if len(trajectory) < 2:
            continue
        metrics[name] = {"path_length": metric(path_length(trajectory), "m")}
        if truth is not None:
            metrics[name] |= against_truth(trajectory, truth, config, on_map=name == "localized")
        if relations is not None:
            e = compared[name] = relation_errors(trajectory, *relations, longest_gap=config.longest_gap)
            metrics[name] |= relation_metrics(e, config.relations_span) | relation_metrics(e)
    if relations is not None and not any(e.used for e in compared.values()):
        raise LongreachError("No relation has both stamps within the trajectories; are they of this recording?")
    known = dict(trajectories) if truth is None else {**trajectories, "truth": truth}
    return Evaluation(known, metrics, compared, config, remarks)


def evaluate_files(
    estimate: Path,
    truth: Path | None,
    relations: Path | None,
    progress: Progress,
    assume: Mapping[str, str] | None = None,
) -> Evaluation:
    """Read and compare a file, or all trajectories in the folder of an estimate; its own truth unless one is given.

    A file of KITTI has no stamps: without times.txt beside it, it takes those of what it is compared with, line by
    line.

    Arguments: assume: as `read_poses` takes it, for the files that are named.

    Raises:
        LongreachError: there is nothing to compare, or nothing to compare with.
    """
    progress("reading", 0.0)
    trajectories, remarks = _read_estimate(estimate, assume)
    reference = trajectories.pop("truth", None)
    if truth is not None:
        reference, said = read_poses(truth, assume=assume)
        remarks += said
        trajectories, reference, said = _with_stamps(estimate, trajectories, truth, reference)
        remarks += said
    if reference is None and relations is None:
        raise LongreachError(f"There is nothing to compare {estimate} with; give --truth or --relations.")
    progress("evaluation", 0.0)
    compared = Relations(*read_relations(relations)) if relations is not None else None
    found = evaluate(trajectories, reference, compared)
    return replace(found, remarks=(*remarks, *found.remarks))


def _with_stamps(
    estimate: Path, trajectories: dict[str, PoseTrajectory], truth: Path, reference: PoseTrajectory
) -> tuple[dict[str, PoseTrajectory], PoseTrajectory, tuple[str, ...]]:
    """Give poses without stamps those of the other file, line by line; where neither has any, the numbers of lines."""
    has_own = estimate.is_dir() or has_stamps(estimate)
    if has_own and has_stamps(truth):
        return trajectories, reference, ()
    bare, other = (truth, estimate) if has_own else (estimate, truth)
    if bare is truth:
        known = next((path for path in trajectories.values() if len(path) == len(reference)), None)
        matched = None if known is None else stamped_like(reference, known)
        reference = reference if matched is None else matched
    else:
        ((name, path),) = trajectories.items()
        matched = stamped_like(path, reference)
        trajectories = {name: path if matched is None else matched}
    if matched is None:
        raise RecordingError(
            f"The poses of KITTI in {bare} have no stamps, and {other} has not as many poses; put their times.txt "
            f"beside {bare.name}."
        )
    taken = f"those of {other.name}" if has_own or has_stamps(truth) else "the numbers of lines"
    return trajectories, reference, (f"{bare.name}: poses of KITTI have no stamps; {taken} are taken, line by line.",)


def _read_estimate(path: Path, assume: Mapping[str, str] | None) -> tuple[dict[str, PoseTrajectory], tuple[str, ...]]:
    if not path.is_dir():
        read, remarks = read_poses(path, assume=assume)
        return {"estimate" if path.stem == "truth" else path.stem: read}, remarks
    found = {file.stem: read_tum(file) for file in sorted(path.glob("*.tum")) if not file.stem.startswith("tool")}
    if not set(found) - {"truth"}:
        raise LongreachError(f"{path} holds no trajectories (*.tum).")
    covariances = path / "covariance.npz"
    if covariances.is_file():
        with np.load(covariances) as arrays:
            for name, trajectory in found.items():
                P = arrays.get(f"{name}_covariance")
                if P is not None and P.shape == (len(trajectory), 3, 3):
                    found[name] = replace(trajectory, covariance=P)
    order = ["fused", "localized", "smoothed", "wheels", "lidar"]  # the order of all tables and legends
    rank = {name: order.index(name) if name in order else 9 for name in found}
    return {name: found[name] for name in sorted(found, key=lambda name: (rank[name], name))}, ()


def path_length(trajectory: PoseTrajectory) -> float:
    """Return the length of the way [m]."""
    return float(np.linalg.norm(np.diff(trajectory.poses[:, :2], axis=0), axis=1).sum())


def against_truth(
    trajectory: PoseTrajectory, truth: PoseTrajectory, config: EvaluationConfig, on_map: bool = False
) -> dict[str, Metric]:
    """Return ATE; with headings also RPE, the mean squared errors of figure 6.3, and NEES where there is covariance.

    on_map: the trajectory is in the truth's frame, where its NEES is taken.
    """
    pairs = associate(trajectory, truth, config.longest_gap)
    found = errors.absolute_metrics(errors.ate(pairs, config.align))
    if not pairs.has_heading:
        return found
    found |= errors.relative_metrics(errors.rpe_over_distance(pairs, config.distances), "m")
    found |= errors.relative_metrics(errors.rpe_over_time(pairs, config.times), "s")
    squared = errors.mse_over_time(pairs, "none" if config.align == "none" else "first")
    assert squared.heading is not None
    assert squared.heading_mean is not None
    found["position_mse"] = metric(float(squared.position_mean[-1]), "m²")
    found["heading_mse"] = metric(float(squared.heading_mean[-1]), "rad²")
    found["final_position_error"] = metric(float(np.sqrt(squared.position[-1])), "m")
    found["final_heading_error"] = metric(float(np.degrees(np.sqrt(squared.heading[-1]))), "deg")
    if pairs.covariance is not None:
        found |= consistency_metrics("nees", nees(pose_errors(pairs, config.align != "none" and not on_map)))
    return found


def _cleaned(truth: PoseTrajectory, config: EvaluationConfig) -> tuple[PoseTrajectory, tuple[str, ...]]:
    """Return the reference without jumps that no robot makes, and a remark where there were any."""
    kept, dropped = drop_glitches(truth, config.truth_speed)
    if not dropped:
        return truth, ()
    remark = (
        f"{dropped} of {len(truth)} rows of the reference jump faster than {config.truth_speed:g} m/s; they were left "
        "out of the comparison."
    )
    return kept, (remark,)


def innovations(corrections: Sequence[Correction]) -> Mapping[str, Consistency]:
    """Return the normalised innovations squared by source."""
    return nis(
        np.array([c.stamp for c in corrections]),
        [c.source for c in corrections],
        np.array([c.nis for c in corrections]),
        [c.dof for c in corrections],
    )


def match_consistency(matches: Sequence[RelativePoseMeasurement], truth: PoseTrajectory) -> Consistency:
    """Return the NEES of relative poses against the truth; those that it does not cover are skipped and counted.

    The truth must be denser than the matches, else interpolating it is itself in error.
    """
    first, known_1 = truth.at(truth.clock_at(np.array([m.stamp_reference for m in matches])), 0.2)
    second, known_2 = truth.at(truth.clock_at(np.array([m.stamp for m in matches])), 0.2)
    known = known_1 & known_2
    xi = se2.difference(np.array([m.pose for m in matches]), se2.between(first, second))
    e = PoseErrors(np.array([m.stamp for m in matches]), xi, np.array([m.covariance for m in matches]))
    found = nees(PoseErrors(e.clock[known], e.xi[known], e.covariance[known]))
    return Consistency(found.clock, found.values, found.dof, found.skipped + int(np.count_nonzero(~known)))
