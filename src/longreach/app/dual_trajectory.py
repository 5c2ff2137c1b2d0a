"""The thesis' second experiment (6.2), simulated: the tool on a straight line, the base on a sinusoid beside it."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from pydantic import BaseModel, ConfigDict, Field

from longreach.app.execution import Execution, ExecutionConfig, execute, loop_metrics
from longreach.app.outputs import comparison_figures, estimate_figures, write_trajectories
from longreach.app.results import write_results
from longreach.app.seeds import first_run, more_seeds
from longreach.app.show import Show, show
from longreach.app.tracker import TrackerConfig
from longreach.configuration import ConfigurationTrajectory
from longreach.control.whole_body import WholeBodyConfig
from longreach.evaluation import execution_figures
from longreach.evaluation.execution import tool_metrics
from longreach.evaluation.report import CAPTIONS
from longreach.evaluation.tables import Metric
from longreach.io.bag_writer import write_bag
from longreach.io.config import to_yaml
from longreach.io.robots import load_robot
from longreach.io.tum import write_spatial_tum
from longreach.io.whole_files import whole_folder
from longreach.planning.planner import plan
from longreach.planning.reference import dual_trajectory
from longreach.planning.timing import eased
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.record import tool_truth
from longreach.trajectory import PoseTrajectory

Progress = Callable[[str, float], None]
Metrics = Mapping[str, Mapping[str, Metric]]
LOOPS = ("closed", "open")
MAIN = (
    "tool_error",
    "tool_error_final",
    "tool_estimate_error",
    "tool_tracking_error",
    "tool_straightness",
    "tool_height_error_max",
    "base_error",
    "error_correlation",
)
_ROOMY = 3.0  # a longer line does not fit into the laboratory [m]
PACE = 0.1  # of the tool along its line [m/s]: 2 m in 20 s


class DualTrajectoryConfig(BaseModel):
    """Settings of the experiment."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    robot: str = Field(default="thing", description="A robot that has physics.")
    seed: int = Field(default=0, ge=0, description="Of everything random.")
    seeds: int = Field(default=1, ge=1, description="How many runs, with seeds counted on from the first.")
    length: float = Field(default=2.0, gt=0, description="Of the tool's line [m]; the thesis' 2 m.")
    amplitude: float = Field(default=0.2, ge=0, description="Of the base's sinusoid [m]; the thesis' 0.2 m.")
    world: str | None = Field(default=None, description="null: the laboratory, or for a longer line the hall.")
    floor: str | float | None = Field(
        default=None, description="good, worn, wet, slippery, a friction; null: the world's."
    )
    video: bool = Field(default=False, description="Whether a film of the first run is written, drive.gif.")
    view: bool = Field(default=False, description="Whether a window shows it while it goes on.")

    def execution(self, seed: int, loop: str) -> ExecutionConfig:
        """Return how one run is executed."""
        world = self.world or ("laboratory" if self.length <= _ROOMY else "hall")
        tracker = TrackerConfig(whole_body=WholeBodyConfig.model_validate({"loop": loop}))
        return ExecutionConfig(seed=seed, world=world, floor=self.floor, tracker=tracker)


def planned(robot: MobileManipulator, config: DualTrajectoryConfig) -> tuple[Reference, ConfigurationTrajectory]:
    """Return the reference, and the plan of it by task priority from rest to rest."""
    q0 = robot.home
    swings = max(round(config.length / 2.0), 1)
    reference = dual_trajectory(
        robot.forward(q0),
        q0[robot.base],
        config.length,
        config.amplitude,
        periods=swings,
        waypoints=200 * swings,
        duration=config.length / PACE,
    )
    far = np.full(robot.base.stop, 2.0 * config.length)  # a base has no end stops, its description only says 10 m
    lower, upper = robot.lower.copy(), robot.upper.copy()
    lower[robot.base], upper[robot.base] = np.minimum(lower[robot.base], -far), np.maximum(upper[robot.base], far)
    return reference, eased(plan(robot.with_limits(lower, upper), reference, q0, iterations=20))


def execute_both(
    config: DualTrajectoryConfig, seed: int, tell: Progress, watch: Show | None = None
) -> dict[str, Execution]:
    """Execute the plan with the loop closed on the estimate, which `watch` shows, and open, in a process of its own."""
    robot = load_robot(config.robot)
    tell("planning", 0.0)
    reference, trajectory = planned(robot, config)
    if watch is not None and reference.tool is not None:
        watch.goal = reference.tool[:, :3, 3]
    beside: Any = Parallel(n_jobs=2, return_as="generator")(
        [delayed(execute)(robot, trajectory, config.execution(seed, "open"))]
    )
    closed = execute(robot, trajectory, config.execution(seed, "closed"), tell, watch)
    tell("driving, open loop", 0.0)
    return {"closed": closed, "open": next(beside)}


def metrics_of(runs: Mapping[str, Execution]) -> dict[str, dict[str, Metric]]:
    """Return what the runs are worth, and the base's trajectories of the first of them."""
    found = {loop: tool_metrics(run.traces) | loop_metrics(run) for loop, run in runs.items()}
    first = next(iter(runs.values()))
    return found | {name: dict(named) for name, named in first.estimate.metrics.items()}


def verdict(metrics: Metrics) -> str:
    """Return what the numbers say, in words."""
    mm = {loop: {name: 1e3 * (m["value"] or 0.0) for name, m in metrics[loop].items()} for loop in LOOPS}
    return (
        f"The hand was {mm['closed']['tool_error']:.1f} mm from where it should be, and "
        f"{mm['closed']['tool_estimate_error']:.1f} mm from where the robot thought it was (root mean square). With "
        f"the loop open it would have been {mm['open']['tool_error']:.1f} mm from where it should be."
    )


def _job(config: DualTrajectoryConfig, seed: int) -> Metrics:
    return metrics_of(execute_both(config, seed, lambda stage, fraction: None))


def run_dual_trajectory(config: DualTrajectoryConfig, out: Path, progress: Progress | None = None) -> Metrics:
    """Run the experiment once, or with many seeds at once on all cores, and write its folder."""
    tell = progress or (lambda stage, fraction: None)

    def shown_runs(seed: int) -> tuple[Mapping[str, Execution], Metrics, Show]:
        with show(config.video, config.view) as shown:
            runs = execute_both(config, seed, tell, shown)
        return runs, metrics_of(runs), shown

    seeds = range(config.seed, config.seed + config.seeds)
    (runs, metrics, shown), failed = first_run(shown_runs, seeds)
    remarks = [verdict(metrics)]
    remarks += [report.reason for report in runs["closed"].plan.reports if report.unmet.any()]
    remarks += runs["closed"].estimate.remarks
    if config.seeds > 1:
        metrics, remark = more_seeds(partial(_job, config), metrics, failed, seeds, tell)
        remarks.append(remark)
    introduction = (
        f"The {config.robot}'s tool draws a straight line of {config.length:g} m while its base goes along a sinusoid "
        "beside it, with physics: wheels with rollers, which slip, and an arm that has weight.\n\nclosed: the arm "
        "takes up what the base does wrong, as far as the estimate knows of it; open: nobody looks."
    )
    traces = {f"{loop} loop": run.traces for loop, run in runs.items()}
    drawn = {
        "tool_and_base": lambda: execution_figures.tool_and_base(runs["closed"].traces),
        "tool_errors": lambda: execution_figures.tool_errors(traces),
    }
    estimated = runs["closed"].estimate
    drawn |= comparison_figures(estimated.evaluation) | estimate_figures(estimated)
    with whole_folder(out) as folder:
        tell("writing", 0.0)
        write_executions(folder, runs)
        shown.write(folder)
        main = {loop: {name: metrics[loop][name] for name in MAIN} for loop in LOOPS}
        write_results(
            folder, "Dual trajectory", introduction, metrics, drawn, to_yaml(config), tell, remarks,
            CAPTIONS | execution_figures.EXECUTION_CAPTIONS, main,
        )  # fmt: skip
    return metrics


def write_executions(folder: Path, runs: Mapping[str, Execution]) -> None:
    """Write the first run's trajectories, and of each run a recording with its plan and the tool's paths.

    Of the runs after the first, the files' names end with the run's.
    """
    first = next(iter(runs.values()))
    write_trajectories(folder, first.estimate.trajectories)
    with np.load(folder / "covariance.npz") as known:
        arrays = dict(known)
    for name, run in runs.items():
        end = "" if run is first else f"_{name}"
        t = run.traces
        for what in ("reference", "estimate", "truth"):
            write_spatial_tum(folder / f"tool_{what}{end}.tum", t.stamps, getattr(t, f"tool_{what}"))
        arrays |= {f"tool_estimate{end}_stamps": t.stamps, f"tool_estimate{end}_covariance": t.tool_covariance}
        rows = run.run.rows
        online = PoseTrajectory(np.array([r.stamp for r in rows]), np.array([r.pose for r in rows]))
        write_bag(
            folder / f"recording{end}.mcap", run.recording, run.robot.description,
            plan=run.plan, estimate=online, tool={"truth": tool_truth(run.truths)},
        )  # fmt: skip
    np.savez_compressed(folder / "covariance.npz", **arrays)
