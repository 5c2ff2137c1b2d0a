"""A made recording: a mecanum base drives through a room, and its wheels, LIDAR and IMU tell of it.

Kinematic: the drive is given and the sensors are computed from it, so that the truth is exact. There are no forces: a
wheel slips because it is told to, not because the floor is smooth.
"""

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.errors import ConfigError
from longreach.geometry import se2
from longreach.measurement import Imu, LaserScan, Recording, WheelSpeeds, WheelTicks
from longreach.robot.bases import MecanumBase
from longreach.robot.description import Encoder, ImuSensor, Lidar, Mount, RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator, description_of
from longreach.sim.drive import Drive, make_drive, middle, move
from longreach.sim.room import cast, moved, polygonal_room
from longreach.trajectory import PoseTrajectory

GRAVITY = 9.81  # [m/s²]
_SUBSTEPS = 10  # between two wheel records; the wheels' path is then good to micrometres
_FIRST_BEAM = np.radians(-135.0)  # of a scanner whose description does not say it


class SimulationConfig(BaseModel):
    """Rates, and how imperfect wheels and LIDAR are; the IMU's noise is that of the robot's description."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    wheel_rate: float = Field(default=50.0, gt=0, description="Wheel records a second [Hz]; the Ridgeback's.")
    imu_rate: float = Field(default=100.0, gt=0, description="IMU readings a second [Hz]; usual.")
    truth_rate: float = Field(default=100.0, gt=0, description="True poses a second [Hz]; a motion capture's.")
    slip_deviation: float = Field(default=0.04, ge=0, description="Of a wheel's speed, as a part of it [1]; ours.")
    slip_time: float = Field(
        default=3.0, gt=0, description="How long such a slip lasts [s]; the floor changes with the place."
    )
    burst_rate: float = Field(default=0.2, ge=0, description="How often one wheel loses its grip [1/s]; ours.")
    burst_slip: float = Field(
        default=0.3, ge=0, lt=1, description="How much at most, as a part of its speed [1]; ours."
    )
    burst_time: float = Field(default=0.3, gt=0, description="For how long at most [s]; ours.")
    range_deviation: float = Field(default=0.01, ge=0, description="Of a range [m]; fair for a Hokuyo UST-10LX.")


def make_recording(
    robot: RobotDescription | MobileManipulator,
    *,
    seed: int = 0,
    duration: float = 60.0,
    lidar_rate: float = 20.0,
    beams: int = 1081,
    config: SimulationConfig | None = None,
) -> Recording:
    """Drive a mecanum base through `polygonal_room` and return what its sensors said, and the truth.

    The same arguments give the same recording; the drive depends on `robot`, `seed` and `duration` alone. The world is
    the first pose and the first stamp is 0. Sensors that the description lacks are left out.

    Arguments: duration [s]; lidar_rate [Hz], 20 rather than the 40 of the Thing's scanner to keep files small; beams,
    spread over the scanner's field of view. A sweep is taken in an instant.

    Raises:
        ConfigError: the robot has no mecanum base, or duration, rate or beams are too small.
    """
    config, robot = config or SimulationConfig(), description_of(robot)
    if not isinstance(robot.base, MecanumBase):
        raise ConfigError(f"Only mecanum bases can be simulated, and {robot.name} is none; take the robot thing.")
    if not (duration >= 1.0 and lidar_rate > 0 and beams >= 2):
        raise ConfigError(
            f"A recording of {duration} s with {beams} beams at {lidar_rate} Hz cannot be made; it takes at least 1 s, "
            "2 beams and a rate above 0."
        )
    for_drive, for_wheels, for_lidar, for_imu = np.random.default_rng(seed).spawn(4)
    drive = make_drive(robot, duration, for_drive)
    truth = _stamps(duration, config.truth_rate)
    return Recording(
        name=f"made-{seed}",
        wheels=_wheels(drive, robot.base, robot.encoder or Encoder(), config, for_wheels),
        scans=_scans(drive, robot.lidar, lidar_rate, beams, config, for_lidar) if robot.lidar else (),
        imu=_imu(drive, robot.imu, config, for_imu) if robot.imu else (),
        truth=PoseTrajectory(truth, move(drive, truth).poses),
        mounts={s.frame: (s.mount or Mount()).matrix() for s in (robot.lidar, robot.imu) if s and s.frame},
    )


def room_of(drive: Drive) -> Float[np.ndarray, "m 4"]:
    """Return the walls of the room (x0, y0, x1, y1) [m] in the drive's world, its middle where the drive's is."""
    return moved(polygonal_room(), *middle(drive))


def _stamps(duration: float, rate: float) -> Float[np.ndarray, " n"]:
    return np.arange(int(duration * rate + 1e-6) + 1) / rate


def _wheels(
    drive: Drive, base: MecanumBase, encoder: Encoder, config: SimulationConfig, rng: np.random.Generator
) -> tuple[WheelTicks, ...] | tuple[WheelSpeeds, ...]:
    stamps = _stamps(drive.duration, config.wheel_rate)
    slip = 1.0 + _slip(stamps, config, rng)
    if encoder.signal == "speed":
        speeds = move(drive, stamps).twist @ base.inverse_matrix.T * slip
        return tuple(WheelSpeeds(*record) for record in zip(stamps.tolist(), speeds, strict=True))
    step = 1.0 / (_SUBSTEPS * config.wheel_rate)
    fine = step * np.arange((len(stamps) - 1) * _SUBSTEPS + 1)
    speeds = move(drive, fine).twist @ base.inverse_matrix.T
    turned = (0.5 * step * (speeds[1:] + speeds[:-1])).reshape(-1, _SUBSTEPS, speeds.shape[1]).sum(axis=1)
    angles = np.vstack([np.zeros(speeds.shape[1]), np.cumsum(turned * slip[1:], axis=0)])
    if encoder.resolution is not None:
        angles = encoder.resolution / encoder.radians_per_tick * np.floor(angles / encoder.resolution)
    return tuple(WheelTicks(*record) for record in zip(stamps.tolist(), angles, strict=True))


def _slip(
    stamps: Float[np.ndarray, " n"], config: SimulationConfig, rng: np.random.Generator
) -> Float[np.ndarray, "n 4"]:
    """Draw how much faster than it rolls each wheel turns, as a part of its speed."""
    slip = _wander((len(stamps), 4), 1.0 / config.wheel_rate, config.slip_deviation, config.slip_time, rng)
    for _ in range(rng.poisson(config.burst_rate * stamps[-1])):
        begin, length = rng.uniform(0.0, stamps[-1]), config.burst_time * rng.uniform(0.3, 1.0)
        rows = (stamps >= begin) & (stamps < begin + length)
        slip[rows, rng.integers(4)] += config.burst_slip * rng.uniform(0.3, 1.0)
    return slip


def _wander(
    shape: tuple[int, int], dt: float, deviation: float, time: float, rng: np.random.Generator
) -> Float[np.ndarray, "n k"]:
    """Draw a stationary Ornstein-Uhlenbeck process: a number that keeps its value for about `time` [s]."""
    keep = np.exp(-dt / time)
    values = deviation * rng.standard_normal(shape)
    for i in range(1, len(values)):
        values[i] = keep * values[i - 1] + np.sqrt(1.0 - keep**2) * values[i]
    return values


def _scans(
    drive: Drive, lidar: Lidar, rate: float, beams: int, config: SimulationConfig, rng: np.random.Generator
) -> tuple[LaserScan, ...]:
    first = _FIRST_BEAM if lidar.angle_min is None else lidar.angle_min
    increment = -2.0 * first / (beams - 1)  # as far to the left as to the right
    nearest, farthest = lidar.range_min or 0.0, lidar.range_max or np.inf
    stamps = _stamps(drive.duration, rate)
    T = (lidar.mount or Mount()).matrix()
    sense = 1.0 if T[2, 2] > 0 else -1.0  # upside down, what is to its left is to the base's right
    lasers = se2.compose(move(drive, stamps).poses, se2.from_se3(T))
    ranges = cast(room_of(drive), lasers, sense * (first + increment * np.arange(beams)))
    ranges += config.range_deviation * rng.standard_normal(ranges.shape)
    ranges[(ranges < nearest) | (ranges > farthest)] = np.inf
    frame = lidar.frame or "laser"
    return tuple(
        LaserScan(stamp, row, float(first), float(increment), nearest, farthest, frame=frame)
        for stamp, row in zip(stamps.tolist(), ranges, strict=True)
    )


def _imu(drive: Drive, imu: ImuSensor, config: SimulationConfig, rng: np.random.Generator) -> tuple[Imu, ...]:
    stamps = _stamps(drive.duration, config.imu_rate)
    motion = move(drive, stamps)
    T = (imu.mount or Mount()).matrix()
    w, alpha = motion.velocity[:, 2], motion.acceleration[:, 2]
    x, y = T[:2, 3]
    force = motion.body_acceleration.copy()
    force[:, 0] += -alpha * y - w**2 * x  # the sensor is off the centre: α × p + ω × (ω × p)
    force[:, 1] += alpha * x - w**2 * y
    force[:, 2] = GRAVITY
    rate = np.stack([np.zeros_like(w), np.zeros_like(w), w], axis=1)
    steps = rng.standard_normal(rate.shape) * imu.gyro_bias_walk / np.sqrt(config.imu_rate)
    steps[0] = rng.standard_normal(3) * imu.gyro_bias_deviation
    rate = rate @ T[:3, :3] + np.cumsum(steps, axis=0) + imu.gyro_deviation * rng.standard_normal(rate.shape)
    force = force @ T[:3, :3] + imu.acceleration_deviation * rng.standard_normal(force.shape)
    frame = imu.frame or "imu"
    return tuple(Imu(*reading, frame) for reading in zip(stamps.tolist(), rate, force, strict=True))
