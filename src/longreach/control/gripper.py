"""The gripper controller: position, velocity and force for the fingers, and whether they hold something."""

from dataclasses import dataclass, replace
from typing import Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from longreach.control.hardware import GripperCommand
from longreach.errors import ControlError
from longreach.measurement import GripperState

Status = Literal["idle", "moving", "reached", "holding", "not reached"]
_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class GripperConfig(BaseModel):
    """Settings of the gripper controller."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["gripper"] = "gripper"
    velocity: _Positive = Field(default=1.0, description="Top speed of the fingers [1/s]; ours.")
    force: _Positive = Field(default=60.0, description="Largest force at the tips [N]; the Robotiq 3-finger's.")
    tolerance: _Positive = Field(default=0.02, description="So near is there, 0 open to 1 closed; ours.")
    force_tolerance: _Positive = Field(default=5.0, description="So near is there, and less is no contact [N]; ours.")
    standing: _Positive = Field(default=0.01, description="Below this the fingers stand [1/s]; ours.")
    patience: _Positive = Field(default=0.5, description="How long they stand before it is judged [s]; ours.")


class GripperInput(NamedTuple):
    """The newest state of the fingers and a new command, either of which may be None."""

    fingers: GripperState | None = None
    command: GripperCommand | None = None


@dataclass(frozen=True, slots=True)
class GripperControl:
    """What is commanded, since when the fingers stand [s], how it goes, and the sentence about it."""

    config: GripperConfig
    goal: GripperCommand | None = None
    standing_since: float = 0.0
    status: Status = "idle"
    reason: str = "The gripper has had no command yet."


def init(config: GripperConfig, now: float) -> GripperControl:
    """Start with the fingers as they are."""
    return GripperControl(config, standing_since=now)


def step(state: GripperControl, given: GripperInput, now: float) -> tuple[GripperControl, GripperCommand | None]:
    """Return the command to send at `now` [s] (None: nothing was ever commanded), and how it goes in the new state.

    Raises:
        ControlError: a command that is not a finite number.
    """
    config = state.config
    if given.command is not None:
        goal = _within(config, given.command)
        if goal != state.goal:
            state = replace(state, goal=goal, standing_since=now, status="moving", reason="The fingers are moving.")
    fingers, goal = given.fingers, state.goal
    if goal is None or fingers is None:
        return state, goal
    if abs(fingers.velocity) > config.standing:
        state = replace(state, standing_since=now)
    status, reason = _judged(state, goal, fingers, now - state.standing_since)
    return replace(state, status=status, reason=reason), goal


def _within(config: GripperConfig, command: GripperCommand) -> GripperCommand:
    if not -1e9 < command.value < 1e9:
        raise ControlError(f"The gripper's {command.mode} is {command.value}; give it a finite number.")
    low, high = {
        "position": (0.0, 1.0),
        "velocity": (-config.velocity, config.velocity),
        "force": (-config.force, config.force),
    }[command.mode]
    return GripperCommand(command.mode, min(max(command.value, low), high))


def _judged(state: GripperControl, goal: GripperCommand, fingers: GripperState, standing: float) -> tuple[Status, str]:
    """How it goes after the fingers have stood for so long [s]."""
    config = state.config
    if goal.mode == "velocity" and goal.value == 0.0:
        return ("reached", "The fingers stand.") if standing > 0.0 else ("moving", "The fingers are slowing down.")
    wanted = goal.value if goal.mode == "position" else float(goal.value > 0.0)
    if goal.mode == "force":
        if abs(fingers.force - goal.value) <= config.force_tolerance:
            return "reached", f"The fingers press with {fingers.force:.0f} N."
    elif abs(fingers.closed - wanted) <= config.tolerance:
        return "reached", f"The fingers are at {fingers.closed:.2f}."
    if standing < config.patience:
        return "moving", "The fingers are moving."
    where = f"The fingers stand at {fingers.closed:.2f}"
    if abs(fingers.force) > config.force_tolerance:
        return "holding", f"{where} and press with {fingers.force:.0f} N: there is something between them."
    return "not reached", f"{where}, short of {goal.mode} {goal.value:g}, and press against nothing."
