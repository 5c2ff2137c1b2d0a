"""How well a plan was executed: where the tool should be, was thought to be, and was."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.evaluation.tables import Metric, metric


@dataclass(frozen=True, eq=False)
class Traces:
    """Tool (n, 4, 4) and base (n, 3) at the same stamps (n,) [s]: as planned, as estimated, and as they were.

    tool_covariance (n, 6, 6) of the tool's ξ = log(estimate⁻¹ · truth) = [v; ω]; base_covariance (n, 3, 3), the base's.
    """

    stamps: Float[np.ndarray, " n"]
    tool_reference: Float[np.ndarray, "n 4 4"]
    tool_estimate: Float[np.ndarray, "n 4 4"]
    tool_truth: Float[np.ndarray, "n 4 4"]
    base_reference: Float[np.ndarray, "n 3"]
    base_estimate: Float[np.ndarray, "n 3"]
    base_truth: Float[np.ndarray, "n 3"]
    tool_covariance: Float[np.ndarray, "n 6 6"]
    base_covariance: Float[np.ndarray, "n 3 3"]


def tool_metrics(traces: Traces) -> dict[str, Metric]:
    """Return what the executed motion is worth; errors of position are root mean squares over its time.

    tool_error: truth from plan; estimate_error: truth from estimate; tracking_error: estimate from plan; straightness:
    truth from its own best line; correlation: of the tool's and the base's error of estimation in the ground plane.
    """
    reference, estimate, truth = (T[:, :3, 3] for T in (traces.tool_reference, traces.tool_estimate, traces.tool_truth))
    base = traces.base_truth - traces.base_estimate
    return {
        "tool_error": metric(_rms(truth - reference), "m"),
        "tool_error_final": metric(float(np.linalg.norm(truth[-1] - reference[-1])), "m"),
        "tool_estimate_error": metric(_rms(truth - estimate), "m"),
        "tool_tracking_error": metric(_rms(estimate - reference), "m"),
        "tool_straightness": metric(straightness(truth), "m"),
        "tool_height_error_max": metric(float(np.abs(truth - reference)[:, 2].max()), "m"),
        "base_error": metric(_rms((traces.base_truth - traces.base_reference)[:, :2]), "m"),
        "base_estimate_error": metric(_rms(base[:, :2]), "m"),
        "error_correlation": metric(correlation((truth - estimate)[:, :2], base[:, :2]), ""),
    }


def _rms(e: Float[np.ndarray, "n k"]) -> float:
    return float(np.sqrt(np.mean(np.sum(e * e, axis=1))))


def straightness(p: Float[np.ndarray, "n 3"]) -> float:
    """Return the root mean square distance [m] of points from the line that fits them best."""
    away = p - p.mean(axis=0)
    return float(np.sqrt(np.sum(np.linalg.svd(away, compute_uv=False)[1:] ** 2) / len(p)))


def correlation(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]) -> float:
    """Return the correlation of two errors in the plane: Σ a·b / √(Σ a·a Σ b·b), about 0 and not about their means.

    An error that stands still is an error, too.
    """
    size = np.sqrt(np.sum(a * a) * np.sum(b * b))
    return float(np.sum(a * b) / size) if size > 0 else 0.0
