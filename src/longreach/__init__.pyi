"""What `import longreach as lr` has, for editors and type checkers; loaded when first used (`__init__.py`)."""

from longreach.app.calibrate import Calibration, calibrate
from longreach.app.configuration import EstimateConfig
from longreach.app.estimate import Estimate, estimate
from longreach.app.evaluate import evaluate
from longreach.app.map import build_map
from longreach.app.map_outputs import write_map
from longreach.app.outputs import write_estimate
from longreach.configuration import ConfigurationTrajectory, TaskReport
from longreach.control.hardware import Command, Hardware, Readings
from longreach.errors import LongreachError
from longreach.io.recording import read_recording
from longreach.io.robots import load_robot
from longreach.live.client.client import connect
from longreach.live.protocol.frames import lookup
from longreach.localization.config import LocalizerConfig
from longreach.localization.localizer import Localizer
from longreach.mapping.map_file import Map, load_map, save_map
from longreach.measurement import (
    Imu,
    JointState,
    LaserScan,
    Odometry,
    PoseMeasurement,
    Recording,
    RelativePoseMeasurement,
    TwistMeasurement,
    WheelSpeeds,
    WheelTicks,
)
from longreach.planning.inverse_kinematics import solve_ik
from longreach.planning.planner import plan
from longreach.planning.task_priority import solve_priority
from longreach.planning.thesis_problem import thesis_problem
from longreach.reference import Reference
from longreach.robot.chain import KinematicChain
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.kinematic import make_recording
from longreach.trajectory import PoseTrajectory

__all__ = [
    "Calibration",
    "Command",
    "ConfigurationTrajectory",
    "Estimate",
    "EstimateConfig",
    "Hardware",
    "Imu",
    "JointState",
    "KinematicChain",
    "LaserScan",
    "Localizer",
    "LocalizerConfig",
    "LongreachError",
    "Map",
    "MobileManipulator",
    "Odometry",
    "PoseMeasurement",
    "PoseTrajectory",
    "Readings",
    "Recording",
    "Reference",
    "RelativePoseMeasurement",
    "TaskReport",
    "TwistMeasurement",
    "WheelSpeeds",
    "WheelTicks",
    "__version__",
    "build_map",
    "calibrate",
    "connect",
    "estimate",
    "evaluate",
    "load_map",
    "load_robot",
    "lookup",
    "make_recording",
    "plan",
    "read_recording",
    "save_map",
    "solve_ik",
    "solve_priority",
    "thesis_problem",
    "write_estimate",
    "write_map",
]

__version__: str
