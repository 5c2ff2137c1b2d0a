"""The GripperCommand action of the fingers, as ros_control's gripper action controller offers it.

A goal's position is the angle of the joint that closes the fingers [rad], 0 open; its effort is the force at the tips
[N]. One that closes them all the way with a `max_effort` presses with that; any other moves with the gripper's own.
Source: control_msgs/GripperCommand; ros_control, gripper_action_controller.
"""

import math
from typing import Any

import numpy as np

from longreach.control import gripper
from longreach.control.gripper import GripperConfig, GripperInput
from longreach.control.hardware import GripperCommand
from longreach.errors import ControlError
from longreach.io import messages
from longreach.measurement import GripperState
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.ros import wire
from longreach.ros.goals import ABORTED, PREEMPTED, REJECTED, SUCCEEDED, Goals
from longreach.sim.places import Hand

NAME = "/gripper_controller/gripper_cmd"
KIND = "control_msgs/msg/GripperCommand"
_STAY = GripperCommand("velocity", 0.0)


def closing_angle(robot: MobileManipulator) -> float:
    """Return the angle at which a robot's fingers are closed [rad]; 0 where it has none."""
    return float(np.max(Hand.of(robot).closed, initial=0.0))


def goal_of(command: GripperCommand, angle: float, closed: float) -> tuple[float, float]:
    """Return position [rad] and effort [N] of the goal that does what a command says, as near as it can: no speed.

    closed: how far the fingers are closed now, 0 to 1; a speed of 0 keeps them there.
    """
    if command.mode == "velocity" and command.value == 0.0:
        return angle * closed, 0.0
    if command.mode == "position":
        return angle * min(max(command.value, 0.0), 1.0), 0.0
    closing = angle if command.value > 0.0 else 0.0
    return closing, abs(command.value) if command.mode == "force" else 0.0


def command_of(position: float, effort: float, angle: float) -> GripperCommand:
    """Return what a goal asks for.

    Raises:
        ControlError: it is not two finite numbers.
    """
    if not (math.isfinite(position) and math.isfinite(effort)):
        raise ControlError("The position and the effort of a gripper's goal must be finite numbers.")
    closed = min(max(position / angle, 0.0), 1.0)
    return GripperCommand("force", effort) if effort > 0.0 and closed == 1.0 else GripperCommand("position", closed)


class GripperAction:
    """The action's server; fingers that close at an angle [rad]."""

    def __init__(self, angle: float, now: float) -> None:
        self._angle, self._goals = angle, Goals(NAME, KIND)
        self._control = gripper.init(GripperConfig(), now)

    def step(self, fingers: GripperState | None, now: float) -> GripperCommand | None:
        """Take what came in, and return what the fingers are to do at `now` [s]; None: nothing was ever commanded."""
        wanted = None
        while self._goals.inbox:
            what, message = self._goals.inbox.popleft()
            if what == "goal":
                wanted = self._take(message, fingers, now) or wanted
            elif self._goals.is_cancelled(message):
                self._goals.end(PREEMPTED, "It was cancelled.", now, *self._result(fingers))
                wanted = _STAY
        self._control, command = gripper.step(self._control, GripperInput(fingers, wanted), now)
        self._judge(fingers, now)
        if self._goals.feeds(now):
            self._goals.feed(*self._result(fingers))
        self._goals.tell_if_due(now)
        return command

    def _take(self, message: Any, fingers: GripperState | None, now: float) -> GripperCommand | None:
        goal, asked = self._goals.new(message), message.goal.command
        try:
            wanted = command_of(asked.position, asked.max_effort, self._angle)
        except ControlError as error:
            self._goals.conclude(goal, REJECTED, str(error), now, *self._result(fingers))
            return None
        self._goals.end(PREEMPTED, "A newer goal took its place.", now, *self._result(fingers))
        self._goals.begin(goal, now)
        return wanted

    def _judge(self, fingers: GripperState | None, now: float) -> None:
        """End the goal where the fingers are there, or stand: around something, which is what they are for, or not."""
        status = self._control.status
        if status in ("reached", "holding", "not reached"):
            ended = ABORTED if status == "not reached" else SUCCEEDED
            self._goals.end(ended, self._control.reason, now, *self._result(fingers))

    def _result(self, fingers: GripperState | None) -> tuple[float, float, bool, bool]:
        """Return position [rad], effort [N], whether something stops them, and whether they are there."""
        closed, force = (0.0, 0.0) if fingers is None else (fingers.closed, fingers.force)
        status = self._control.status
        return self._angle * closed, force, status == "holding", status == "reached"


def publisher() -> wire.Publisher:
    """Return what sends goals to such an action."""
    return wire.Publisher(f"{NAME}/goal", f"{KIND}ActionGoal")


def goal_message(stamp: float, position: float, effort: float) -> Any:
    """Return a goal as a message, without an id of its own."""
    types = wire.message_types()
    header = messages.header(types, stamp, "")
    goal = types[f"{KIND}Goal"](types[KIND](position, effort))
    return types[f"{KIND}ActionGoal"](header, types["actionlib_msgs/msg/GoalID"](header.stamp, ""), goal)
