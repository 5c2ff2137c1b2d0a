"""One experiment with many seeds, on all cores, and what its numbers have in common."""

import logging
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np
from joblib import Parallel, delayed

from longreach.errors import LongreachError
from longreach.evaluation.tables import REACHED_END, Metric, Outcome, metric, outcome

_LOG = logging.getLogger("longreach")
_T = TypeVar("_T")
_ALIKE = 3  # seeds that fail for one reason: then it is not the seed; ours
Metrics = Mapping[str, Mapping[str, Metric]]
Progress = Callable[[str, float], None]


def first_run(run: Callable[[int], _T], seeds: range) -> tuple[_T, dict[int, str]]:
    """Return what the first seed gives that raises no error, and the reasons of the seeds before it.

    Raises:
        Exception: every seed raises one, or three give the same reason; this is the first of them.
    """
    first, failed = None, {}
    for seed in seeds:
        try:
            return run(seed), failed
        except Exception as error:  # of the others the text alone is kept: an error holds all that its run computed
            first, failed[seed] = first or error, _reason(error)
        if list(failed.values()).count(failed[seed]) == _ALIKE:
            break
    assert first is not None
    raise first


def more_seeds(
    job: Callable[[int], Metrics], first: Metrics, failed: Mapping[int, str], seeds: range, tell: Progress
) -> tuple[dict[str, dict[str, Metric]], str]:
    """Run `job` with the other seeds; return means and spreads, and a remark.

    A seed that raises an error counts as a run that has not reached its end; the others' numbers are kept.

    Arguments: first, failed: the metrics of the first seed that ran, and why those before it did not.
    """
    tell("more seeds", 0.0)
    shown, failed = seeds[len(failed)], dict(failed)
    runs = {shown: first}
    jobs = [delayed(_with_seed)(job, seed) for seed in seeds[len(failed) + 1 :]]
    for found in Parallel(n_jobs=-1, return_as="generator_unordered")(jobs):
        if found is not None:  # a task gives what its function does; the type says it may be nothing
            seed, metrics = found
            if isinstance(metrics, str):
                failed[seed] = metrics
            else:
                runs[seed] = metrics
        tell("more seeds", (len(runs) + len(failed)) / len(seeds))
    many = f"{len(runs)} of {len(seeds)}" if failed else f"{len(seeds)}"
    remark = f"Numbers are means and standard deviations over {many} seeds; figures show seed {shown}."
    return spread({seed: runs[seed] for seed in sorted(runs)}, failed), remark


def _with_seed(job: Callable[[int], Metrics], seed: int) -> tuple[int, Metrics | str]:
    """Return a seed and its metrics, or why there are none."""
    try:
        return seed, job(seed)
    except Exception as error:
        return seed, _reason(error)


def _reason(error: Exception) -> str:
    """Return why a run raised an error, as a sentence where it is one of ours."""
    _LOG.debug("A run has raised an error.", exc_info=error)
    return str(error) if isinstance(error, LongreachError) else f"{type(error).__name__}: {error}."


def spread(runs: Mapping[int, Metrics], failed: Mapping[int, str] | None = None) -> dict[str, dict[str, Metric]]:
    """Return mean, standard deviation (`…_std`) and largest (`…_max`) of each metric over runs, given by their seeds.

    Of the outcome it is the share of the runs that reached their end, and why the others did not; failed: the seeds
    of runs that raised an error, with the reason.
    """
    errors = {seed: outcome(reason) for seed, reason in (failed or {}).items()}
    found: dict[str, dict[str, Metric]] = {}
    for who, named in next(iter(runs.values())).items():
        found[who] = {}
        for name, one in named.items():
            if name == REACHED_END:
                found[who][name] = _outcomes({seed: run[who][name] for seed, run in runs.items()} | errors)
                continue
            values = [np.nan if (v := r[who][name]["value"]) is None else v for r in runs.values()]
            found[who][name] = metric(float(np.mean(values)), one["unit"])
            found[who][f"{name}_std"] = metric(float(np.std(values)), one["unit"])
            if not name.endswith("_max"):
                found[who][f"{name}_max"] = metric(float(np.max(values)), one["unit"])
    return found


def _outcomes(of: Mapping[int, Any]) -> Outcome:
    """Return the outcomes of many runs, given by their seeds, as one."""
    failed = {seed: one["reason"] for seed, one in sorted(of.items()) if one["reason"]}
    reasons = [f"{len(failed)} of {len(of)} runs.", *(f"Seed {seed}: {reason}" for seed, reason in failed.items())]
    return {"value": 1.0 - len(failed) / len(of), "unit": "", "reason": " ".join(reasons) if failed else ""}
