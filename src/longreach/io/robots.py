"""Robots from files: a shipped description, one of your own, or a bare URDF."""

from pathlib import Path

from longreach.io.config import description_file, read_config
from longreach.robot.description import Arm, RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator


def load_robot(robot: str | Path) -> MobileManipulator:
    """Return a robot by its shipped name (`thing`, `ur10`, …), from a YAML description, or from a URDF.

    A bare URDF is an arm that is bolted to the world and ends at its only last link; where it branches, or stands on
    a base that drives, write a YAML description that says so.

    Raises:
        ConfigError: there is no such robot, or its YAML is wrong.
        ModelError: its URDF is wrong.
    """
    path = Path(robot)
    if path.suffix == ".urdf":
        description = RobotDescription(name=path.stem, arm=Arm(urdf=path.name), bolted=True)
    else:
        path = description_file(robot)
        description = read_config(path, RobotDescription)
    return MobileManipulator.from_description(description, path.parent)
