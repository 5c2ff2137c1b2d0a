"""Metrics as values with units, and the one table of them that both the report and the terminal show."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypedDict


class Metric(TypedDict):
    """One number of metrics.json; `value` is None where it is not known."""

    value: float | int | None
    unit: str


def metric(value: float | int, unit: str) -> Metric:
    """Return a metric that JSON can hold: NaN and infinity become None."""
    if isinstance(value, int):
        return {"value": value, "unit": unit}
    return {"value": float(value) if math.isfinite(value) else None, "unit": unit}


class Outcome(Metric):
    """Whether a run reached its end, 1 or 0, or over many runs the share that did; and why not."""

    reason: str


REACHED_END = "reached_end"  # the outcome's name among a run's metrics


def outcome(reason: str) -> Outcome:
    """Return the outcome of a run that did not reach its end for a reason; an empty one: it did."""
    return {"value": int(not reason), "unit": "", "reason": reason}


def failures(metrics: Mapping[str, Mapping[str, Metric]]) -> list[str]:
    """Return for each run that did not reach its end a sentence that says why."""
    reasons = {who: named.get(REACHED_END, {}).get("reason") for who, named in metrics.items()}
    return [f"{who} did not reach its end: {reason}" for who, reason in reasons.items() if reason]


@dataclass(frozen=True)
class Table:
    """Text in rows: a metric and its unit, then one column per trajectory or source."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


UNKNOWN = "–"
# What a newcomer wants to see first, best known reference first.
_MAIN = (
    "ate_rmse",
    "heading_rms",
    "final_position_error",
    "final_heading_error",
    "relations_5s_translation_mean",
    "relations_5s_rotation_mean",
    "relations_over_60s_translation_mean",
    "relations_over_60s_rotation_mean",
    "relations_translation_p99",
    "relations_rotation_p99",
    "nees_mean",
    "path_length",
    "keyframes",
    "closures_accepted",
    "closures_refused",
)
_NAMES = {
    "ate": "position error (ATE)",
    "heading": "heading error",
    "rpe": "relative error",
    "rmse": "RMSE",
    "rms": "RMS",
    "mse": "MSE",
    "std": "standard deviation",
    "max": "largest",
    "nees": "NEES",
    "nis": "NIS",
    "imu": "IMU",
    "lidar": "LIDAR",
    "lower": "lower 95 % bound",
    "upper": "upper 95 % bound",
    "p99": "99th percentile",
}


def label(name: str) -> str:
    """Return a metric's key as words: `rpe_5m_rotation_mean` → Relative error over 5 m, rotation mean."""
    words = []
    which = "up to" if name.startswith("relations") and "_over_" not in name else "over"
    for part in name.split("_"):
        length = re.fullmatch(r"(\d+(?:\.\d+)?)(m|s)", part)
        if part == "over":
            continue
        words.append(f"{which} {length[1]} {length[2]}," if length else _NAMES.get(part, part))
    text = " ".join(words).rstrip(",").replace("error error", "error")
    return text[:1].upper() + text[1:]


def _text(value: float | int | None) -> str:
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if isinstance(value, int):
        return str(value)
    if value != 0 and not 1e-4 <= abs(value) < 1e5:
        return f"{value:.2e}"
    digits = 3 if value == 0 else max(0, 3 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(digits, 5)}f}"


def main_metrics(metrics: Mapping[str, Mapping[str, Metric]]) -> dict[str, dict[str, Metric]]:
    """Return the few metrics that tell most, of those that are there."""
    return {who: {name: named[name] for name in _MAIN if name in named} for who, named in metrics.items()}


def metric_table(metrics: Mapping[str, Mapping[str, Metric]]) -> Table:
    """Lay out nested metrics, trajectory → name → metric: a row a name, in the order in which they first appear."""
    units = {name: m["unit"] for named in metrics.values() for name, m in named.items()}
    rows = []
    for name, unit in units.items():
        found = [named.get(name) for named in metrics.values()]
        rows.append((label(name), unit, *(UNKNOWN if m is None else _text(m["value"]) for m in found)))
    return Table(("metric", "unit", *metrics), tuple(rows))
