"""The robot's own drivers: from the command that holds to what each motor is to do in the next milliseconds.

They keep to speeds and accelerations by themselves, and bring base and arm to rest when no command came in time, as
the Ridgeback's and the UR10's do.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.control.hardware import GripperCommand
from longreach.robot.bases import MecanumBase
from longreach.robot.chain import JointLimits
from longreach.sim._driver_kernels import run_arm, run_base

GRIP_SPEED = 1.0  # of the fingers when told a position [1/s]; ours
HARDEST = 1e3  # acceleration of a joint that says none [rad/s²]; ours
_GRIP_FORCE = 60.0  # at the tips [N]; Robotiq's 3-finger gripper


@dataclass
class BaseDriver:
    """Wheel speeds for a body twist that changes no faster than `acceleration` (3,)."""

    wheels: MecanumBase
    velocity: Float[np.ndarray, "3"]
    acceleration: Float[np.ndarray, "3"]
    twist: Float[np.ndarray, "3"]
    wanted: Float[np.ndarray, "3"]
    until: float = -math.inf  # the command holds so long [s]

    def take(self, twist: Float[np.ndarray, "3"], until: float) -> None:
        """Hold a twist up to a time."""
        self.wanted, self.until = np.minimum(np.maximum(twist, -self.velocity), self.velocity), until

    def speeds(self, now: float, dt: float, count: int) -> Float[np.ndarray, "count 4"]:
        """Return the wheels' speeds [rad/s] in the next `count` steps of dt [s]."""
        wanted = self.wanted if now < self.until else np.zeros(3)
        speeds = np.empty((count, len(self.wheels.inverse_matrix)))
        run_base(self.twist, wanted, self.acceleration * dt, self.wheels.inverse_matrix, speeds)
        return speeds


@dataclass
class ArmDriver:
    """Angles and speeds for the arm's joints, for a command of speeds, or of angles to be reached at `arrival`."""

    limits: JointLimits
    q: Float[np.ndarray, " n"]
    v: Float[np.ndarray, " n"]
    wanted: Float[np.ndarray, " n"]
    angles: bool = False  # whether `wanted` is angles
    arrival: float = 0.0
    until: float = -math.inf

    def __post_init__(self) -> None:
        self._hardest = np.minimum(self.limits.acceleration, HARDEST)

    def take_speeds(self, speeds: Float[np.ndarray, " n"], until: float) -> None:
        """Hold speeds [rad/s] up to a time."""
        self.wanted, self.until, self.angles = (
            np.clip(speeds, -self.limits.velocity, self.limits.velocity),
            until,
            False,
        )

    def take_angles(self, q: Float[np.ndarray, " n"], arrival: float) -> None:
        """Go to angles [rad] evenly until `arrival`, and stay."""
        self.wanted, self.arrival, self.angles = np.clip(q, self.limits.lower, self.limits.upper), arrival, True

    def brake(self) -> None:
        """Come to rest within the accelerations."""
        self.wanted, self.angles = np.zeros(len(self.q)), False
        self.until = -math.inf

    def steps(
        self, now: float, dt: float, count: int
    ) -> tuple[Float[np.ndarray, "count n"], Float[np.ndarray, "count n"]]:
        """Return angles [rad] and speeds [rad/s] in the next `count` steps of dt [s]."""
        wanted = self.wanted if self.angles or now < self.until else np.zeros(len(self.q))
        left = max(round((self.arrival - now) / dt), 1) if self.angles else 1
        q, v, limits = np.empty((count, len(self.q))), np.empty((count, len(self.q))), self.limits
        bounds = (limits.lower, limits.upper, limits.velocity, self._hardest)
        run_arm(self.q, self.v, wanted, self.angles, left, dt, *bounds, q, v)
        return q, v


@dataclass
class GripperDriver:
    """How far the fingers are to be closed, from 0 to 1, and with what force at most [N]."""

    closed: float = 0.0
    wanted: float = 0.0
    speed: float = GRIP_SPEED
    force: float = _GRIP_FORCE

    def take(self, command: GripperCommand) -> None:
        """Take a position, a speed or a force."""
        value = command.value
        if command.mode == "position":
            self.wanted, self.speed, self.force = min(max(value, 0.0), 1.0), GRIP_SPEED, _GRIP_FORCE
        elif command.mode == "velocity":
            self.wanted, self.speed, self.force = float(value > 0), abs(value), _GRIP_FORCE
        else:
            self.wanted, self.speed, self.force = float(value > 0), GRIP_SPEED, min(abs(value), _GRIP_FORCE)

    def next(self, duration: float) -> float:
        """Return how far they are to be closed after `duration` [s]."""
        step = self.speed * duration
        self.closed += min(max(self.wanted - self.closed, -step), step)
        return self.closed
