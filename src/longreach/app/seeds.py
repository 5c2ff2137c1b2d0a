"""One experiment with many seeds, on all cores, and what its numbers have in common."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from joblib import Parallel, delayed

from longreach.evaluation.tables import Metric, metric

Metrics = Mapping[str, Mapping[str, Metric]]
Progress = Callable[[str, float], None]


def more_seeds(
    job: Callable[[int], Metrics], first: Metrics, seeds: range, tell: Progress
) -> tuple[dict[str, dict[str, Metric]], str]:
    """Run `job` with every seed but the first, whose metrics are known; return means and spreads, and a remark."""
    tell("more seeds", 0.0)
    runs = [first]
    for found in Parallel(n_jobs=-1, return_as="generator_unordered")(delayed(job)(seed) for seed in seeds[1:]):
        if found is not None:  # a task gives what its function does; the type says it may be nothing
            runs.append(found)
        tell("more seeds", len(runs) / len(seeds))
    return spread(runs), f"Numbers are means and standard deviations over {len(seeds)} seeds; figures show the first."


def spread(runs: Sequence[Metrics]) -> dict[str, dict[str, Metric]]:
    """Return mean, standard deviation (`…_std`) and largest (`…_max`) of each metric over runs."""
    found: dict[str, dict[str, Metric]] = {}
    for who, named in runs[0].items():
        found[who] = {}
        for name, one in named.items():
            values = np.array([np.nan if (v := r[who][name]["value"]) is None else v for r in runs], dtype=float)
            found[who][name] = metric(float(np.mean(values)), one["unit"])
            found[who][f"{name}_std"] = metric(float(np.std(values)), one["unit"])
            if not name.endswith("_max"):
                found[who][f"{name}_max"] = metric(float(np.max(values)), one["unit"])
    return found
