"""Compile every kernel before it is needed, and say so."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

import longreach
from longreach.app.configuration import EstimateConfig
from longreach.app.estimate import estimate
from longreach.io.config import load_description
from longreach.io.robots import load_robot
from longreach.kernels import cache_root, source_hash
from longreach.planning.inverse_kinematics import all_solutions, solve_ik
from longreach.planning.planner import plan
from longreach.planning.reference import dual_trajectory
from longreach.robot.manipulability import manipulability
from longreach.sim.kinematic import make_recording

Progress = Callable[[str, float], None]


def warm_up(progress: Progress | None = None) -> Path:
    """Run each kernel once on something small, unless these very sources were warmed up before; return the cache."""
    tell = progress or (lambda stage, fraction: None)
    mark = cache_root() / f"warm-{_hash_of_all()}"
    if mark.is_file():
        return cache_root()
    steps = (_estimation, _kinematics, _planning)
    for i, step in enumerate(steps):
        tell("compiling (first run only)", i / len(steps))
        step()
    tell("compiling (first run only)", 1.0)
    mark.touch()
    return cache_root()


def _hash_of_all() -> str:
    """Return a hash over all kernel files, in a form that names a file."""
    files = sorted(Path(longreach.__file__).parent.rglob("*kernels.py"))
    return "".join(source_hash(file)[:4] for file in files)[:120]


def _estimation() -> None:
    thing = load_description("thing")
    recording = make_recording(thing, duration=1.0, lidar_rate=10.0, beams=90)
    estimate(recording, thing, EstimateConfig())


def _kinematics() -> None:
    thing = load_robot("thing")
    q = thing.home
    thing.forward(q)
    thing.forward(np.stack([q, q]))
    thing.forward_and_jacobian(q)
    thing.forward_and_jacobian_batch(np.stack([q, q]))
    thing.hessian(q)
    manipulability(thing, q)
    solve_ik(thing, thing.forward(q), q)
    all_solutions(thing, thing.forward(q))


def _planning() -> None:
    thing = load_robot("thing")
    plan(thing, dual_trajectory(thing.forward(thing.home), waypoints=3), thing.home)
