"""A simulated robot with forces: MuJoCo's, behind the same `Hardware` as a real one, in time that is stepped.

Wheels slip because the floor lets them, the arm lags because it weighs something. What its sensors say arrives late and
noisy, as `longreach.sim.sensors` makes it; `truth` is what really happens.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from pydantic import BaseModel, ConfigDict, Field

from longreach.control.hardware import Capabilities, Command, Readings
from longreach.errors import ConfigError
from longreach.robot.description import Encoder, Mount
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.motion import AT_ONCE, LEVER, PAST, Motion
from longreach.sim.mujoco_model import GRAVITY, STEP
from longreach.sim.pictures import Pictures, Trail
from longreach.sim.places import load_of
from longreach.sim.sensors import (
    Gyro,
    Line,
    Scanner,
    SensorConfig,
    gripper_state,
    read_joints,
    read_wheels,
    read_wrench,
)
from longreach.sim.simulated import Truth, capabilities_of, check_command
from longreach.sim.worlds import World, load_world

_KINDS = ("wheels", "lidar", "imu", "joints", "wrench", "truth")


class PhysicsConfig(BaseModel):
    """Sensors and motors of a robot with physics."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    sensors: SensorConfig = Field(default=SensorConfig(), description="Rates, noise, latency, dropouts.")
    stiffness: float = Field(
        default=80.0, gt=0, le=300, description="How fast a joint of the arm answers [rad/s]; ours, about a UR10's."
    )
    timeout: float = Field(default=0.25, gt=0, description="A command holds so long [s]; the Ridgeback's.")


class Simulation:
    """A robot in a world; see `longreach.control.hardware.Hardware`. Time passes in `advance` alone.

    The same arguments and the same calls give the same readings, bit for bit.

    Arguments: world: a name, a YAML file or a `World`; floor: how it grips, where not as the world says; q (n,): where
    the robot stands at the start, base first, else at its home.

    Raises:
        ConfigError: MuJoCo is not installed, there is no such world or floor, or the robot has no physics.
    """

    def __init__(
        self,
        robot: MobileManipulator,
        world: World | str | Path = "laboratory",
        *,
        seed: int = 0,
        floor: str | float | None = None,
        q: Float[np.ndarray, " n"] | None = None,
        config: PhysicsConfig | None = None,
    ) -> None:
        self.robot, self.config = robot, config or PhysicsConfig()
        world = world if isinstance(world, World) else load_world(world)
        self.world = world if floor is None else world.with_floor(floor)
        self._capabilities = capabilities_of(robot, self.config.timeout)
        self._motion = Motion(robot, self.world, robot.home if q is None else q, self.config.stiffness)
        self._pictures, self._stopped, self._glimpses = Pictures(self._motion.model), "", []
        self.hit = ""
        self._fit_sensors(seed)
        self._sense()

    @property
    def capabilities(self) -> Capabilities:
        """What the robot can do: as its description says."""
        return self._capabilities

    @property
    def stamp(self) -> float:
        """The time [s]."""
        return self._motion.stamp

    @property
    def stopped(self) -> str:
        """Why the robot was stopped, or nothing."""
        return self._stopped

    def read(self) -> Readings:
        """Return everything that has arrived since the last call."""
        new = {kind: line.take(self.stamp) for kind, line in self._lines.items()}
        joints, share, gripper = new["joints"], self._motion.at.share, None
        if joints and len(share):
            gripper = gripper_state(joints[-1], share, LEVER)
        return Readings(self.stamp, new["wheels"], new["lidar"], new["imu"], joints, new["wrench"], gripper)

    def write(self, command: Command) -> None:
        """Take a command; after a stop none is taken.

        Raises:
            ControlError: numbers that are not finite, or not one for each joint.
        """
        if self._stopped:
            return
        motion, until = self._motion, self.stamp + self.config.timeout
        check_command(command, len(motion.at.arm_names))
        if command.base is not None:
            motion.base.take(command.base, until)
        if command.arm is not None and command.arm_mode == "velocity":
            motion.arm.take_speeds(command.arm, until)
        elif command.arm is not None:
            motion.arm.take_angles(command.arm, self.stamp + 1.0 / self.capabilities.arm_rate)
        if command.gripper is not None:
            motion.gripper.take(command.gripper)

    def stop(self, reason: str) -> None:
        """Brake base and arm within their accelerations, and take no more commands."""
        self._stopped = self._stopped or reason
        self._motion.base.until = -math.inf
        self._motion.arm.brake()

    def advance(self, duration: float) -> None:
        """Let time pass [s], in whole milliseconds.

        Raises:
            ConfigError: the duration is none, or the physics has become unstable.
        """
        if not 0.0 <= duration < math.inf:
            raise ConfigError(f"Time can pass by 0 s or more, but not by {duration} s.")
        motion = self._motion
        end = motion.step + round(duration / STEP)
        while motion.step < end:
            motion.run(min(AT_ONCE, end - motion.step))
            if not self.hit and (link := motion.touching()):
                self.hit = f"{link} ran into something {self.stamp:.1f} s after the start."
            self._sense()
        if not np.isfinite(motion.qpos[-1]).all():
            raise ConfigError("The physics has become unstable; send gentler commands.")

    def truth(self) -> Truth:
        """Return what really is, now."""
        return self._motion.truth()

    def truths(self) -> list[Truth]:
        """Return what motion capture saw so far, at its rate."""
        return [self._motion.truth_of(step, glimpse) for step, glimpse in self._glimpses]

    @property
    def draws(self) -> bool:
        """Whether there is something to draw pictures with."""
        return self._pictures.possible

    def image(
        self, camera: str = "overview", width: int = 640, height: int = 480, trails: Sequence[Trail] = ()
    ) -> UInt8[np.ndarray, "h w 3"]:
        """Return what a camera sees now (height, width, 3), RGB: overview, or a camera of the robot.

        Arguments: trails: colours and points (n, 3) [m] of paths that hang in space.

        Raises:
            ConfigError: there is no such camera, the picture is too large, or there is nothing to draw with.
        """
        return self._pictures.draw(self._motion.data, camera, width, height, trails)

    def engine_state(self) -> tuple[Any, Any]:
        """Return MuJoCo's model and data, for a window on them."""
        return self._motion.model, self._motion.data

    def _fit_sensors(self, seed: int) -> None:
        """Make each sensor with a stream of random numbers of its own."""
        description, sensors, motion = self.robot.description, self.config.sensors, self._motion
        rngs = dict(zip(_KINDS, np.random.default_rng(seed).spawn(len(_KINDS)), strict=True))
        self._noise = {kind: rng.spawn(1)[0] for kind, rng in rngs.items()}
        self._lines = {kind: Line(getattr(sensors, kind), rng) for kind, rng in rngs.items()}
        self._lines["imu"].count = self._lines["wrench"].count = 1  # they tell the mean since their last reading
        self._encoder, self._scanner, self._imu = description.encoder or Encoder(), None, None
        if description.lidar is not None:
            seen = self.world.at_height((description.lidar.mount or Mount()).z)
            self._scanner = Scanner.of(description.lidar, sensors.lidar, seen)
        if description.imu is not None:
            self._imu = Gyro(description.imu, sensors.imu.rate, self._noise["imu"])
        self._load = load_of(self.robot, motion.model, motion.data)

    def _due(self, kind: str, lag: float = 0.0) -> Iterator[tuple[Line, int, int]]:
        """Yield each reading whose end, `lag` [s] after it was due, has passed: its sensor, the step, its row."""
        line, now = self._lines[kind], self._motion.step
        while (step := math.ceil((line.due + lag) / STEP - 1e-6)) <= now:
            yield line, step, PAST - 1 - (now - step)
            line.count += 1

    def _mean(self, line: Line, row: int) -> tuple[Float[np.ndarray, " n"], float]:
        """Return the mean of what was sensed in the time between two readings, and how old that is [s]."""
        count = min(max(round(1.0 / (line.timing.rate * STEP)), 1), PAST - AT_ONCE)
        # MuJoCo computes these numbers before it takes the step: they are one step old.
        return np.add.reduce(self._motion.sensed[row - count + 1 : row + 1]) / count, (0.5 * (count - 1) + 1.0) * STEP

    def _sense(self) -> None:
        """Let every sensor read that is due, and send what it read on its way."""
        motion, at, config, noise = self._motion, self._motion.at, self.config.sensors, self._noise
        for line, step, i in self._due("wheels"):
            angles, speeds = motion.qpos[i, at.wheels], motion.qvel[i, at.wheel_speeds]
            line.send(read_wheels(_stamp(step * STEP), angles, speeds, self._encoder), step * STEP)
        if self._scanner is not None:
            first, sweep = self.stamp - (PAST - 1) * STEP, self._scanner.duration
            for line, _, _ in self._due("lidar", sweep):
                line.send(
                    self._scanner.read(_stamp(line.due), first, STEP, motion.bases, noise["lidar"]), line.due + sweep
                )
        if self._imu is not None:
            for line, step, i in self._due("imu"):
                mean, age = self._mean(line, i)
                line.send(self._imu.read(_stamp(step * STEP - age), mean[at.gyro], mean[at.force]), step * STEP)
        for line, step, i in self._due("joints"):
            values = [motion.qpos[i, at.joints], motion.qvel[i, at.joint_speeds], motion.sensed[i, at.efforts]]
            reading = read_joints(_stamp(step * STEP), at.joint_names, np.stack(values), config.joints, noise["joints"])
            line.send(reading, step * STEP)
        if self._load is not None:
            for line, step, i in self._due("wrench"):
                mean, age = self._mean(line, i)
                held, weight = mean[self._load.held], -GRAVITY * self._load.mass * mean[self._load.up]
                stamp, centre = _stamp(step * STEP - age), self._load.centre
                line.send(read_wrench(stamp, held, weight, centre, config.wrench, noise["wrench"]), step * STEP)
        for _, step, i in self._due("truth", STEP):
            self._glimpses.append((step - 1, motion.glimpse(i)))


def _stamp(seconds: float) -> float:
    """Return a stamp in whole nanoseconds, as a message holds it: a replay sees the same."""
    return round(seconds, 9)
