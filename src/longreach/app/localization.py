"""The thesis' first experiment (6.1), simulated: fast erratic driving, and where each set of sensors says it was."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, field_validator

from longreach.app.configuration import EstimateConfig, EvaluationConfig
from longreach.app.estimate import Estimate, estimate
from longreach.app.evaluate import Evaluation, Metrics, evaluate
from longreach.app.outputs import comparison_figures, estimate_figures, write_trajectories
from longreach.app.results import write_results
from longreach.app.seeds import first_run, more_seeds
from longreach.app.show import Show, show
from longreach.evaluation.tables import REACHED_END, outcome
from longreach.io.bag_writer import write_bag
from longreach.io.config import to_yaml
from longreach.io.robots import load_robot
from longreach.io.whole_files import whole_folder
from longreach.localization.config import Source
from longreach.measurement import Recording
from longreach.sim.long_drive import TOP_SPEED, long_drive, tucked, ways_of
from longreach.sim.physics import Simulation
from longreach.sim.record import make_recording, record, steered
from longreach.sim.simulated import Simulated
from longreach.sim.worlds import load_world

Progress = Callable[[str, float], None]
LABORATORY = "laboratory"

# What is fused in each estimate: figure 6.2 has wheels alone, LIDAR alone, and both.
VARIANTS: Mapping[str, tuple[Source, ...] | None] = {
    "fused": None,
    "wheels_lidar": ("wheels", "lidar"),
    "wheels_imu": ("wheels", "imu"),
}
_COMPARED = (
    "position_mse",
    "heading_mse",
    "final_position_error",
    "final_heading_error",
    "ate_rmse",
    "nees_mean",
    REACHED_END,
)


class LocalizationConfig(BaseModel):
    """Settings of the experiment."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    robot: str = Field(default="thing", description="A robot that has physics.")
    seed: int = Field(default=0, ge=0, description="Of everything random.")
    seeds: int = Field(default=1, ge=1, description="How many runs, with seeds counted on from the first.")
    duration: float = Field(default=120.0, ge=1.0, description="Of the drive [s]; the thesis' 120 s.")
    world: str = Field(default="laboratory", description="There it drives erratically; else along the world's ways.")
    floor: str | float | None = Field(
        default=None, description="good, worn, wet, slippery, or a coefficient of friction; as the world says."
    )
    video: bool = Field(default=False, description="Whether a film of the first run is written, drive.gif.")
    view: bool = Field(default=False, description="Whether a window shows it while it goes on.")

    @field_validator("world")
    @classmethod
    def _check_ways(cls, world: str) -> str:
        if world != LABORATORY:
            ways_of(load_world(world))
        return world


@dataclass(frozen=True, eq=False)
class Localization:
    """One run: what was recorded, the estimate from all sensors, and all estimates held against the truth.

    metrics: the evaluation's, with the outcome of the drive beside those of the estimate from all sensors.
    """

    recording: Recording
    fused: Estimate
    evaluation: Evaluation
    metrics: Metrics


def localize(
    config: LocalizationConfig, seed: int, progress: Progress | None = None, watch: Show | None = None
) -> Localization:
    """Drive, record, and estimate from each set of sensors; the truth is for comparison alone."""
    tell = progress or (lambda stage, fraction: None)
    robot = load_robot(config.robot)
    tell("simulation", 0.0)
    hit = ""

    def driven(simulation: Simulated) -> None:
        nonlocal hit
        hit = simulation.hit
        if watch is not None:
            watch(simulation)

    if config.world == LABORATORY:
        recording = make_recording(robot, seed=seed, duration=config.duration, floor=config.floor, watch=driven)
    else:
        world = load_world(config.world)
        simulation = Simulation(robot, world, seed=seed, floor=config.floor, q=tucked(robot))
        rate = simulation.capabilities.base_rate
        motion = long_drive(world, TOP_SPEED * config.duration, seed, rate)
        recording = record(simulation, steered(simulation, motion), config.duration, driven)
    none = EvaluationConfig(align="none")
    estimates = {}
    for i, (name, sources) in enumerate(VARIANTS.items()):
        tell("estimation", i / len(VARIANTS))
        estimates[name] = estimate(recording, robot, EstimateConfig(sources=sources, evaluation=none))
    fused = estimates["fused"]
    paths = {name: e.trajectories["fused"] for name, e in estimates.items()}
    paths |= {name: fused.trajectories[name] for name in ("wheels", "lidar")}
    evaluation = evaluate(paths, recording.truth, config=none)
    metrics = {**evaluation.metrics, "fused": {**evaluation.metrics["fused"], REACHED_END: outcome(hit)}}
    return Localization(recording, fused, evaluation, metrics)


def run_localization(config: LocalizationConfig, out: Path, progress: Progress | None = None) -> Metrics:
    """Run the experiment once, or with many seeds at once on all cores, and write its folder."""
    tell = progress or (lambda stage, fraction: None)

    def shown_run(seed: int) -> tuple[Localization, Show]:
        with show(config.video, config.view) as shown:
            return localize(config, seed, tell, shown if config.video or config.view else None), shown

    seeds = range(config.seed, config.seed + config.seeds)
    (first, shown), failed = first_run(shown_run, seeds)
    metrics = first.metrics
    remarks = list(first.evaluation.remarks)
    if config.seeds > 1:
        metrics, remark = more_seeds(partial(_metrics, config), _compared(metrics), failed, seeds, tell)
        remarks.append(remark)
    _write(config, first, metrics, remarks, out, tell, shown)
    return metrics


def verdict(metrics: Metrics) -> str:
    """Return what the numbers say, in words."""
    off = {who: metrics[who]["final_position_error"]["value"] or 0.0 for who in ("fused", "wheels", "lidar")}
    return (
        f"At the end the fused estimate was {off['fused']:.3f} m from the truth, the wheels {off['wheels']:.3f} m "
        f"and the LIDAR {off['lidar']:.3f} m."
    )


def _metrics(config: LocalizationConfig, seed: int) -> Metrics:
    return _compared(localize(config, seed).metrics)


def _compared(metrics: Metrics) -> Metrics:
    """Return the summary of many seeds."""
    return {who: {name: named[name] for name in _COMPARED if name in named} for who, named in metrics.items()}


def _write(
    config: LocalizationConfig,
    run: Localization,
    metrics: Metrics,
    remarks: Sequence[str],
    out: Path,
    tell: Progress,
    shown: Show,
) -> None:
    how = "fast and erratically" if config.world == LABORATORY else "from place to place"
    floor = "" if config.floor is None else f"on a floor called {config.floor}, "
    introduction = (
        f"The {run.fused.robot.name} drives {how} through the world {config.world} for {config.duration:g} s, "
        f"{floor}with physics: wheels with rollers, which slip.\n\nfused: wheels, LIDAR, IMU; "
        "wheels_lidar and wheels_imu: without the third; wheels: integrated; lidar: alone."
    )
    with whole_folder(out) as folder:
        tell("writing", 0.0)
        write_bag(folder / "recording.mcap", run.recording, run.fused.robot)
        write_trajectories(folder, run.evaluation.trajectories)
        shown.write(folder)
        drawn = comparison_figures(run.evaluation) | estimate_figures(run.fused)
        write_results(folder, "Localization", introduction, metrics, drawn, to_yaml(config), tell, remarks)
