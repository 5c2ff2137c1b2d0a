"""One experiment with many seeds, on all cores, and what its numbers have in common."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from longreach.evaluation.tables import REACHED_END, Metric, Outcome, metric

Metrics = Mapping[str, Mapping[str, Metric]]
Progress = Callable[[str, float], None]


def more_seeds(
    job: Callable[[int], Metrics], first: Metrics, seeds: range, tell: Progress
) -> tuple[dict[str, dict[str, Metric]], str]:
    """Run `job` with every seed but the first, whose metrics are known; return means and spreads, and a remark."""
    tell("more seeds", 0.0)
    runs = {seeds[0]: first}
    jobs = [delayed(_with_seed)(job, seed) for seed in seeds[1:]]
    for found in Parallel(n_jobs=-1, return_as="generator_unordered")(jobs):
        if found is not None:  # a task gives what its function does; the type says it may be nothing
            runs[found[0]] = found[1]
        tell("more seeds", len(runs) / len(seeds))
    remark = f"Numbers are means and standard deviations over {len(seeds)} seeds; figures show the first."
    return spread({seed: runs[seed] for seed in seeds}), remark


def _with_seed(job: Callable[[int], Metrics], seed: int) -> tuple[int, Metrics]:
    return seed, job(seed)


def spread(runs: Mapping[int, Metrics]) -> dict[str, dict[str, Metric]]:
    """Return mean, standard deviation (`…_std`) and largest (`…_max`) of each metric over runs, given by their seeds.

    Of the outcome it is the share of the runs that reached their end, and why the others did not.
    """
    found: dict[str, dict[str, Metric]] = {}
    for who, named in next(iter(runs.values())).items():
        found[who] = {}
        for name, one in named.items():
            if name == REACHED_END:
                found[who][name] = _outcomes({seed: run[who][name] for seed, run in runs.items()})
                continue
            values = [np.nan if (v := r[who][name]["value"]) is None else v for r in runs.values()]
            found[who][name] = metric(float(np.mean(values)), one["unit"])
            found[who][f"{name}_std"] = metric(float(np.std(values)), one["unit"])
            if not name.endswith("_max"):
                found[who][f"{name}_max"] = metric(float(np.max(values)), one["unit"])
    return found


def _outcomes(of: Mapping[int, Any]) -> Outcome:
    """Return the outcomes of many runs, given by their seeds, as one."""
    failed = {seed: one["reason"] for seed, one in of.items() if one["reason"]}
    reasons = [f"{len(failed)} of {len(of)} runs.", *(f"Seed {seed}: {reason}" for seed, reason in failed.items())]
    return {"value": 1.0 - len(failed) / len(of), "unit": "", "reason": " ".join(reasons) if failed else ""}
