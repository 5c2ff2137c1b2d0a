"""What a page asks of a client: the part of `longreach.connect`'s face that it uses."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory
from longreach.io.bag_recorder import Recorder
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator

Method = Literal["task-priority", "sqp"]


@runtime_checkable
class RobotClient(Protocol):
    """A robot to watch and to command. `state` has what `longreach.live.client.state.LiveState` has."""

    @property
    def robot(self) -> MobileManipulator:
        """The robot."""
        ...

    @property
    def state(self) -> Any:
        """The newest state."""
        ...

    @property
    def scan(self) -> Any:
        """The newest scan, or None."""
        ...

    @property
    def age(self) -> float:
        """How old the newest state is [s]."""
        ...

    @property
    def holds(self) -> bool:
        """Whether this client holds the robot, so that its commands count."""
        ...

    @property
    def role(self) -> str:
        """Whether this client is an operator, or a watcher, who may look and stop only."""
        ...

    def on_state(self, callback: Callable[[Any], None]) -> Callable[[], None]:
        """Call back with each new state; returns what ends it."""
        ...

    def on_scan(self, callback: Callable[[Any], None]) -> Callable[[], None]:
        """Call back with each new scan; returns what ends it."""
        ...

    def record(self, path: Path) -> Recorder:
        """Record all that the robot says from now on, until the recorder is closed."""
        ...

    def plan(self, goal: Reference | Float[np.ndarray, "4 4"], method: Method) -> ConfigurationTrajectory:
        """Plan along a reference, or to a pose of the tool; nothing moves."""
        ...

    def execute(self, trajectory: ConfigurationTrajectory, wait: bool) -> Any:
        """Follow a plan."""
        ...

    def reach(self, T_map_tool: Float[np.ndarray, "4 4"]) -> None:
        """Pull the tool to a pose at once."""
        ...

    def velocity(self, arm: Float[np.ndarray, " m"] | None = None, base: Float[np.ndarray, "3"] | None = None) -> None:
        """Drive."""
        ...

    def hold(self) -> None:
        """Stand."""
        ...

    def stop(self) -> None:
        """Brake, and stay so until `reset`."""
        ...

    def reset(self) -> None:
        """Let it take commands again after a stop."""
        ...

    def release(self) -> None:
        """Let go of the robot, so that others can take it."""
        ...
