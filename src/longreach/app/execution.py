"""A plan executed by a simulated robot, recorded, and held against what really happened."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from longreach.app.configuration import EvaluationConfig
from longreach.app.estimate import Estimate, estimate
from longreach.app.tool_state import tool_state
from longreach.app.tracker import Run, Tick, TrackerConfig, run
from longreach.configuration import ConfigurationTrajectory
from longreach.evaluation.execution import Traces
from longreach.evaluation.tables import REACHED_END, Metric, metric, outcome
from longreach.measurement import Recording
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.motion import Truth
from longreach.sim.physics import Simulation
from longreach.sim.record import recorded
from longreach.sim.simulated import Simulated

Progress = Callable[[str, float], None]
_NEAR = 0.02  # so near to the plan's end is there, by the robot's own estimate [m]; ten times the thesis' error, ours


class ExecutionConfig(BaseModel):
    """Where and how a plan is executed."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    seed: int = Field(default=0, ge=0, description="Of everything random.")
    world: str = Field(default="laboratory", description="A shipped world, or a YAML file.")
    floor: str | float | None = Field(
        default=None, description="good, worn, wet, slippery, a friction; null: the world's."
    )
    tracker: TrackerConfig = TrackerConfig()


@dataclass(frozen=True, eq=False)
class Execution:
    """What was done: plan, run and recording, what `estimate` makes of that, and the traces of tool and base.

    failure: why the robot did not come to the plan's end as it should, in sentences; empty where it did.
    """

    robot: MobileManipulator
    plan: ConfigurationTrajectory
    run: Run
    recording: Recording
    truths: list[Truth]
    estimate: Estimate
    traces: Traces
    failure: str


def execute(
    robot: MobileManipulator,
    plan: ConfigurationTrajectory,
    config: ExecutionConfig,
    progress: Progress | None = None,
    watch: Callable[[Simulated], None] | None = None,
) -> Execution:
    """Drive the simulated robot along the plan, from the plan's first row; the truth is for comparison alone.

    watch: called with the simulation after each tick.
    """
    tell = progress or (lambda stage, fraction: None)
    q = plan.q[0]
    simulation = Simulation(robot, config.world, seed=config.seed, floor=config.floor, q=q)
    loop = config.tracker.whole_body.loop

    def ticked(tick: Tick, part: float) -> None:
        tell(f"driving, {loop} loop", part)
        if watch is not None:
            watch(simulation)

    done = run(
        simulation,
        lambda stamp: simulation.advance(max(stamp - simulation.stamp, 0.0)),
        robot,
        plan,
        q[robot.base],
        config.tracker,
        ticked,
    )
    truths = simulation.truths()
    recording = recorded(done.readings, truths, f"{simulation.world.name}-{config.seed}", robot.description)
    settings = config.tracker.estimate.model_copy(update={"evaluation": EvaluationConfig(align="none")})
    replayed = estimate(recording, robot, settings, progress=tell)
    traces = _traces(robot, done, truths)
    reasons = [simulation.hit, done.reason, _short_of_end(robot, plan, done) if loop == "closed" else ""]
    return Execution(robot, plan, done, recording, truths, replayed, traces, " ".join(filter(None, reasons)))


def _short_of_end(robot: MobileManipulator, plan: ConfigurationTrajectory, done: Run) -> str:
    """Return how far from the plan's end the robot itself thinks that its tool is; nothing where it is near."""
    away = float(np.linalg.norm(robot.forward(done.ticks[-1].q)[:3, 3] - robot.forward(plan.q[-1])[:3, 3]))
    return "" if away <= _NEAR else f"The tool ended {away:.2f} m away from the plan's end."


def _traces(robot: MobileManipulator, done: Run, truths: list[Truth]) -> Traces:
    """Return all at the stamps of the truth while the reference moves; where it never does, all of the time."""
    t = np.array([tick.stamp for tick in done.ticks])
    goals = np.array([tick.q_reference for tick in done.ticks])
    moving = np.flatnonzero(np.any(np.diff(goals, axis=0) != 0.0, axis=1))
    begin, end = (t[moving[0]], t[moving[-1] + 1]) if len(moving) else (t[0], t[-1])
    known = [truth for truth in truths if begin <= truth.stamp <= end] or truths[-1:]
    stamps = np.array([truth.stamp for truth in known])
    q_reference = _at(stamps, t, goals)
    q = _at(stamps, t, np.array([tick.q for tick in done.ticks]))
    P = np.array([_nearest(done.ticks, t, stamp).covariance for stamp in stamps.tolist()])
    T, J = robot.forward_and_jacobian_batch(q)
    spread = [tool_state(q[i, :3], P[i], T[i], J[i]).covariance for i in range(len(q))]
    return Traces(
        stamps,
        robot.forward(q_reference),
        T,
        np.array([truth.tool for truth in known]),
        q_reference[:, robot.base],
        q[:, robot.base],
        np.array([truth.base for truth in known]),
        np.array(spread),
        P,
    )


def _at(stamps: np.ndarray, t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return configurations between the ticks'."""
    q = q.copy()
    q[:, 2] = np.unwrap(q[:, 2])
    return np.stack([np.interp(stamps, t, column) for column in q.T], axis=1)


def _nearest(ticks, t: np.ndarray, stamp: float) -> Tick:
    return ticks[min(int(np.searchsorted(t, stamp)), len(t) - 1)]


def loop_metrics(execution: Execution) -> dict[str, Metric]:
    """Return whether the plan's end was reached, how fast the loop was, and how far a replay's estimate is from its."""
    busy, fused = execution.run.ticker.busy, execution.estimate.trajectories["fused"]
    row_of = {row.stamp: row.pose for row in execution.run.rows}
    apart = [
        np.abs(row_of[s] - pose).max()
        for s, pose in zip(fused.stamps.tolist(), fused.poses, strict=True)
        if s in row_of
    ]
    return {
        REACHED_END: outcome(execution.failure),
        "tick_median": metric(1e3 * busy.percentile(50), "ms"),
        "tick_p99": metric(1e3 * busy.percentile(99), "ms"),
        "ticks": metric(execution.run.ticker.ticks, ""),
        "late_ticks": metric(execution.run.ticker.late, ""),
        "replay_difference_max": metric(max(apart, default=np.nan), "m"),
    }
