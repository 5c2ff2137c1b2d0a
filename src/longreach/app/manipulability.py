"""The thesis' third experiment (6.3), simulated: a plan optimised for manipulability, and one that is not, executed."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.figure import Figure
from pydantic import BaseModel, ConfigDict, Field

from longreach.app.dual_trajectory import PACE, write_executions
from longreach.app.execution import Execution, ExecutionConfig, execute, loop_metrics
from longreach.app.results import write_results
from longreach.app.seeds import first_run, more_seeds
from longreach.app.show import Show, show
from longreach.evaluation import execution_figures, planning_figures
from longreach.evaluation.execution import tool_metrics
from longreach.evaluation.tables import Metric, metric
from longreach.io.config import to_yaml
from longreach.io.robots import load_robot
from longreach.io.whole_files import whole_folder
from longreach.planning.planner import plan
from longreach.planning.reference import dual_trajectory
from longreach.planning.thesis_problem import thesis_problem
from longreach.planning.timing import eased
from longreach.robot.manipulability import Measure, manipulability

Progress = Callable[[str, float], None]
Metrics = Mapping[str, Mapping[str, Metric]]
PLANS = ("optimised", "not optimised")
MAIN = (
    "objective_mean",
    "objective_better",
    "manipulability_mean",
    "manipulability_better",
    "base_off_max",
    "base_heading_off_max",
    "tool_error",
)


class ManipulabilityConfig(BaseModel):
    """Settings of the experiment."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    robot: str = Field(default="thing", description="A robot that has physics.")
    seed: int = Field(default=0, ge=0, description="Of everything random.")
    seeds: int = Field(default=1, ge=1, description="How many runs, with seeds counted on from the first.")
    objective: Literal["sqrt_kappa_over_m", "neg_log_m"] = Field(
        default="sqrt_kappa_over_m", description="What is made small: (4.33), or -log M."
    )
    length: float = Field(default=2.0, gt=0, description="Of the tool's line [m]; the thesis' 2 m.")
    base_radius: float = Field(default=0.01, gt=0, description="How far the base may be off [m]; the thesis' 1 cm.")
    heading_band: float = Field(default=0.1, gt=0, description="And how far its heading [rad]; the thesis' 0.1.")
    world: str = Field(default="laboratory", description="A shipped world, or a YAML file.")
    floor: str | float | None = Field(
        default=None, description="good, worn, wet, slippery, a friction; null: the world's."
    )
    video: bool = Field(default=False, description="Whether a film of the first run is written, drive.gif.")
    view: bool = Field(default=False, description="Whether a window shows it while it goes on.")


def execute_both(
    config: ManipulabilityConfig, seed: int, tell: Progress, watch: Show | None = None
) -> dict[str, Execution]:
    """Execute the optimised plan and the one that is not; both of the same reference, from their own first rows."""
    robot = load_robot(config.robot)
    q0 = robot.home
    T, base = robot.forward(q0), q0[robot.base]
    reference = dual_trajectory(T, base, config.length, duration=config.length / PACE)
    problem = thesis_problem(config.base_radius, config.heading_band, objective=config.objective)
    tell("planning", 0.0)
    plans = {
        "optimised": plan(robot, reference, q0, method="sqp", problem=problem),
        "not optimised": plan(robot, reference, q0, iterations=20),
    }
    setting = ExecutionConfig(seed=seed, world=config.world, floor=config.floor)
    if watch is not None and reference.tool is not None:
        watch.goal = reference.tool[:, :3, 3]
    shown = {"optimised": watch, "not optimised": None}
    return {name: execute(robot, eased(found), setting, tell, shown[name]) for name, found in plans.items()}


def measures(runs: Mapping[str, Execution], measure: Measure) -> dict[str, np.ndarray]:
    """Return a measure of manipulability of what was really done, at the same stamps for all runs."""
    t = next(iter(runs.values())).traces.stamps
    found = {}
    for name, run in runs.items():
        known = {truth.stamp: truth.q for truth in run.truths}
        q = np.array([known[stamp] for stamp in run.traces.stamps.tolist()])
        found[name] = np.interp(t, run.traces.stamps, manipulability(run.robot, q, measure)[0])
    return found


def metrics_of(config: ManipulabilityConfig, runs: Mapping[str, Execution]) -> dict[str, dict[str, Metric]]:
    """Return what both runs are worth, and at which part of the samples the optimised one is better."""
    M = measures(runs, "m")
    f = {k: -np.log(v) for k, v in M.items()}
    if config.objective == "sqrt_kappa_over_m":
        f = measures(runs, config.objective)
    found = {name: tool_metrics(run.traces) | loop_metrics(run) for name, run in runs.items()}
    unit = "" if config.objective == "neg_log_m" else "m^-1.5"
    reference = runs["not optimised"].traces
    for name, run in runs.items():
        t = run.traces
        goal = np.stack([np.interp(t.stamps, reference.stamps, c) for c in reference.base_reference.T], axis=1)
        off = t.base_truth - goal
        heading = np.remainder(off[:, 2] + np.pi, 2 * np.pi) - np.pi
        found[name] |= {
            "objective_mean": metric(float(f[name].mean()), unit),
            "manipulability_mean": metric(float(M[name].mean()), "m³"),
            "base_off_max": metric(float(np.linalg.norm(off[:, :2], axis=1).max()), "m"),
            "base_heading_off_max": metric(float(np.abs(heading).max()), "rad"),
        }
    better, nimbler = f["optimised"] < f["not optimised"], M["optimised"] > M["not optimised"]
    found["optimised"] |= {
        "objective_better": metric(100.0 * float(better.mean()), "%"),
        "manipulability_better": metric(100.0 * float(nimbler.mean()), "%"),
    }
    return found


def verdict(metrics: Metrics) -> str:
    """Return what the numbers say, in words."""
    better = metrics["optimised"]["objective_better"]["value"]
    off = 1e3 * (metrics["optimised"]["base_off_max"]["value"] or 0.0)
    return f"The optimised motion was better in {better:.1f} % of the time; its base was {off:.1f} mm off at most."


def _job(config: ManipulabilityConfig, seed: int) -> Metrics:
    return metrics_of(config, execute_both(config, seed, lambda stage, fraction: None))


def run_manipulability(config: ManipulabilityConfig, out: Path, progress: Progress | None = None) -> Metrics:
    """Run the experiment once, or with many seeds at once on all cores, and write its folder."""
    tell = progress or (lambda stage, fraction: None)

    def shown_runs(seed: int) -> tuple[Mapping[str, Execution], Metrics, Show]:
        with show(config.video, config.view) as shown:
            runs = execute_both(config, seed, tell, shown)
        return runs, metrics_of(config, runs), shown

    seeds = range(config.seed, config.seed + config.seeds)
    (runs, metrics, shown), failed = first_run(shown_runs, seeds)
    remarks = []
    if config.seeds > 1:
        metrics, remark = more_seeds(partial(_job, config), metrics, failed, seeds, tell)
        remarks.append(remark)
    introduction = (
        f"The {config.robot} executes two plans of the dual trajectory: one by task priority, and one by sequential "
        f"convex optimisation of {config.objective}, whose base may be {config.base_radius:g} m and "
        f"{config.heading_band:g} rad off."
    )
    traces = {name: run.traces for name, run in runs.items()}
    drawn = {
        "executed": lambda: _figure(config, runs),
        "tool_and_base": lambda: execution_figures.tool_and_base(traces["optimised"]),
        "tool_errors": lambda: execution_figures.tool_errors(traces),
    }
    with whole_folder(out) as folder:
        tell("writing", 0.0)
        shown.write(folder)
        write_executions(folder, {name.replace(" ", "_"): run for name, run in runs.items()})
        main = {name: {key: metrics[name][key] for key in MAIN if key in metrics[name]} for name in PLANS}
        write_results(
            folder, "Manipulability", introduction, metrics, drawn, to_yaml(config), tell, remarks,
            execution_figures.EXECUTION_CAPTIONS, main,
        )  # fmt: skip
    return metrics


def _figure(config: ManipulabilityConfig, runs: Mapping[str, Execution]) -> Figure:
    """Draw figure 6.5 of what was really done; both runs at the stamps of the one that is not optimised."""
    names = tuple(runs)
    traces = {name: run.traces for name, run in runs.items()}
    n = min(len(t.stamps) for t in traces.values())
    shown = {name: M[:n] for name, M in measures(runs, "m").items()}
    return planning_figures.optimised_against_not(
        shown,
        {name: traces[name].base_truth[:n] for name in names},
        {name: traces[name].tool_truth[:n, :3, 3] for name in names},
        traces["not optimised"].base_reference[:n],
        config.base_radius,
        config.heading_band,
        times=traces["not optimised"].stamps[:n],
    )
