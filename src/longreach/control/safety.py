"""The last gate before the robot: no command beyond a limit leaves it, and where something is wrong, it brakes.

Every step gives a whole command, base and arm, that the robot can do and from which it can still stop before its
limits. A stop is braking within the acceleration limits, all joints together, to standstill. Emergency stop, contact
and divergence hold until `reset`; the other stops end with their cause, and the robot moves again on a new command.

Velocity commands start from where joint states say that the arm is; position commands from the position sent last.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.control import _limit_kernels, obstacles
from longreach.control.hardware import ArmMode, Command, GripperCommand, Readings
from longreach.control.obstacles import ObstacleState
from longreach.control.safety_checks import (
    Health,
    Stop,
    Watch,
    fault,
    finite,
    latching_stop,
    places,
    transient_stop,
    watch,
    within,
)
from longreach.control.safety_config import SafetyConfig
from longreach.geometry import se2
from longreach.robot.mobile_manipulator import MobileManipulator


class DesiredVelocity(NamedTuple):
    """What was commanded last, and when; in position mode `arm` is a position, otherwise a velocity."""

    arm: np.ndarray
    base: np.ndarray
    arm_stamp: float
    base_stamp: float
    arm_mode: ArmMode = "velocity"


@dataclass(frozen=True, slots=True, eq=False)
class SafetyState:
    """The gate's memory; `stop` says whether and why it stops the robot, `limited` whether it held back a command.

    q (n,): where the arm is [rad], None until known; velocity (n,), twist (3,): what was sent last.
    """

    config: SafetyConfig
    stamp: float
    q: np.ndarray | None
    velocity: np.ndarray
    twist: np.ndarray
    desired: DesiredVelocity
    watch: Watch
    stop: Stop | None = None
    limited: bool = False
    obstacles: ObstacleState | None = None


def init(
    config: SafetyConfig,
    now: float,
    q: Float[np.ndarray, " n"] | None = None,
    robot: MobileManipulator | None = None,
) -> SafetyState:
    """Start with the robot at rest.

    q (n,) [rad]: where the arm is, None: joint states will say so; robot: whose laser shows what its base has to mind.
    """
    joints = len(config.arm_arrays[0])
    zero, twist = np.zeros(joints), np.zeros(3)
    if joints == 0:
        q = zero
    desired = DesiredVelocity(zero, twist, now, now)
    q = None if q is None else np.array(q)
    minded = obstacles.init(robot, q) if robot is not None and config.obstacles else None
    return SafetyState(config, now, q, zero, twist, desired, Watch(now, {}, {}), obstacles=minded)


def reset(state: SafetyState) -> SafetyState:
    """Let the robot move again after a stop that holds; where its cause is still there, the next step stops again."""
    return replace(state, stop=None, watch=state.watch._replace(streaks={}))


def step(
    state: SafetyState, command: Command | None, readings: Readings, health: Health, now: float
) -> tuple[SafetyState, Command]:
    """Return the command that may leave at `now` [s], every tick, also where there is no new command (None)."""
    config, dt = state.config, now - state.stamp
    seen = watch(state.watch, config, readings, health)
    elapsed = min(dt, config.command_timeout) if dt > 0.0 else 0.0  # 0 also where the clock gave no number
    q = _place(state, readings, elapsed, now)
    desired, stop = (
        state.desired,
        latching_stop(config, seen, readings, health, now) or transient_stop(config, seen, health, dt, now),
    )
    if state.stop is not None and state.stop.latched:
        stop = state.stop
    if stop is None:
        desired, stop = _taken(config, desired, command, q, now)
    if stop is not None and state.stop is not None and state.stop.cause == stop.cause:
        stop = stop._replace(since=state.stop.since)
    # A position is reached within the arm's period, however long this tick was: a step is no longer than that allows.
    arm_dt = min(elapsed, config.arm.period) if config.arm is not None and desired.arm_mode == "position" else elapsed
    velocity, twist, limited = _moved(state, desired, q, stop is not None, arm_dt, elapsed)
    around = state.obstacles
    if around is not None:
        pose = se2.compose(around.pose, se2.exp(elapsed * state.twist)) if health.pose is None else health.pose
        around = obstacles.step(around, readings.scans, q, pose, state.twist, now)
        if stop is None:
            around, twist = _before_obstacles(config, around, state.twist, desired.base, twist, elapsed)
    arm: np.ndarray | None = velocity
    if desired.arm_mode == "position":
        q = arm = None if q is None else _not_beyond(config, q, q + velocity * arm_dt)
    if stop is not None:
        at_rest = arm if desired.arm_mode == "position" and arm is not None else np.zeros(len(velocity))
        desired = desired._replace(arm=at_rest, base=np.zeros(3))
    gripper = within(config, command.gripper) if command is not None and stop is None else None
    if stop is not None and stop.since == now and config.gripper:
        gripper = GripperCommand("velocity", 0.0)  # the fingers stay where they are, and keep what they hold
    stamp = now if math.isfinite(now) else state.stamp
    out = Command(
        stamp,
        None if config.arm is None else arm,
        desired.arm_mode,
        None if config.base is None else twist,
        gripper,
    )
    return SafetyState(config, stamp, q, velocity, twist, desired, seen, stop, limited, around), out


def _place(state: SafetyState, readings: Readings, dt: float, now: float) -> np.ndarray | None:
    """Where the arm is now: as the newest joint state says, carried on by the velocity sent; (n,) or None."""
    config, q = state.config, state.q
    arm = config.arm
    if arm is None:
        return q
    if q is not None and state.desired.arm_mode == "position":
        return q
    for record in reversed(readings.joints):
        where = places(record.names, arm.names)
        if where is not None and len(record.position) == len(record.names):
            measured, age = record.position[where], now - record.stamp
            if 0.0 <= age <= config.longest_tick and finite(measured):
                return _not_beyond(config, measured, measured + state.velocity * age)
    return None if q is None else _not_beyond(config, q, q + state.velocity * dt)


def _not_beyond(config: SafetyConfig, q: np.ndarray, then: np.ndarray) -> np.ndarray:
    """Where the arm is after q (n,), which is no further beyond an end than it was: what is foretold may be wrong."""
    lower, upper = config.arm_ends
    return np.minimum(np.maximum(then, np.minimum(lower, q)), np.maximum(upper, q))


def _taken(
    config: SafetyConfig, desired: DesiredVelocity, command: Command | None, q: np.ndarray | None, now: float
) -> tuple[DesiredVelocity, Stop | None]:
    """The desired velocity with the new command in it, less what is too old, or the stop for which it cannot be."""
    reason = "" if command is None else fault(config, command, q)
    if reason:
        return desired, Stop("bad command", reason, now)
    if command is not None:
        stamp = min(command.stamp, now)
        if command.base is not None and not stamp < desired.base_stamp <= now:  # it was not overtaken by a newer one
            desired = desired._replace(base=np.array(command.base), base_stamp=stamp)
        if command.arm is not None and q is not None and not stamp < desired.arm_stamp <= now:
            desired = desired._replace(arm=np.array(command.arm), arm_stamp=stamp, arm_mode=command.arm_mode)
    arm_is_old, base_is_old = (
        not 0.0 <= now - stamp <= config.command_timeout for stamp in (desired.arm_stamp, desired.base_stamp)
    )
    if arm_is_old and base_is_old:
        age = now - max(desired.arm_stamp, desired.base_stamp)
        return desired, Stop("silence", f"There was no command for {age:.2f} s.", now)
    if arm_is_old and desired.arm_mode == "velocity":
        desired = desired._replace(arm=np.zeros(len(desired.arm)))
    if base_is_old:
        desired = desired._replace(base=np.zeros(3))
    return desired, None


def _moved(
    state: SafetyState, desired: DesiredVelocity, q: np.ndarray | None, stopping: bool, arm_dt: float, dt: float
) -> tuple[np.ndarray, np.ndarray, bool]:
    """The velocities of arm and base that may be sent, and whether they are less than desired."""
    config = state.config
    velocity, twist = np.zeros(len(state.velocity)), np.zeros(3)
    lower, upper, v_max, a_max = config.arm_arrays
    hold, held = config.longest_tick, False
    if q is not None and len(q):
        v = np.zeros(len(q))
        if desired.arm_mode == "position":
            hold += arm_dt  # the move of this step comes before what velocities would need to brake
            if not stopping and arm_dt > 0.0:
                before = state.desired.arm if state.desired.arm_mode == "position" else q
                _limit_kernels.follow(desired.arm, before, q, arm_dt, a_max, v)
        elif not stopping:
            v = desired.arm
        held = _limit_kernels.limit(v, state.velocity, arm_dt, hold, v_max, a_max, q - lower, upper - q, velocity)
    if config.base is not None:
        v_max, a_max, room = config.base_arrays
        v = np.zeros(3) if stopping else desired.base
        held |= _limit_kernels.limit(v, state.twist, dt, config.longest_tick, v_max, a_max, room, room, twist)
    return velocity, twist, held and not stopping


def _before_obstacles(
    config: SafetyConfig,
    around: ObstacleState,
    before: Float[np.ndarray, "3"],
    desired: Float[np.ndarray, "3"],
    twist: Float[np.ndarray, "3"],
    dt: float,
) -> tuple[ObstacleState, Float[np.ndarray, "3"]]:
    """Return the twist (3,) to send instead of one, so that the base can stop before what the laser has seen."""
    v_max, a_max, room = config.base_arrays
    fastest = desired / max(float(np.max(np.abs(desired) / v_max)), 1.0)
    part, nearest = obstacles.limited(around, fastest, a_max)
    if nearest is not None:
        twist = np.empty(3)
        _limit_kernels.limit(part * fastest, before, dt, config.longest_tick, v_max, a_max, room, room, twist)
    if nearest is not None or not np.array_equal(twist, fastest):  # it is on its way from another twist
        left, other = obstacles.limited(around, twist, a_max)
        if other is not None and left < 1.0:
            part, nearest, twist = min(part, left), other, np.empty(3)
            _limit_kernels.limit(np.zeros(3), before, dt, config.longest_tick, v_max, a_max, room, room, twist)
    return replace(around, part=part, nearest=nearest), twist
