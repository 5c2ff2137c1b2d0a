"""Drives with physics for benchmarks: any world, any floor, made once and kept in a folder."""

import math
import pickle
from pathlib import Path

import numpy as np

from longreach.geometry import se2
from longreach.io.robots import load_robot
from longreach.measurement import Recording
from longreach.sim.drive import Drive, move
from longreach.sim.physics import Simulation
from longreach.sim.record import make_recording, record
from longreach.sim.worlds import load_world

# Where there is room to drive: middle and half of a rectangle [m], the greatest turn either way [rad], and the slowest
# and the fastest wave along x [Hz].
_ROOM = {
    "office": ((1.0, 0.3), (1.6, 1.0), math.pi, (0.03, 0.12)),
    "corridor": ((7.5, -0.05), (6.5, 0.15), 0.5, (0.015, 0.04)),
    "warehouse": ((8.0, 0.0), (7.0, 0.6), math.pi, (0.015, 0.04)),
}
_WAVES, _WATCHED = 4, 1.0


def drive_in(world: str, seed: int, duration: float, limits: tuple[np.ndarray, np.ndarray]) -> Drive:
    """Draw a drive that goes to the robot's limits where there is room."""
    rng = np.random.default_rng(seed)
    _, half, turn, (slow, fast) = _ROOM[world]
    frequency = 2 * np.pi * np.stack([rng.uniform(a, b, _WAVES) for a, b in ((slow, fast), (0.03, 0.15), (0.03, 0.12))])
    amplitude, phase = rng.uniform(0.5, 1.0, (3, _WAVES)), rng.uniform(0.0, 2 * np.pi, (3, _WAVES))
    motion = move(Drive(duration, amplitude, frequency, phase), np.arange(0.0, duration, 0.01))
    fast_enough = 0.9 * limits[0] / np.abs(motion.velocity).max(axis=0)
    hard_enough = 0.9 * limits[1] / np.abs(motion.acceleration).max(axis=0)
    wide_enough = 2 * np.array([*half, turn]) / np.ptp(motion.poses, axis=0)
    scale = np.min([fast_enough, hard_enough, wide_enough], axis=0)
    scale[:2] = np.minimum(scale[:2], [scale[0], 0.7 * scale[1]]) * 0.7  # both at once stay below the limits
    return Drive(duration, amplitude * scale[:, None], frequency, phase)


def make_drive_recording(world: str, floor: str | None, seed: int, duration: float) -> Recording:
    """Drive the thing through a world and return what its sensors said, and the truth from (0, 0, 0) on."""
    robot = load_robot("thing")
    if world == "laboratory":
        return make_recording(robot, seed=seed, duration=duration, floor=floor)
    described = robot.description
    limits = np.array(described.velocity_limits), np.array(described.acceleration_limits)
    drive = drive_in(world, seed, duration, limits)
    poses = move(drive, np.arange(0.0, duration, 0.01)).poses
    middle = 0.5 * (poses.min(axis=0) + poses.max(axis=0))
    at = _ROOM[world][0]
    moved = load_world(world).moved(float(middle[0] - at[0]), float(middle[1] - at[1]))
    simulation = Simulation(robot, moved, seed=seed, floor=floor)
    rate = simulation.capabilities.base_rate
    motion = move(drive, np.arange(math.ceil(duration * rate) + 1) / rate)
    twists, poses = motion.twist, motion.poses

    def steered(t: float) -> np.ndarray:
        i = round(t * rate)
        return twists[i] + _WATCHED * se2.difference(simulation.truth().base, poses[i])

    return record(simulation, steered, duration).replace(name=f"{world}-{floor}-{seed}")


def kept_recording(folder: Path | None, world: str, floor: str | None, seed: int, duration: float) -> Recording:
    """Return the recording, from the folder where it has been made before."""
    file = None if folder is None else folder / f"{world}-{floor}-{seed}-{duration:g}.pickle"
    if file is not None and file.is_file():
        return pickle.loads(file.read_bytes())
    made = make_drive_recording(world, floor, seed, duration)
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(".part")
        part.write_bytes(pickle.dumps(made))
        part.replace(file)
    return made
