"""How good trajectories are: every metric that the references at hand allow."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.app.configuration import EvaluationConfig
from longreach.estimation.fusion import Correction
from longreach.evaluation import metrics as errors
from longreach.evaluation.alignment import associate
from longreach.evaluation.consistency import Consistency, PoseErrors, consistency_metrics, nees, nis, pose_errors
from longreach.evaluation.glitches import drop_glitches
from longreach.evaluation.relations import relation_errors, relation_metrics
from longreach.evaluation.tables import Metric, metric
from longreach.geometry import se2
from longreach.measurement import RelativePoseMeasurement
from longreach.trajectory import PoseTrajectory

Metrics = Mapping[str, Mapping[str, Metric]]


class Relations(NamedTuple):
    """Relative reference poses (k, 3) [m, m, rad] between stamps as recorded, (k,) each [s]."""

    stamps_1: Float[np.ndarray, " k"]
    stamps_2: Float[np.ndarray, " k"]
    poses: Float[np.ndarray, "k 3"]


def evaluate(
    trajectories: Mapping[str, PoseTrajectory],
    truth: PoseTrajectory | None,
    relations: Relations | None,
    config: EvaluationConfig | None = None,
) -> dict[str, dict[str, Metric]]:
    """Return the metrics of each trajectory: path length, ATE, RPE, final errors, NEES, relations, as far as known."""
    config = config or EvaluationConfig()
    found = {}
    for name, trajectory in trajectories.items():
        if name == "truth" or len(trajectory) < 2:
            continue
        one = {"path_length": metric(path_length(trajectory), "m")}
        if truth is not None:
            one |= against_truth(trajectory, truth, config)
        if relations is not None:
            e = relation_errors(trajectory, *relations, longest_gap=config.longest_gap)
            one |= relation_metrics(e, config.relations_span) | relation_metrics(e)
        found[name] = one
    return found


def path_length(trajectory: PoseTrajectory) -> float:
    """Return the length of the way [m]."""
    return float(np.linalg.norm(np.diff(trajectory.poses[:, :2], axis=0), axis=1).sum())


def against_truth(trajectory: PoseTrajectory, truth: PoseTrajectory, config: EvaluationConfig) -> dict[str, Metric]:
    """Return ATE; with headings also RPE, the mean squared errors of figure 6.3, and NEES where there is covariance."""
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
        found |= consistency_metrics("nees", nees(pose_errors(pairs, config.align != "none")))
    return found


def cleaned_truth(truth: PoseTrajectory, config: EvaluationConfig) -> tuple[PoseTrajectory, tuple[str, ...]]:
    """Return the reference without jumps that no robot makes, and a remark where there were any."""
    kept, dropped = drop_glitches(truth, config.truth_speed)
    if not dropped:
        return truth, ()
    return kept, (f"{dropped} of {len(truth)} rows of the reference jump faster than {config.truth_speed:g} m/s; "
                  "they were left out of the comparison.",)  # fmt: skip


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
