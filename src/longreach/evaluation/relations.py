"""The relations metric: errors of relative poses between stamps that somebody verified, without any alignment.

Source: Kümmerle et al. 2009, "On measuring the accuracy of SLAM algorithms".
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.evaluation.alignment import LONGEST_GAP
from longreach.evaluation.statistics import Statistics, statistics
from longreach.evaluation.tables import Metric, metric
from longreach.geometry import se2
from longreach.trajectory import PoseTrajectory


@dataclass(frozen=True, eq=False)
class RelationErrors:
    """Of each relation used: the time between its stamps [s], the errors of translation [m] and rotation [rad].

    skipped: how many relations could not be used, for the trajectory has no pose at one of their stamps.
    """

    span: Float[np.ndarray, " m"]
    translation: Float[np.ndarray, " m"]
    rotation: Float[np.ndarray, " m"]
    skipped: int = 0

    @property
    def used(self) -> int:
        """How many relations there are errors of."""
        return len(self.span)


@dataclass(frozen=True)
class RelationSummary:
    """Statistics of the translation [m] and the rotation [rad]."""

    translation: Statistics
    rotation: Statistics


def relation_errors(
    trajectory: PoseTrajectory,
    stamps_1: Float[np.ndarray, " k"],
    stamps_2: Float[np.ndarray, " k"],
    poses: Float[np.ndarray, "k 3"],
    longest_gap: float = LONGEST_GAP,
) -> RelationErrors:
    """Compare relative poses along the trajectory with those of the relations.

    Arguments:
        stamps_1, stamps_2: as recorded [s]; the trajectory is asked for its poses on its own, repaired clock.
        poses: the pose at stamps_2 as seen from that at stamps_1 [m, m, rad].
        longest_gap: between two rows of the trajectory that interpolation may bridge [s].
    """
    if len(trajectory) == 0:
        return RelationErrors(np.zeros(0), np.zeros(0), np.zeros(0), len(stamps_1))
    first, known_1 = trajectory.at(trajectory.clock_at(stamps_1), longest_gap)
    second, known_2 = trajectory.at(trajectory.clock_at(stamps_2), longest_gap)
    error = se2.between(poses, se2.between(first, second))
    known = known_1 & known_2
    span = np.abs(stamps_2 - stamps_1)
    translation = np.hypot(error[:, 0], error[:, 1])
    return RelationErrors(
        span[known], translation[known], np.abs(error[known, 2]), skipped=int(np.count_nonzero(~known))
    )


def up_to(errors: RelationErrors, longest_span: float) -> RelationErrors:
    """Return the errors of relations that span at most `longest_span` [s]."""
    short = errors.span <= longest_span
    return RelationErrors(errors.span[short], errors.translation[short], errors.rotation[short], errors.skipped)


def summary(errors: RelationErrors, longest_span: float | None = None) -> RelationSummary:
    """Return the statistics of all relations, or of those that span at most `longest_span` [s]."""
    if longest_span is not None:
        errors = up_to(errors, longest_span)
    return RelationSummary(statistics(errors.translation), statistics(errors.rotation))


def relation_metrics(errors: RelationErrors, longest_span: float | None = None) -> dict[str, Metric]:
    """Return the numbers of metrics.json, those of short relations as `relations_5s_…`; rotations in degrees."""
    s = summary(errors, longest_span)
    prefix = "relations" if longest_span is None else f"relations_{longest_span:g}s"
    found = {f"{prefix}_used": metric(s.translation.count, "")}
    if longest_span is None:
        found[f"{prefix}_skipped"] = metric(errors.skipped, "")
    for part in ("mean", "median", "std"):
        found[f"{prefix}_translation_{part}"] = metric(getattr(s.translation, part), "m")
    for part in ("mean", "median", "std"):
        found[f"{prefix}_rotation_{part}"] = metric(np.degrees(getattr(s.rotation, part)), "deg")
    return found


def long_relation_metrics(errors: RelationErrors, shortest_span: float = 60.0) -> dict[str, Metric]:
    """Return what shows loop closures: means of relations beyond a span [s], and the 99th percentile of all.

    One false closure hides in a mean over thousands of short relations, and shows here.
    """
    found, far = dict[str, Metric](), errors.span > shortest_span
    prefix = f"relations_over_{shortest_span:g}s"
    found[f"{prefix}_used"] = metric(int(np.count_nonzero(far)), "")
    for name, e, unit in (
        ("translation", errors.translation, "m"),
        ("rotation", np.degrees(errors.rotation), "deg"),
    ):
        if np.any(far):
            found[f"{prefix}_{name}_mean"] = metric(float(e[far].mean()), unit)
        if len(e):
            found[f"relations_{name}_p99"] = metric(float(np.percentile(e, 99)), unit)
    return found
