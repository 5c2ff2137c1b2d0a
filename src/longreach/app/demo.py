"""The demo: a made recording of a driving robot, written, read back, and estimated as any other."""

from collections.abc import Callable
from pathlib import Path

from longreach.app.configuration import EstimateConfig, EvaluationConfig
from longreach.app.estimate import Estimate, estimate
from longreach.app.outputs import write_estimate
from longreach.app.warmup import warm_up
from longreach.io.bag_writer import write_bag
from longreach.io.config import load_description
from longreach.io.recording import read_recording
from longreach.sim.kinematic import make_recording

Progress = Callable[[str, float], None]


def make_and_estimate(out: Path, seed: int, duration: float, progress: Progress | None = None) -> Estimate:
    """Write `recording.mcap` and the results of its estimation into a folder.

    The simulation and its estimate share one world frame, so nothing is aligned before they are compared.
    """
    tell = progress or (lambda stage, fraction: None)
    warm_up(tell, "estimation")
    thing = load_description("thing")
    tell("simulation", 0.0)
    made = make_recording(thing, seed=seed, duration=duration)
    path = out / "recording.mcap"
    tell("writing", 0.0)
    write_bag(path, made, thing)
    recording = read_recording(path, thing, lambda fraction: tell("reading", fraction))
    config = EstimateConfig(evaluation=EvaluationConfig(align="none"))
    result = estimate(recording, thing, config, progress=tell)
    write_estimate(result, out, tell)
    return result
