"""Errors of an estimate against the truth: absolute (ATE), relative (RPE), and squared over time."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from longreach.evaluation.alignment import Align, Pairs, align_pairs, need_heading
from longreach.evaluation.statistics import Statistics, statistics
from longreach.evaluation.tables import Metric, metric
from longreach.geometry import se2

_ROUNDING = 1e-6  # [m] or [s]: what a sum of steps, or a difference of stamps since 1970, may be off


@dataclass(frozen=True, eq=False)
class AbsoluteErrors:
    """Of each pair: the distance between the positions [m], and the heading's error [rad] (None: not known).

    alignment: the rigid motion that was applied to the estimate first.
    """

    clock: Float[np.ndarray, " n"]
    position: Float[np.ndarray, " n"]
    heading: Float[np.ndarray, " n"] | None
    alignment: Float[np.ndarray, "3"]


@dataclass(frozen=True, eq=False)
class RelativeErrors:
    """Of each stretch, rows `start` to `end`: the error [m], [rad] of the pose at its end as seen from its start."""

    start: Int[np.ndarray, " m"]
    end: Int[np.ndarray, " m"]
    translation: Float[np.ndarray, " m"]
    rotation: Float[np.ndarray, " m"]


@dataclass(frozen=True, eq=False)
class SquaredErrors:
    """Squared errors over time, position [m²] and heading [rad²], and their means over all rows so far (MSE)."""

    clock: Float[np.ndarray, " n"]
    position: Float[np.ndarray, " n"]
    heading: Float[np.ndarray, " n"] | None
    position_mean: Float[np.ndarray, " n"]
    heading_mean: Float[np.ndarray, " n"] | None


def ate(pairs: Pairs, align: Align = "rigid") -> AbsoluteErrors:
    """Return the absolute trajectory error.

    Source: Sturm et al. 2012, "A benchmark for the evaluation of RGB-D SLAM systems"; the heading's error is ours.
    """
    aligned, motion = align_pairs(pairs, align)
    position = np.linalg.norm(aligned.estimate[:, :2] - aligned.truth[:, :2], axis=1)
    heading = se2.between(aligned.truth, aligned.estimate)[:, 2] if pairs.has_heading else None
    return AbsoluteErrors(aligned.clock, position, heading, motion)


def stretches(
    along: Float[np.ndarray, " n"], length: float, tolerance: float = 0.1, all_pairs: bool = True
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Cut rows into stretches of a length; return the rows where they start and end.

    all_pairs: from every row to the later row whose distance is nearest to the length, if it is off by at most
    tolerance · length; of rows at one place the first. Otherwise end to end: each goes to the first row that is at
    least the length away. Both rules are evo's.

    Arguments: along: where each row is [m] or [s], never decreasing; length: in the same unit.
    """
    n = len(along)
    if all_pairs:
        start = np.arange(n)
        beyond = np.searchsorted(along, along + length)
        before = np.searchsorted(along, along[np.maximum(beyond - 1, 0)])  # the first of equal rows
        miss = np.abs(along[np.minimum(beyond, n - 1)] - along - length)
        miss[beyond == n] = np.inf
        miss_before = np.where(before > start, np.abs(along[before] - along - length), np.inf)
        end = np.where(miss_before <= miss, before, beyond)
        good = np.minimum(miss, miss_before) <= tolerance * length
        return start[good], end[good]
    cuts = [0] if n else []
    while cuts and (row := int(np.searchsorted(along, along[cuts[-1]] + length - _ROUNDING))) < n:
        cuts.append(max(row, cuts[-1] + 1))
    cuts = np.array([c for c in cuts if c < n], dtype=int)
    return cuts[:-1], cuts[1:]


def relative_errors(pairs: Pairs, start: Int[np.ndarray, " m"], end: Int[np.ndarray, " m"]) -> RelativeErrors:
    """Return the errors of the estimate's poses at rows `end` as seen from rows `start`."""
    need_heading(pairs, "compare relative poses")
    truth = se2.between(pairs.truth[start], pairs.truth[end])
    error = se2.between(truth, se2.between(pairs.estimate[start], pairs.estimate[end]))
    return RelativeErrors(start, end, np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2]))


def rpe_over_distance(
    pairs: Pairs, lengths: Iterable[float], tolerance: float = 0.1, all_pairs: bool = True
) -> dict[float, RelativeErrors]:
    """Return the relative pose errors over stretches of the lengths [m], measured along the truth's path."""
    steps = np.linalg.norm(np.diff(pairs.truth[:, :2], axis=0), axis=1)
    path = np.concatenate((np.zeros(min(len(pairs), 1)), np.cumsum(steps)))
    return {x: relative_errors(pairs, *stretches(path, x, tolerance, all_pairs)) for x in lengths}


def rpe_over_time(
    pairs: Pairs, spans: Iterable[float], tolerance: float = 0.1, all_pairs: bool = True
) -> dict[float, RelativeErrors]:
    """Return the relative pose errors over the time spans [s]."""
    time = pairs.clock - pairs.clock[:1]
    return {x: relative_errors(pairs, *stretches(time, x, tolerance, all_pairs)) for x in spans}


def mse_over_time(pairs: Pairs, align: Align = "first") -> SquaredErrors:
    """Return what figure 6.3 draws: the squared errors, and their mean from the start to each row."""
    errors = ate(pairs, align)
    rows = np.arange(1.0, len(pairs) + 1.0)
    position = errors.position**2
    heading = None if errors.heading is None else errors.heading**2
    heading_mean = None if heading is None else np.cumsum(heading) / rows
    return SquaredErrors(errors.clock, position, heading, np.cumsum(position) / rows, heading_mean)


def absolute_metrics(errors: AbsoluteErrors) -> dict[str, Metric]:
    """Return the numbers of metrics.json for the absolute errors; headings in degrees."""
    s = statistics(errors.position)
    found = {"pairs": metric(s.count, "")}
    found |= {f"ate_{name}": metric(value, "m") for name, value in _four(s).items()}
    if errors.heading is not None:
        found["heading_rms"] = metric(np.degrees(statistics(errors.heading).rmse), "deg")
    return found


def relative_metrics(errors: Mapping[float, RelativeErrors], unit: str) -> dict[str, Metric]:
    """Return the numbers of metrics.json for relative errors over distance (unit m) or time (unit s)."""
    found = {}
    for length, e in errors.items():
        for name, values, of, scale in (
            ("translation", e.translation, "m", 1.0),
            ("rotation", e.rotation, "deg", 180 / np.pi),
        ):
            s = statistics(values)
            for part, value in (("mean", s.mean), ("median", s.median), ("rmse", s.rmse)):
                found[f"rpe_{length:g}{unit}_{name}_{part}"] = metric(scale * value, of)
    return found


def _four(s: Statistics) -> dict[str, float]:
    return {"rmse": s.rmse, "mean": s.mean, "median": s.median, "max": s.maximum}
