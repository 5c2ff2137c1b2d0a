"""Simulated robots that somebody operates for as long as he likes."""

from longreach.errors import ConfigError
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.physics import PhysicsConfig, Simulation
from longreach.sim.sensors import SensorConfig, Timing
from longreach.sim.simulated import Simulated

SIMULATED = ("sim", "kinematic")
_SELDOM = SensorConfig(truth=Timing(rate=1e-3, latency=0.0))  # the truth is asked for; none is to pile up


def simulated(kind: str, robot: MobileManipulator, world: str, seed: int, scans: bool = True) -> Simulated:
    """Return a simulated robot: sim, with physics, or kinematic, without forces.

    Raises:
        ConfigError: there is no such kind, or it cannot be simulated.
    """
    if kind == "sim":
        return Simulation(robot, world, seed=seed, config=PhysicsConfig(sensors=_SELDOM))
    if kind == "kinematic":
        present = ("wheels", "imu", "joints", "lidar") if scans else ("wheels", "imu", "joints")
        return KinematicRobot(robot, world, seed=seed, config=KinematicConfig(sensors=_SELDOM, present=present))
    raise ConfigError(f"There is no hardware {kind!r}; there are {', '.join(SIMULATED)} and ros.")
