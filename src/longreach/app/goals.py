"""What a robot can be asked to do, and what that means now for base and arm."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory
from longreach.control import whole_body
from longreach.control.hardware import Command
from longreach.control.interpolation import sample
from longreach.control.whole_body import WholeBodyConfig
from longreach.robot.mobile_manipulator import MobileManipulator


class Hold(NamedTuple):
    """Stand."""


class VelocityGoal(NamedTuple):
    """Do what somebody sends in a stream; what is too old is the safety gate's to see.

    command: what has come since the last tick, or None; stamp: of the newest [s].
    """

    command: Command | None
    stamp: float


class ServoGoal(NamedTuple):
    """Let the arm pull the tool to T_map_tool (4, 4), while the base stands."""

    tool: Float[np.ndarray, "4 4"]


class Follow(NamedTuple):
    """Follow a plan of all joints, of which `at` [s] have passed; negative before it begins.

    rate: how fast its time passes, 1 where nothing holds the robot back.
    """

    plan: ConfigurationTrajectory
    at: float
    rate: float = 1.0

    @property
    def progress(self) -> float:
        """How much of the plan is done, 0 to 1."""
        return min(max(self.at / self.plan.duration, 0.0), 1.0) if self.plan.duration else float(self.at >= 0.0)


Goal = Hold | VelocityGoal | ServoGoal | Follow


def desired_command(
    goal: Goal, robot: MobileManipulator, config: WholeBodyConfig, q: Float[np.ndarray, " n"], now: float
) -> tuple[Command | None, Float[np.ndarray, " n"]]:
    """Return what to command where the robot is at q (n,), and where it should be (n,), both base first.

    The answer is for the safety gate. None: nothing new, what was commanded last goes on for its time.
    """
    if isinstance(goal, VelocityGoal):
        return goal.command, q
    if isinstance(goal, Follow):
        q_reference, velocity, _ = sample(goal.plan, float(goal.plan.stamps[0]) + goal.at)
        desired = whole_body.step(robot, config, q, whole_body.Reference(q_reference, goal.rate * velocity))
    else:
        standing = whole_body.DesiredVelocity(np.zeros(len(q) - robot.base.stop), np.zeros(3))
        desired = standing if isinstance(goal, Hold) else whole_body.reach(robot, config, q, goal.tool)
        q_reference = q
    return Command(now, desired.arm, "velocity", None if robot.description.bolted else desired.base), q_reference
