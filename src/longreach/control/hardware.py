"""What a robot, real or simulated, looks like to whoever drives it: read, write, stop.

A driver for a robot of your own is one class with the five members of `Hardware`; it need not inherit from it:

    class MyRobot:
        def __init__(self, address):
            self.capabilities = capabilities_of(load_robot("mine"))

        def read(self):               # never waits: what has arrived since the last call, possibly nothing
            return Readings(stamp=now, joints=..., wheels=..., scans=...)

        def write(self, command):     # at most once a tick; the newest command holds
            ...                       # None in a command: that part goes on as it is, up to `capabilities.timeout`

        def stop(self, reason):       # at once, by the robot's own means; may be called twice
            ...

`stamp`s are seconds on one clock of the robot's, that of `read`; a simulation's is simulated time. What a driver must
do by itself: bring the robot to rest when no command came for `capabilities.timeout`, and when its process ends.
The double in the tests, `RecordedHardware`, is the shortest one that works.
"""

from dataclasses import dataclass, fields
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from longreach.measurement import GripperState, Imu, JointState, LaserScan, Wheels, Wrench, frozen_array
from longreach.robot.chain import JointLimits
from longreach.robot.mobile_manipulator import MobileManipulator

ArmMode = Literal["velocity", "position"]


@dataclass(frozen=True)
class GripperCommand:
    """One command for the fingers: closed 0 to 1, closing velocity [1/s], or closing force at the tips [N]."""

    mode: Literal["position", "velocity", "force"]
    value: float


@dataclass(frozen=True, eq=False)
class Readings:
    """All that is new since the last read, each with its own stamp and in its order; `stamp`: when it was read [s].

    emergency_stop: whether the robot's red button is pressed now. remarks: what of its readings could not be used since
    the start, a sentence each.
    """

    stamp: float
    wheels: tuple[Wheels, ...] = ()
    scans: tuple[LaserScan, ...] = ()
    imu: tuple[Imu, ...] = ()
    joints: tuple[JointState, ...] = ()
    wrenches: tuple[Wrench, ...] = ()
    gripper: GripperState | None = None
    emergency_stop: bool = False
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Command:
    """What the robot is to do from now on; what is None goes on as before, up to the command's timeout.

    arm (n,): velocities [rad/s], or positions [rad] to be reached within a tick, as `arm_mode` says.
    base (3,): body twist [v_x, v_y, ω]. Numbers that are not finite are for the safety gate to find.

    Raises:
        RecordingError: a shape does not fit.
    """

    stamp: float
    arm: Float[np.ndarray, " n"] | None = None
    arm_mode: ArmMode = "velocity"
    base: Float[np.ndarray, "3"] | None = None
    gripper: GripperCommand | None = None

    def __post_init__(self) -> None:
        for name, shape in (("arm", (None,)), ("base", (3,))):
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, frozen_array(value, shape, f"Command.{name}"))


@dataclass(frozen=True, eq=False)
class Capabilities:
    """What a robot can do and keeps to: its arm's joints and their limits, its base's, the rates it takes commands at.

    arm_limits: each (n,), in the order of `arm_names`. base_velocity, base_acceleration (3,): of [v_x, v_y, ω]; None
    where it is bolted down. Rates [Hz] are the UR10's and the Ridgeback's; timeout [s]: without a command it comes to
    rest after this, the Ridgeback's.
    """

    arm_names: tuple[str, ...]
    arm_limits: JointLimits
    base_velocity: Float[np.ndarray, "3"] | None = None
    base_acceleration: Float[np.ndarray, "3"] | None = None
    arm_rate: float = 125.0
    base_rate: float = 50.0
    timeout: float = 0.25
    arm_modes: tuple[ArmMode, ...] = ("velocity", "position")
    gripper: bool = False


def capabilities_of(robot: MobileManipulator, timeout: float = 0.25, gripper: bool = False) -> Capabilities:
    """Return what a robot can do as its description says; timeout [s]: without a command it comes to rest."""
    description, limits = robot.description, robot.limits
    arm = JointLimits(**{f.name: getattr(limits, f.name)[robot.arm] for f in fields(JointLimits)})
    fast = hard = None
    if not description.bolted:
        fast, hard = np.array(description.velocity_limits), np.array(description.acceleration_limits)
    return Capabilities(robot.joint_names[robot.arm], arm, fast, hard, timeout=timeout, gripper=gripper)


@runtime_checkable
class Hardware(Protocol):
    """A robot that can be driven; the module's text is the template of a driver."""

    @property
    def capabilities(self) -> Capabilities:
        """What the robot can do."""
        ...

    def read(self) -> Readings:
        """Return everything new since the last call, without waiting."""
        ...

    def write(self, command: Command) -> None:
        """Send a command that has passed the safety gate: the arm's at 125 Hz, the base's at 50 Hz."""
        ...

    def stop(self, reason: str) -> None:
        """Bring everything to rest by the robot's own means, and keep it there."""
        ...
