"""All controllers by their name, as a configuration's `kind` says it.

Each is three things: a model of its settings, init(config, now) → state, and step(state, input, now) → (state, output).
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, Field

from longreach.control import base_velocity, gripper, joint_trajectory
from longreach.control.base_velocity import BaseVelocityConfig
from longreach.control.gripper import GripperConfig
from longreach.control.joint_trajectory import JointTrajectoryConfig
from longreach.errors import ControlError

ControllerConfig = Annotated[JointTrajectoryConfig | BaseVelocityConfig | GripperConfig, Field(discriminator="kind")]


class Controller(NamedTuple):
    """One kind of controller."""

    config: type[BaseModel]
    init: Callable[[Any, float], Any]
    step: Callable[[Any, Any, float], tuple[Any, Any]]


CONTROLLERS: Mapping[str, Controller] = {
    "joint_trajectory": Controller(JointTrajectoryConfig, joint_trajectory.init, joint_trajectory.step),
    "base_velocity": Controller(BaseVelocityConfig, base_velocity.init, base_velocity.step),
    "gripper": Controller(GripperConfig, gripper.init, gripper.step),
}


def controller(name: str) -> Controller:
    """Return the controller of a name.

    Raises:
        ControlError: there is none; the sentence names those there are.
    """
    if name not in CONTROLLERS:
        raise ControlError(f"There is no controller {name}; choose one of {', '.join(CONTROLLERS)}.")
    return CONTROLLERS[name]
