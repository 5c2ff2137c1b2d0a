"""What the gripper action's goals mean for the fingers, and back."""

import math

import pytest

from longreach.control.hardware import GripperCommand
from longreach.errors import ControlError
from longreach.ros.gripper_action import command_of, goal_of

ANGLE = 1.2


@pytest.mark.parametrize(
    "command",
    [GripperCommand("position", 0.0), GripperCommand("position", 0.4), GripperCommand("force", 20.0)],
    ids=lambda command: command.mode,
)
def test_a_command_goes_through_a_goal_unchanged(command):
    again = command_of(*goal_of(command, ANGLE, 0.0), ANGLE)
    assert again.mode == command.mode
    assert again.value == pytest.approx(command.value)


def test_a_speed_becomes_the_end_that_it_leads_to_and_a_force_outward_opens():
    assert goal_of(GripperCommand("velocity", 0.3), ANGLE, 0.5) == (ANGLE, 0.0)
    assert goal_of(GripperCommand("velocity", 0.0), ANGLE, 0.5) == (0.5 * ANGLE, 0.0)  # a stop keeps what is held
    assert goal_of(GripperCommand("velocity", -0.3), ANGLE, 0.5) == (0.0, 0.0)
    assert command_of(*goal_of(GripperCommand("force", -20.0), ANGLE, 0.5), ANGLE) == GripperCommand("position", 0.0)


def test_a_goal_beyond_the_ends_is_the_end_and_one_that_is_no_number_is_refused():
    assert command_of(9.0, 0.0, ANGLE) == GripperCommand("position", 1.0)
    for position, effort in ((math.nan, 0.0), (0.0, math.inf)):
        with pytest.raises(ControlError, match="must be finite numbers"):
            command_of(position, effort, ANGLE)
