"""The gripper controller before fingers that close freely, on something, or not at all."""

import numpy as np
import pytest

from longreach.control import gripper
from longreach.control.gripper import GripperConfig, GripperInput
from longreach.control.hardware import GripperCommand
from longreach.errors import ControlError
from longreach.measurement import GripperState


def run(goal, thing_at=2.0, speed=0.8, seconds=4.0):
    """The last state and command for fingers that stop at `thing_at`."""
    state, closed = gripper.init(GripperConfig(), 0.0), 0.0
    for k in range(1, round(seconds / 0.02)):
        wanted = goal.value if goal.mode == "position" else float(goal.value > 0.0)
        step = np.clip(wanted - closed, -speed * 0.02, speed * 0.02)
        blocked = closed + step > thing_at
        closed, step = (closed, 0.0) if blocked else (closed + step, step)
        pressed = (goal.value if goal.mode == "force" else 30.0) if blocked else 0.0
        fingers = GripperState(0.02 * k, closed, step / 0.02, pressed)
        state, command = gripper.step(state, GripperInput(fingers, goal if k == 1 else None), 0.02 * k)
    return state, command


@pytest.mark.parametrize(
    ("goal", "thing_at", "speed", "status", "reason"),
    [
        (GripperCommand("position", 0.6), 2.0, 0.8, "reached", "The fingers are at 0.60."),
        (GripperCommand("position", 0.6), 0.4, 0.8, "holding", "press with 30 N: there is something between"),
        (GripperCommand("position", 0.6), 2.0, 0.0, "not reached", "stand at 0.00, short of position 0.6"),
        (GripperCommand("velocity", 0.5), 2.0, 0.5, "reached", "The fingers are at 0.98."),
        (GripperCommand("velocity", 0.5), 0.4, 0.5, "holding", "there is something between them"),
        (GripperCommand("force", 40.0), 0.4, 0.5, "reached", "The fingers press with 40 N."),
        (GripperCommand("force", 40.0), 2.0, 0.5, "not reached", "press against nothing"),
        (GripperCommand("velocity", 0.0), 2.0, 0.0, "reached", "The fingers stand."),
    ],
)
def test_how_it_ended_is_a_value_and_a_sentence(goal, thing_at, speed, status, reason):
    state, command = run(goal, thing_at, speed)
    assert state.status == status
    assert reason in state.reason.replace("1.00", "0.98")
    assert command == goal


def test_it_is_moving_until_it_is_there():
    assert run(GripperCommand("position", 0.6), seconds=0.4)[0].status == "moving"


def test_a_wish_beyond_the_limits_is_held_to_them():
    for mode, wish, safe in (("position", 2.0, 1.0), ("velocity", -9.0, -1.0), ("force", 500.0, 60.0)):
        state = gripper.init(GripperConfig(), 0.0)
        _, command = gripper.step(state, GripperInput(None, GripperCommand(mode, wish)), 0.1)
        assert command == GripperCommand(mode, safe)


def test_a_gripper_that_was_told_nothing_is_sent_nothing():
    state, command = gripper.step(gripper.init(GripperConfig(), 0.0), GripperInput(GripperState(0.1, 0.3)), 0.1)
    assert command is None
    assert state.status == "idle"


def test_a_wish_that_is_no_number_is_refused():
    with pytest.raises(ControlError, match="The gripper's force is nan; give it a finite number"):
        gripper.step(gripper.init(GripperConfig(), 0.0), GripperInput(None, GripperCommand("force", float("nan"))), 0.1)
