"""longreach keeps a mobile manipulator's hand where you think it is, over long trajectories."""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

# Where each public name lives; loaded when first used, so that importing longreach stays light.
_PUBLIC = {
    "LongreachError": "longreach.errors",
    "LaserScan": "longreach.measurement",
    "WheelSpeeds": "longreach.measurement",
    "WheelTicks": "longreach.measurement",
    "Odometry": "longreach.measurement",
    "Imu": "longreach.measurement",
    "TwistMeasurement": "longreach.measurement",
    "PoseMeasurement": "longreach.measurement",
    "RelativePoseMeasurement": "longreach.measurement",
    "JointState": "longreach.measurement",
    "Recording": "longreach.measurement",
    "PoseTrajectory": "longreach.trajectory",
    "KinematicChain": "longreach.robot.chain",
    "MobileManipulator": "longreach.robot.mobile_manipulator",
    "load_robot": "longreach.io.robots",
    "solve_ik": "longreach.planning.inverse_kinematics",
    "read_recording": "longreach.io.recording",
    "make_recording": "longreach.sim.kinematic",
    "estimate": "longreach.app.estimate",
    "Estimate": "longreach.app.estimate",
    "EstimateConfig": "longreach.app.configuration",
    "Localizer": "longreach.localization.localizer",
    "LocalizerConfig": "longreach.localization.config",
    "calibrate": "longreach.app.calibrate",
    "Calibration": "longreach.app.calibrate",
    "evaluate": "longreach.app.evaluate",
    "write_estimate": "longreach.app.outputs",
    "build_map": "longreach.app.map",
    "write_map": "longreach.app.map_outputs",
    "load_map": "longreach.mapping.map_file",
    "save_map": "longreach.mapping.map_file",
    "Map": "longreach.mapping.map_file",
    "Reference": "longreach.reference",
    "ConfigurationTrajectory": "longreach.configuration",
    "TaskReport": "longreach.configuration",
    "Hardware": "longreach.control.hardware",
    "Readings": "longreach.control.hardware",
    "Command": "longreach.control.hardware",
    "plan": "longreach.planning.planner",
    "thesis_problem": "longreach.planning.thesis_problem",
    "solve_priority": "longreach.planning.task_priority",
    "connect": "longreach.live.client.client",
    "lookup": "longreach.live.protocol.frames",
}

__all__ = [*_PUBLIC, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'longreach' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
