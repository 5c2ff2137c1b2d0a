"""Plan a reference and write what came of it: the trajectory, its figures, its numbers."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pydantic import BaseModel, ConfigDict, Field

from longreach.app.results import write_results
from longreach.configuration import ConfigurationTrajectory
from longreach.evaluation import plan_figures, planning_figures
from longreach.evaluation.tables import Metric, metric
from longreach.io.config import to_yaml
from longreach.io.plan_files import write_trajectory_csv, write_trajectory_mcap
from longreach.io.tum import write_spatial_tum, write_tum
from longreach.io.whole_files import whole_folder
from longreach.planning.planner import plan
from longreach.planning.problem import Problem
from longreach.planning.reference import dual_trajectory
from longreach.planning.sqp_solution import OptimisedTrajectory
from longreach.planning.terms_pose import BaseDisc, BaseHeading
from longreach.planning.thesis_problem import thesis_problem
from longreach.planning.timing import retime
from longreach.reference import Reference
from longreach.robot.manipulability import manipulability
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.trajectory import PoseTrajectory

Progress = Callable[[str, float], None]
DUAL = "dual-trajectory"
_SIX = 6  # fewer joints cannot turn and move the tool in all directions: they have no manipulability


class PlanConfig(BaseModel):
    """Settings of one plan."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    method: str = Field(default="task-priority", description="The planner.")
    iterations: int | None = Field(
        default=None, ge=1, description="At most so many [1]; null: 20 a waypoint by task priority, 60 by sqp."
    )
    coupled: bool = Field(default=True, description="By sqp: all waypoints at once, or each by itself.")
    length: float = Field(default=2.0, gt=0, description="Of the dual trajectory's line [m]; the thesis' 2 m.")
    amplitude: float = Field(default=0.2, ge=0, description="Of its base's sinusoid [m]; the thesis' 0.2 m.")
    waypoints: int = Field(default=200, ge=2, description="Of the dual trajectory [1].")
    duration: float = Field(default=20.0, gt=0, description="Of the dual trajectory [s]; 0.1 m/s over 2 m.")
    retime: bool = Field(default=False, description="Whether to go as fast as the joints' limits allow.")


@dataclass(frozen=True, eq=False)
class Planned:
    """A plan, what it was asked to follow, and what it is worth.

    followed: the plan waypoint by waypoint, with its reports; trajectory: the same, or its path as fast as can be.
    """

    robot: MobileManipulator
    reference: Reference
    config: PlanConfig
    followed: ConfigurationTrajectory
    trajectory: ConfigurationTrajectory
    metrics: dict[str, dict[str, Metric]]
    remarks: tuple[str, ...]
    problem: Problem | None = None


def make_plan(
    robot: MobileManipulator,
    reference: Reference | None,
    config: PlanConfig | None = None,
    progress: Progress | None = None,
    problem: Problem | None = None,
    **options: Any,
) -> Planned:
    """Plan a reference, None: the dual trajectory, from the robot's home; problem: of sqp, (4.34) where None."""
    config = config or PlanConfig()
    tell = progress or (lambda stage, fraction: None)
    q0 = robot.home
    if reference is None:
        reference = dual_trajectory(
            robot.forward(q0),
            q0[:3] if robot.base.stop else None,
            config.length,
            config.amplitude,
            waypoints=config.waypoints,
            duration=config.duration,
        )
    tell("planning", 0.0)
    by_sqp = config.method == "sqp"
    if by_sqp:
        options = {"coupled": config.coupled, "problem": problem or thesis_problem()} | options
    iterations = config.iterations or (60 if by_sqp else 20)
    followed = plan(robot, reference, q0, method=config.method, iterations=iterations, **options)
    trajectory, metrics = followed, {"plan": _metrics(robot, followed)}
    remarks = tuple(report.reason for report in followed.reports)
    if config.retime:
        tell("timing", 0.0)
        trajectory = retime(followed, robot.limits.velocity, robot.limits.acceleration)
        metrics["retimed"] = _metrics(robot, trajectory)
    return Planned(robot, reference, config, followed, trajectory, metrics, remarks, options.get("problem"))


def _metrics(robot: MobileManipulator, trajectory: ConfigurationTrajectory) -> dict[str, Metric]:
    found = {"duration": metric(trajectory.duration, "s"), "waypoints": metric(len(trajectory), "")}
    for report in trajectory.reports:
        found[f"{report.name}_position_error_max"] = metric(float(report.linear.max()), "m")
        found[f"{report.name}_position_error_mean"] = metric(float(report.linear.mean()), "m")
        found[f"{report.name}_angle_error_max"] = metric(float(report.angular.max()), "rad")
        found[f"{report.name}_unmet"] = metric(int(report.unmet.sum()), "")
    steps = np.abs(np.diff(trajectory.q, axis=0))
    share = np.abs(trajectory.velocities) / robot.limits.velocity
    found["joint_step_max"] = metric(float(steps.max(initial=0.0)), "rad or m")
    found["speed_share_max"] = metric(100 * float(share.max()), "%")
    if robot.dof >= _SIX:
        m, _ = manipulability(robot, trajectory.q)
        found["manipulability_mean"] = metric(float(m.mean()), "m³")
        found["manipulability_min"] = metric(float(m.min()), "m³")
    return found


def write_plan(planned: Planned, out: Path, progress: Progress | None = None) -> None:
    """Write trajectory.csv and .mcap, references and planned paths as TUM, figures, metrics and the page."""
    tell = progress or (lambda stage, fraction: None)
    robot, reference, trajectory = planned.robot, planned.reference, planned.trajectory
    tool = robot.forward(trajectory.q)
    base = trajectory.q[:, robot.base]
    with whole_folder(out) as folder:
        write_trajectory_csv(folder / "trajectory.csv", trajectory)
        write_trajectory_mcap(folder / "trajectory.mcap", trajectory)
        write_spatial_tum(folder / "tool_plan.tum", trajectory.stamps, tool)
        if reference.tool is not None:
            write_spatial_tum(folder / "tool_reference.tum", reference.stamps, reference.tool)
        if base.shape[1] == 3:
            write_tum(folder / "base_plan.tum", PoseTrajectory(trajectory.stamps, base))
        if reference.base is not None:
            write_tum(folder / "base_reference.tum", PoseTrajectory(reference.stamps, reference.base))
        config = to_yaml(planned.config)
        introduction = (
            f"Robot {robot.name}, tool {robot.tool}, by {planned.config.method}; {len(trajectory)} configurations over "
            f"{trajectory.duration:.1f} s."
        )
        write_results(
            folder, "Plan", introduction, planned.metrics, _figures(planned, tool, base), config, tell,
            captions=plan_figures.PLAN_CAPTIONS, remarks=planned.remarks,
        )  # fmt: skip


def _figures(planned: Planned, tool: np.ndarray, base: np.ndarray) -> dict[str, Callable[[], Figure]]:
    robot, reference, trajectory = planned.robot, planned.reference, planned.trajectory
    tool_reference = None if reference.tool is None else reference.tool[:, :2, 3]
    base_reference = None if reference.base is None else reference.base[:, :2]
    own = base[:, :2] if base.shape[1] == 3 else None
    drawn: dict[str, Callable[[], Figure]] = {
        "paths": lambda: plan_figures.plan_paths(tool[:, :2, 3], tool_reference, own, base_reference),
        "joints": lambda: plan_figures.joints(trajectory, robot.prismatic.tolist()),
        "velocities": lambda: plan_figures.velocities(trajectory, robot.limits.velocity),
    }
    if robot.dof >= _SIX:
        m, _ = manipulability(robot, trajectory.q)
        drawn["manipulability"] = lambda: plan_figures.manipulability(trajectory.stamps, {"plan": m})
    if isinstance(planned.followed, OptimisedTrajectory) and tool_reference is not None and base_reference is not None:
        drawn |= _optimised(planned, planned.followed)
    if planned.followed.reports:
        drawn["task_errors"] = lambda: plan_figures.task_errors(planned.followed.stamps, planned.followed.reports)
    return drawn


def _optimised(planned: Planned, optimised: OptimisedTrajectory) -> dict[str, Callable[[], Figure]]:
    """Return how to draw figure 6.5, beside the plan that optimises nothing, and how the optimisation converged."""
    robot, reference = planned.robot, planned.reference
    base = reference.base
    assert base is not None
    plans = {"optimised": optimised.q, "not optimised": plan(robot, reference, robot.home).q}
    measures = {name: manipulability(robot, q)[0] for name, q in plans.items()}
    bases = {name: q[:, robot.base] for name, q in plans.items()}
    tools = {name: robot.forward(q)[:, :3, 3] for name, q in plans.items()}
    constraints = planned.problem.constraints if planned.problem is not None else ()
    radius = max([0.0, *(c.radius for c in constraints if isinstance(c, BaseDisc))])
    band = max([0.0, *(c.band for c in constraints if isinstance(c, BaseHeading))])
    return {
        "optimised": lambda: planning_figures.optimised_against_not(measures, bases, tools, base, radius, band),
        "convergence": lambda: planning_figures.convergence(optimised.solution.history),
    }
