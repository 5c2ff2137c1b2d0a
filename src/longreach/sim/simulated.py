"""What all simulated robots have in common: they are `Hardware` in time that is stepped, and know what really is."""

from dataclasses import dataclass, fields
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from longreach.control.hardware import Capabilities, Command, Hardware
from longreach.errors import ControlError
from longreach.robot.chain import JointLimits
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.places import Hand
from longreach.sim.worlds import World


@dataclass(frozen=True, eq=False)
class Truth:
    """What really is at `stamp` [s], as motion capture would see it.

    base (3,) [m, m, rad], twist (3,) in the body's axes, q (n,) base first, tool T_world_tool (4, 4).
    """

    stamp: float
    base: Float[np.ndarray, "3"]
    twist: Float[np.ndarray, "3"]
    q: Float[np.ndarray, " n"]
    tool: Float[np.ndarray, "4 4"]


@runtime_checkable
class Simulated(Hardware, Protocol):
    """A simulated robot in a world; time passes in `advance` alone.

    hit: what of the robot ran into something first, and when, as a sentence; empty where nothing did.
    """

    robot: MobileManipulator
    world: World
    hit: str

    @property
    def stamp(self) -> float:
        """The time [s]."""
        ...

    @property
    def stopped(self) -> str:
        """Why the robot was stopped, or nothing."""
        ...

    def advance(self, duration: float) -> None:
        """Let time pass [s]."""
        ...

    def truth(self) -> Truth:
        """Return what really is, now."""
        ...

    def truths(self) -> list[Truth]:
        """Return what motion capture saw so far, at its rate."""
        ...


def arm_limits(robot: MobileManipulator) -> JointLimits:
    """Return the limits of the arm's joints."""
    return JointLimits(**{f.name: getattr(robot.limits, f.name)[robot.arm] for f in fields(JointLimits)})


def capabilities_of(robot: MobileManipulator, timeout: float) -> Capabilities:
    """Return what a robot can do: as its description says."""
    description = robot.description
    fast, hard = np.array(description.velocity_limits), np.array(description.acceleration_limits)
    gripper, names = bool(Hand.of(robot).names), robot.joint_names[robot.arm]
    return Capabilities(names, arm_limits(robot), fast, hard, timeout=timeout, gripper=gripper)


def check_command(command: Command, joints: int) -> None:
    """Refuse numbers that are not finite, or not one for each joint.

    Raises:
        ControlError: there are such.
    """
    for part, value, count in (("base", command.base, 3), ("arm", command.arm, joints)):
        if value is not None and not (len(value) == count and np.isfinite(value).all()):
            raise ControlError(f"The {part} takes {count} finite numbers, but the command has {value}.")
