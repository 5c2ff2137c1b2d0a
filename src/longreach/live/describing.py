"""What a robot is, from a server to its clients: the YAML of its description, and its URDF."""

import tempfile
from pathlib import Path

import yaml

from longreach.errors import LiveError
from longreach.io.config import description_file, to_yaml, validated
from longreach.io.robots import load_robot
from longreach.live import keys
from longreach.live.line import Line
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator


def described(robot: str) -> tuple[str, str]:
    """Return the YAML of a robot's description, given by its name or a file, and its URDF or an empty text."""
    path = Path(robot) if robot.endswith(".urdf") else description_file(robot)
    description = load_robot(robot).description
    arm = description.arm
    urdf = "" if arm is None or arm.urdf is None else (path.parent / arm.urdf).read_text(encoding="utf-8")
    return to_yaml(description), urdf


def heard_description(line: Line) -> MobileManipulator:
    """Return the robot that a server describes.

    Raises:
        LiveError: it describes none.
    """
    description, urdf = line.lasting(keys.DESCRIPTION), line.lasting(keys.URDF)
    if description is None or urdf is None:
        raise LiveError("The robot does not describe itself; is this a longreach server?")
    model = validated(RobotDescription, yaml.safe_load(description.data), "the robot's description")
    with tempfile.TemporaryDirectory() as folder:
        if model.arm is not None and model.arm.urdf is not None:  # wherever the server has it, not there
            model = model.model_copy(update={"arm": model.arm.model_copy(update={"urdf": "robot.urdf"})})
            (Path(folder) / "robot.urdf").write_text(urdf.data, encoding="utf-8")
        return MobileManipulator.from_description(model, Path(folder))
