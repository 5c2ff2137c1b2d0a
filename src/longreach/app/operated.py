"""Simulated robots that somebody operates for as long as he likes."""

from longreach.errors import ConfigError
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.mujoco_model import engine, mjcf
from longreach.sim.physics import PhysicsConfig, Simulation
from longreach.sim.sensors import SensorConfig, Timing
from longreach.sim.simulated import Simulated
from longreach.sim.worlds import World

SIMULATED = ("sim", "kinematic")
_SELDOM = SensorConfig(truth=Timing(rate=1e-3, latency=0.0))  # the truth is asked for; none is to pile up


def check_simulated(kind: str, robot: MobileManipulator, world: World) -> None:
    """Raise a ConfigError where `simulated` would; this takes no time."""
    if kind not in SIMULATED:
        raise ConfigError(f"There is no hardware {kind!r}; there are {', '.join(SIMULATED)} and ros.")
    if kind == "sim":
        engine()
        mjcf(robot, world)


def simulated(kind: str, robot: MobileManipulator, world: World | str, seed: int, scans: bool = True) -> Simulated:
    """Return a simulated robot: sim, with physics, or kinematic, without forces, which any robot can be.

    Raises:
        ConfigError: there is no such world, or no MuJoCo, or the robot has no physics.
    """
    if kind == "sim":
        return Simulation(robot, world, seed=seed, config=PhysicsConfig(sensors=_SELDOM))
    present = ("wheels", "imu", "joints", "lidar") if scans else ("wheels", "imu", "joints")
    return KinematicRobot(robot, world, seed=seed, config=KinematicConfig(sensors=_SELDOM, present=present))
