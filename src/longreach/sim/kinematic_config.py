"""Settings of a robot without forces, and what its compiled motion has to know of them."""

import math
from typing import Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.errors import ConfigError
from longreach.robot.description import Encoder, Mount, RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim._kinematic_kernels import Traits
from longreach.sim.drivers import HARDEST
from longreach.sim.places import Hand
from longreach.sim.sensors import SensorConfig
from longreach.sim.simulated import arm_limits

STEP = 1e-3  # [s]
KINDS = ("wheels", "imu", "joints", "truth")  # in the order of the kernel's
_Axes = tuple[float, float, float]


class KinematicConfig(BaseModel):
    """Sensors and slip of a robot without forces."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    sensors: SensorConfig = Field(default=SensorConfig(), description="Rates, noise, latency, dropouts.")
    present: tuple[Literal["wheels", "imu", "joints", "lidar"], ...] = Field(
        default=("wheels", "imu", "joints"), description="What it has; each reading costs time, a scan most of it."
    )
    slip: _Axes = Field(
        default=(0.002, 0.018, 0.016), description="Part of each axis lost [1]; what MuJoCo's wheels lose on concrete."
    )
    slip_deviation: _Axes = Field(default=(0.01, 0.01, 0.01), description="Of what wanders about that [1]; ours.")
    slip_time: float = Field(default=1.0, gt=0, description="How long that lasts [s]; ours.")
    timeout: float = Field(default=0.25, gt=0, description="A command holds so long [s]; the Ridgeback's.")


def moving_axes(robot: RobotDescription) -> Float[np.ndarray, "3"]:
    """Return 1 for each of v_x, v_y, ω that a base moves along, else 0."""
    return np.array([1.0, float(robot.holonomic), 1.0]) * (not robot.bolted)


def traits_of(robot: MobileManipulator, config: KinematicConfig) -> Traits:
    """Return what the compiled motion has to know of a robot and its sensors.

    Wheels that no base describes turn as the body moves: one for each of v_x, v_y, ω.
    """
    description, sensors, limits = robot.description, config.sensors, arm_limits(robot)
    if description.base is not None and description.base.kind == "ackermann":
        raise ConfigError(f"{robot.name} is steered like a car and cannot be simulated; estimate its recordings.")
    base, encoder, imu = description.base, description.encoder or Encoder(), description.imu
    inverse = np.eye(3) if base is None else base.inverse_matrix
    if description.bolted:
        inverse = np.empty((0, 3))
    keep = math.exp(-STEP / config.slip_time)
    T = ((imu and imu.mount) or Mount()).matrix()
    resolution = 0.0 if encoder.resolution is None else encoder.resolution
    walk = [imu.gyro_deviation, imu.acceleration_deviation] if imu else [0.0, 0.0]
    walk.append(imu.gyro_bias_walk / math.sqrt(sensors.imu.rate) if imu else 0.0)
    noise = [resolution, resolution / encoder.radians_per_tick, *walk]
    noise += [sensors.joints.position_deviation, sensors.joints.velocity_deviation]
    present = {*config.present, "truth"} - ({"imu"} if imu is None else set())
    present -= {"wheels"} if description.bolted else set()
    rates = [getattr(sensors, kind).rate if kind in present else 0.0 for kind in KINDS]
    hardest = np.minimum(limits.acceleration, HARDEST)
    return Traits(
        base=np.array(description.acceleration_limits),
        arm=np.stack([limits.lower, limits.upper, limits.velocity, hardest]),
        inverse=inverse,
        slip=np.array([config.slip, config.slip_deviation, [keep] * 3]),
        imu=np.vstack([T[:3, :3].T, T[:3, 3]]),
        closed=Hand.of(robot).closed,
        noise=np.array(noise),
        rates=np.array(rates),
    )
