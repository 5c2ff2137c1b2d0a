"""What the simulated sensors make of the true motion: noise, quantisation, sweeps; and when their readings arrive.

Each sensor draws from its own stream of random numbers, so that one that is left out changes nothing in the others.
"""

import math
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.geometry import se2
from longreach.measurement import GripperState, Imu, JointState, LaserScan, WheelSpeeds, WheelTicks, Wrench
from longreach.robot.description import Encoder, ImuSensor, Lidar, Mount
from longreach.sim._driver_kernels import grip
from longreach.sim._sweep_kernels import spoil, sweep

_BEAMS = 1081
_FIRST_BEAM = math.radians(-135.0)  # of a scanner whose description does not say it
_ROUNDING = 1e-9
_NOISIEST = 10.0  # deviations of a range by which no noise brings it back into reach

_Record = TypeVar("_Record")


class Timing(BaseModel):
    """When a sensor reads, how late that arrives, and how much of it never does."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    rate: float = Field(gt=0, le=1000, description="Readings a second [Hz].")
    latency: float = Field(default=0.002, ge=0, description="From a reading's end to its arrival [s]; ours.")
    jitter: float = Field(default=0.0, ge=0, description="Up to how much later it may arrive [s]; ours.")
    dropout: float = Field(default=0.0, ge=0, le=1, description="Part of the readings that never arrive [1].")


class LidarTiming(Timing):
    """The UST-10LX turns 40 times a second; sweeping 270° takes 18.75 ms of 25."""

    rate: float = Field(default=40.0, gt=0, le=1000, description="Sweeps a second [Hz]; the data sheet's.")
    latency: float = Field(default=0.005, ge=0, description="From the last beam to the scan's arrival [s]; ours.")
    range_deviation: float = Field(default=0.01, ge=0, description="Of a range [m]; fair for a UST-10LX.")
    lost_beams: float = Field(default=0.002, ge=0, le=1, description="Part of the beams without a return [1]; ours.")


class JointTiming(Timing):
    """The UR10's controller."""

    rate: float = Field(default=125.0, gt=0, le=1000, description="Readings a second [Hz]; the UR10's.")
    position_deviation: float = Field(default=2e-5, ge=0, description="Of an angle [rad]; ours, 20 µm at 1 m.")
    velocity_deviation: float = Field(default=1e-3, ge=0, description="Of a speed [rad/s]; ours.")


class WrenchTiming(Timing):
    """Robotiq's FT300."""

    rate: float = Field(default=100.0, gt=0, le=1000, description="Readings a second [Hz]; the data sheet's.")
    force_deviation: float = Field(default=0.1, ge=0, description="Of a force [N]; the data sheet's.")
    torque_deviation: float = Field(default=0.005, ge=0, description="Of a torque [N m]; the data sheet's.")


class SensorConfig(BaseModel):
    """All sensors of a simulated robot; the IMU's noise is that of the robot's description."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    wheels: Timing = Field(default=Timing(rate=50.0), description="Encoders; the Ridgeback's 50 Hz.")
    lidar: LidarTiming = Field(default=LidarTiming(), description="Planar laser scanner.")
    imu: Timing = Field(default=Timing(rate=100.0), description="Inertial unit; a usual rate.")
    joints: JointTiming = Field(default=JointTiming(), description="Arm and fingers.")
    wrench: WrenchTiming = Field(default=WrenchTiming(), description="Force-torque sensor.")
    truth: Timing = Field(default=Timing(rate=100.0, latency=0.0), description="Motion capture; its usual 100 Hz.")


def unchecked(kind: type[_Record], **values: Any) -> _Record:
    """Return a record of values that are known to be right and nobody else's; the checks take several times as long."""
    record = object.__new__(kind)
    for value in values.values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    record.__dict__.update(values)
    return record


@dataclass
class Line:
    """One sensor's schedule and what is under way from it: (arrival, reading), in the order of their stamps."""

    timing: Timing
    rng: np.random.Generator
    count: int = 0
    arrived: float = 0.0  # of the latest reading [s]: none overtakes another
    waiting: list[tuple[float, Any]] = field(default_factory=list)

    @property
    def due(self) -> float:
        """Stamp of the next reading [s]."""
        return self.count / self.timing.rate

    def send(self, reading: Any, end: float) -> None:
        """Put a reading on its way that was finished at `end` [s], or lose it."""
        late = 0.0
        if self.timing.dropout or self.timing.jitter:
            lost, late = self.rng.random(2)
            if lost < self.timing.dropout:
                return
        self.arrived = max(self.arrived, end + self.timing.latency + late * self.timing.jitter)
        self.waiting.append((self.arrived, reading))

    def take(self, now: float) -> tuple[Any, ...]:
        """Return what has arrived by `now` [s]."""
        if not self.waiting or self.waiting[0][0] > now + _ROUNDING:
            return ()
        n = sum(arrival <= now + _ROUNDING for arrival, _ in self.waiting)
        taken, self.waiting = self.waiting[:n], self.waiting[n:]
        return tuple(reading for _, reading in taken)


def read_wheels(
    stamp: float, angles: Float[np.ndarray, " k"], speeds: Float[np.ndarray, " k"], encoder: Encoder
) -> WheelTicks | WheelSpeeds:
    """Return what an encoder's message holds of the wheels' angles [rad] and speeds [rad/s]."""
    if encoder.signal == "speed":
        return unchecked(WheelSpeeds, stamp=stamp, speeds=speeds)
    if encoder.resolution is None:
        return unchecked(WheelTicks, stamp=stamp, ticks=angles)
    counts = np.floor(angles / encoder.resolution)
    return unchecked(WheelTicks, stamp=stamp, ticks=encoder.resolution / encoder.radians_per_tick * counts)


@dataclass(frozen=True, eq=False)
class Scanner:
    """A planar scanner in front of the walls that its beams can meet; angles (b,) [rad]."""

    lidar: Lidar
    timing: LidarTiming
    walls: Float[np.ndarray, "m 4"]
    angles: Float[np.ndarray, " b"]
    mount: Float[np.ndarray, "3"]  # T_base_laser in the plane
    room: Float[np.ndarray, "b 5"]  # for the kernel to work in

    @classmethod
    def of(cls, lidar: Lidar, timing: LidarTiming, walls: Float[np.ndarray, "m 4"]) -> "Scanner":
        """Return the scanner of a description; what that does not say is the UST-10LX's."""
        first = _FIRST_BEAM if lidar.angle_min is None else lidar.angle_min
        beams = _BEAMS if lidar.angle_increment is None else round(-2.0 * first / lidar.angle_increment) + 1
        angles = first - 2.0 * first / (beams - 1) * np.arange(beams)
        mount = se2.from_se3((lidar.mount or Mount()).matrix())
        return cls(lidar, timing, walls, angles, mount, np.empty((beams, 5)))

    @property
    def beam_time(self) -> float:
        """From one beam to the next [s]: a full turn takes the whole period."""
        return float(self.angles[1] - self.angles[0]) / (2 * math.pi * self.timing.rate)

    @property
    def duration(self) -> float:
        """From the first beam to the last [s]."""
        return (len(self.angles) - 1) * self.beam_time

    def read(
        self, stamp: float, first: float, dt: float, bases: Float[np.ndarray, "n 3"], rng: np.random.Generator
    ) -> LaserScan:
        """Sweep while the base passes through `bases`, its poses at first + i dt [s], headings not wrapped."""
        ranges = np.empty(len(self.angles))
        nearest, farthest, timing = self.lidar.range_min or 0.0, self.lidar.range_max or math.inf, self.timing
        reach = farthest + _NOISIEST * timing.range_deviation
        times = (first, dt, stamp, self.beam_time)
        sweep(bases, self.mount, *times, self.angles, self.walls, reach, self.room, ranges)
        noise, lost = rng.standard_normal(len(ranges)), rng.random(len(ranges))
        spoil(ranges, noise, timing.range_deviation, lost, timing.lost_beams, nearest, farthest)
        numbers = [self.angles[0], self.angles[1] - self.angles[0], nearest, farthest, self.beam_time]
        first_beam, increment, nearest, farthest, between = np.array(numbers, dtype=np.float32).tolist()
        single = ranges.astype(np.float32)  # as a message holds them: a replay sees the same
        frame = self.lidar.frame or "laser"
        return LaserScan(stamp, single, first_beam, increment, nearest, farthest, between, frame)


@dataclass
class Gyro:
    """An inertial unit: its bias [rad/s] walks."""

    sensor: ImuSensor
    rate: float
    rng: np.random.Generator
    bias: Float[np.ndarray, "3"] | None = None

    def read(self, stamp: float, rates: Float[np.ndarray, "3"], force: Float[np.ndarray, "3"]) -> Imu:
        """Return a reading of angular velocity [rad/s] and specific force [m/s²], both in the sensor's frame."""
        sensor, draws = self.sensor, self.rng.standard_normal((3, 3))
        walked = draws[0] * sensor.gyro_bias_walk / math.sqrt(self.rate)
        self.bias = draws[0] * sensor.gyro_bias_deviation if self.bias is None else self.bias + walked
        noisy = rates + self.bias + sensor.gyro_deviation * draws[1]
        felt = force + sensor.acceleration_deviation * draws[2]
        return unchecked(Imu, stamp=stamp, angular_velocity=noisy, acceleration=felt, frame=sensor.frame or "imu")


def read_joints(
    stamp: float,
    names: tuple[str, ...],
    values: Float[np.ndarray, "3 n"],
    timing: JointTiming,
    rng: np.random.Generator,
) -> JointState:
    """Return angles [rad], speeds [rad/s] and torques [N m] of joints as their controller tells them."""
    noise = rng.standard_normal((2, len(names)))
    position = values[0] + timing.position_deviation * noise[0]
    velocity = values[1] + timing.velocity_deviation * noise[1]
    return unchecked(JointState, stamp=stamp, names=names, position=position, velocity=velocity, effort=values[2])


def read_wrench(
    stamp: float,
    held: Float[np.ndarray, "6"],
    weight: Float[np.ndarray, "3"],
    centre: Float[np.ndarray, "3"],
    timing: WrenchTiming,
    rng: np.random.Generator,
) -> Wrench:
    """Return what the surroundings do to the tool: the opposite of what the arm holds it with, less its weight.

    held: force [N] and torque [N m] that the arm exerts on what hangs on the sensor. weight: of that, acting at
    `centre` [m], as the driver knows it. All in the sensor's frame.
    """
    (x, y, z), (fx, fy, fz) = centre.tolist(), weight.tolist()
    noise = rng.standard_normal((2, 3))
    force = -held[:3] - weight + timing.force_deviation * noise[0]
    moment = np.array([y * fz - z * fy, z * fx - x * fz, x * fy - y * fx])
    torque = -held[3:] - moment + timing.torque_deviation * noise[1]
    return unchecked(Wrench, stamp=stamp, force=force, torque=torque)


def gripper_state(joints: JointState, share: Float[np.ndarray, " k"], lever: float) -> GripperState:
    """Return how far the fingers, the last joints, are closed, how fast [1/s], and with what force at the tips [N].

    share (k,) [1/rad]: what a joint's angle says of that; lever: of a finger, from its tip to its joint [m].
    """
    closed, velocity, force = grip(joints.position, joints.velocity, joints.effort, share, lever)
    return GripperState(joints.stamp, closed, velocity, force)
