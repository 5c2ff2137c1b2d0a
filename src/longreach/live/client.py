"""The client side: watch a robot that `longreach serve` serves, plan for it, and command it.

`Client` has the face of `longreach.Hardware`, so that whatever drives a robot drives one at the other end of a network.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import Command, Promises, Readings
from longreach.live.state import LiveState
from longreach.measurement import LaserScan
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator

Method = Literal["task-priority", "sqp"]


def connect(
    address: str = "127.0.0.1:7447",
    token: str | None = None,
    *,
    name: str = "",
    certificates: Path | None = None,
    timeout: float = 5.0,
) -> "Client":
    """Connect to a robot and wait until it says where it is [at most `timeout` s].

    Arguments: address: host:port; token: the server's secret, where it has one; name: what others see of whoever holds
    the robot (else user@host); certificates: a folder with ca.pem, and client.pem with client.key where the server asks
    for a certificate: given, the connection is TLS.

    Raises:
        LiveError: nobody answers there, or the server refuses us.
    """
    raise NotImplementedError


class Client:
    """A robot at the other end of a network; made by `connect`. All of it may be called from any thread."""

    @property
    def promises(self) -> Promises:
        """What the robot can do."""
        raise NotImplementedError

    @property
    def robot(self) -> MobileManipulator:
        """The robot, from the description that it publishes."""
        raise NotImplementedError

    @property
    def state(self) -> LiveState:
        """The newest state."""
        raise NotImplementedError

    @property
    def scan(self) -> LaserScan | None:
        """The newest scan, or None before the first."""
        raise NotImplementedError

    @property
    def plan_running(self) -> ConfigurationTrajectory | None:
        """The plan that the robot follows or has followed last, whoever sent it."""
        raise NotImplementedError

    @property
    def age(self) -> float:
        """How old the newest state is [s]; the robot is to be taken for silent beyond 0.25 s."""
        raise NotImplementedError

    @property
    def offset(self) -> float:
        """The robot's clock less this machine's `time.time()` [s], by the fastest of the last pings."""
        raise NotImplementedError

    @property
    def lost(self) -> int:
        """How many messages the robot has sent and we have not received."""
        raise NotImplementedError

    @property
    def holds(self) -> bool:
        """Whether this client holds the robot, so that its commands count."""
        raise NotImplementedError

    def on_state(self, callback: Callable[[LiveState], None]) -> Callable[[], None]:
        """Call back with each new state, from the network's thread: be quick there. Returns what ends it."""
        raise NotImplementedError

    def on_scan(self, callback: Callable[[LaserScan], None]) -> Callable[[], None]:
        """Call back with each new scan, from the network's thread. Returns what ends it."""
        raise NotImplementedError

    def __iter__(self) -> Iterator[LiveState]:
        """Yield each new state; one that comes while the last is still looked at is passed over for a newer one."""
        raise NotImplementedError

    def lookup(self, target: str, source: str, stamp: float | None = None) -> Float[np.ndarray, "4 4"]:
        """Return T_target_source at a time of the robot's clock [s] in the last 10 s, else (None) the newest.

        Raises:
            LiveError: there is no such frame, or none at that time.
        """
        raise NotImplementedError

    def read(self) -> Readings:
        """Return what sensors and joints have said since the last call, without waiting."""
        raise NotImplementedError

    def write(self, command: Command) -> None:
        """Send velocities or positions; they hold for 0.25 s. Takes the robot where nobody holds it."""
        raise NotImplementedError

    def velocity(self, arm: Float[np.ndarray, " m"] | None = None, base: Float[np.ndarray, "3"] | None = None) -> None:
        """Send velocities of the arm's joints (m,) [rad/s] and a body twist of the base (3,); None: zero."""
        raise NotImplementedError

    def gripper(self, value: float, mode: Literal["position", "velocity", "force"] = "position") -> None:
        """Close the fingers: position 0 open to 1 closed, velocity [1/s], or force [N]."""
        raise NotImplementedError

    def plan(
        self,
        goal: Reference | Float[np.ndarray, "4 4"],
        method: Method = "task-priority",
    ) -> ConfigurationTrajectory:
        """Plan from where the robot is along a reference, or to a tool pose T_map_tool (4, 4); nothing moves yet.

        The answer begins and ends at rest, within the robot's limits of speed and acceleration.

        Raises:
            PlanningError: there is no way there.
        """
        raise NotImplementedError

    def execute(
        self, trajectory: ConfigurationTrajectory, wait: bool = True, timeout: float | None = None
    ) -> LiveState:
        """Let the robot follow a trajectory of all its joints; with `wait` return when it has ended.

        Raises:
            LiveError: the robot refuses it, or was stopped on the way; the sentence says why.
        """
        raise NotImplementedError

    def move_to(
        self,
        goal: Float[np.ndarray, " n"] | Float[np.ndarray, "4 4"],
        wait: bool = True,
        method: Method = "task-priority",
    ) -> LiveState:
        """Move straight to a configuration q (n,), base first, or of the arm alone (m,), or plan to a tool pose (4, 4)."""
        raise NotImplementedError

    def reach(self, T_map_tool: Float[np.ndarray, "4 4"]) -> None:
        """Let the arm pull the tool to a pose at once, the base standing; send it anew as it moves (a dragged gizmo)."""
        raise NotImplementedError

    def hold(self) -> None:
        """Let the robot stand where it is, held by the loop; ends a plan."""
        raise NotImplementedError

    def stop(self, reason: str = "The client says stop.") -> None:
        """Brake at once, whoever holds the robot; it stays so until `reset`."""
        raise NotImplementedError

    def reset(self) -> None:
        """Let the robot move again after a stop that holds."""
        raise NotImplementedError

    def take(self) -> None:
        """Take the robot, so that this client's commands count and others' do not.

        Raises:
            LiveError: another client holds it; the sentence names it.
        """
        raise NotImplementedError

    def release(self) -> None:
        """Let go of the robot; it stands until somebody takes it."""
        raise NotImplementedError

    def close(self) -> None:
        """Release the robot and hang up."""
        raise NotImplementedError

    def __enter__(self) -> "Client":
        """Return the client."""
        return self

    def __exit__(self, *_: object) -> None:
        """Hang up."""
        self.close()


def lookup(target: str, source: str, stamp: float | None = None) -> Float[np.ndarray, "4 4"]:
    """Return T_target_source as the robot that was connected to last says; see `Client.lookup`.

    Raises:
        LiveError: no robot is connected, or it has no such frames then.
    """
    raise NotImplementedError
