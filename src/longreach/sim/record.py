"""Recordings of drives with physics, in the form that `longreach.sim.kinematic` gives: sensors, and the truth."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.control.hardware import Command, Readings
from longreach.errors import ConfigError
from longreach.geometry import se2
from longreach.measurement import Recording
from longreach.reference import Reference
from longreach.robot.description import Mount, RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.drive import Motion, make_drive, middle, move
from longreach.sim.physics import PhysicsConfig, Simulation
from longreach.sim.simulated import Simulated, Truth
from longreach.sim.worlds import load_world
from longreach.trajectory import PoseTrajectory

_WATCHED = 1.0  # how fast whoever steers takes back an error that is seen [1/s]; ours
_AFTER = 0.1  # [s] for what is still under way at the end


def record(
    simulation: Simulated,
    twists: Callable[[float], Float[np.ndarray, "3"]],
    duration: float,
    watch: Callable[[Simulated], None] | None = None,
) -> Recording:
    """Drive a base by body twists for a time and return what its sensors said, and the truth.

    twists: from the time since the start [s] to [v_x, v_y, ω]; asked for at the rate at which the base takes commands.
    duration [s]. watch: called after each command. What the simulation has not been asked for before belongs to the
    recording.
    """
    if not 0.0 < duration < np.inf:
        raise ConfigError(f"A drive lasts longer than 0 s, but {duration} s was asked for.")
    start, dt = simulation.stamp, 1.0 / simulation.capabilities.base_rate
    readings = []
    for i in range(round(duration / dt)):
        simulation.write(Command(simulation.stamp, base=np.asarray(twists(i * dt), dtype=float)))
        simulation.advance(start + (i + 1) * dt - simulation.stamp)
        readings.append(simulation.read())
        if watch is not None:
            watch(simulation)
    simulation.write(Command(simulation.stamp, base=np.zeros(3)))
    simulation.advance(_AFTER)
    readings.append(simulation.read())
    truths = [truth for truth in simulation.truths() if truth.stamp >= start]
    name = f"{simulation.world.name}-{simulation.world.friction:g}"
    return recorded(readings, truths, name, simulation.robot.description)


def steered(simulation: Simulated, motion: Motion) -> Callable[[float], Float[np.ndarray, "3"]]:
    """Return the twists for `record` by which someone who sees the base keeps it on a motion, taking back all slip.

    motion: its first row now, the others at the rate at which the base takes commands.
    """
    rate, twists, poses = simulation.capabilities.base_rate, motion.twist, motion.poses

    def twist(t: float) -> Float[np.ndarray, "3"]:
        i = min(round(t * rate), len(poses) - 1)
        return twists[i] + _WATCHED * se2.difference(simulation.truth().base, poses[i])

    return twist


def record_motion(simulation: Simulated, motion: Motion, watch: Callable[[Simulated], None] | None = None) -> Recording:
    """Drive a base along a motion and return what its sensors said, and the truth; see `steered`."""
    duration = len(motion.poses) / simulation.capabilities.base_rate
    return record(simulation, steered(simulation, motion), duration, watch)


def readings_along(simulation: Simulated, motions: Iterable[Motion]) -> Iterator[tuple[Readings, Truth]]:
    """Drive a base along one motion after the other and yield what was read, and the truth, after each command.

    Nothing is kept: drives may be as long as one likes where the simulation keeps no truth (`SensorConfig.truth` at a
    low rate).
    """
    dt = 1.0 / simulation.capabilities.base_rate
    for motion in motions:
        start, twist = simulation.stamp, steered(simulation, motion)
        for i in range(len(motion.poses)):
            simulation.write(Command(simulation.stamp, base=twist(i * dt)))
            simulation.advance(start + (i + 1) * dt - simulation.stamp)
            yield simulation.read(), simulation.truth()


def recorded(
    readings: Iterable[Readings], truths: Sequence[Truth], name: str, description: RobotDescription
) -> Recording:
    """Return all that was read of a robot as a recording, each sensor in the order of its stamps, with the truth."""
    readings = list(readings)
    return Recording(
        name=name,
        wheels=_in_order(r.wheels for r in readings),
        scans=_in_order(r.scans for r in readings),
        imu=_in_order(r.imu for r in readings),
        joints=_in_order(r.joints for r in readings),
        wrenches=_in_order(r.wrenches for r in readings),
        truth=PoseTrajectory(np.array([t.stamp for t in truths]), np.array([t.base for t in truths]))
        if truths
        else None,
        mounts={
            sensor.frame: (sensor.mount or Mount()).matrix()
            for sensor in (description.lidar, description.imu)
            if sensor is not None and sensor.frame is not None
        },
    )


def _in_order(records: Iterable[tuple[Any, ...]]) -> tuple[Any, ...]:
    return tuple(sorted(chain.from_iterable(records), key=lambda record: record.stamp))


def tool_truth(truths: Sequence[Truth]) -> Reference:
    """Return where the tool was, T_world_tool over time."""
    return Reference(np.array([t.stamp for t in truths]), tool=np.array([t.tool for t in truths]))


def make_recording(
    robot: MobileManipulator,
    *,
    seed: int = 0,
    duration: float = 60.0,
    floor: str | float | None = None,
    config: PhysicsConfig | None = None,
    watch: Callable[[Simulated], None] | None = None,
) -> Recording:
    """Drive fast and erratically through the laboratory and return what the sensors said, and the truth.

    The drive is that of `kinematic.make_recording` with the same robot, seed and duration, steered by someone who sees
    the base and takes back what slip has done; the room is as there. Its first pose is the world, its first stamp 0.

    Arguments: duration [s], at least 1; floor: a name of `worlds.FLOORS` or a coefficient of friction; watch: called
    after each command.

    Raises:
        ConfigError: MuJoCo is not installed, the robot has no physics, or duration or floor are none.
    """
    if not 1.0 <= duration < np.inf:
        raise ConfigError(f"A recording of {duration} s cannot be made; it takes at least 1 s.")
    for_drive, _ = np.random.default_rng(seed).spawn(2)
    drive = make_drive(robot.description, duration, for_drive)
    world = load_world("laboratory").moved(*middle(drive))
    simulation = Simulation(robot, world, seed=seed, floor=floor, config=config)

    rate = simulation.capabilities.base_rate
    motion = move(drive, np.arange(math.ceil(duration * rate) + 1) / rate)
    return record(simulation, steered(simulation, motion), duration, watch).replace(name=f"physics-{seed}")
