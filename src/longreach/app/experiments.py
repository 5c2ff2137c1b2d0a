"""The experiments by their names."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import BaseModel

from longreach.app import dual_trajectory, localization, manipulability
from longreach.app.seeds import Metrics
from longreach.evaluation.tables import Metric, main_metrics


class Experiment(NamedTuple):
    """Its settings, the rooms whose kernels it needs, how it is run, what of its metrics is shown first, and said."""

    config: type[BaseModel]
    rooms: tuple[str, ...]
    run: Callable[[Any, Path, Callable[[str, float], None] | None], Metrics]
    main: Callable[[Metrics], Mapping[str, Mapping[str, Metric]]]
    verdict: Callable[[Metrics], str]


def _named(names: tuple[str, ...], runs: tuple[str, ...]) -> Callable[[Metrics], Mapping[str, Mapping[str, Metric]]]:
    return lambda metrics: {run: {name: metrics[run][name] for name in names if name in metrics[run]} for run in runs}


EXPERIMENTS: Mapping[str, Experiment] = {
    "localization": Experiment(
        localization.LocalizationConfig,
        ("estimation",),
        localization.run_localization,
        main_metrics,
        localization.verdict,
    ),
    "dual-trajectory": Experiment(
        dual_trajectory.DualTrajectoryConfig,
        ("estimation", "kinematics", "task priority", "control", "sim"),
        dual_trajectory.run_dual_trajectory,
        _named(dual_trajectory.MAIN, dual_trajectory.LOOPS),
        dual_trajectory.verdict,
    ),
    "manipulability": Experiment(
        manipulability.ManipulabilityConfig,
        ("estimation", "kinematics", "task priority", "sqp", "control", "sim"),
        manipulability.run_manipulability,
        _named(manipulability.MAIN, manipulability.PLANS),
        manipulability.verdict,
    ),
}
