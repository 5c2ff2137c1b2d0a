"""The reasons for which the safety gate stops the robot, each a sentence, the gravest first."""

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.control.hardware import Command, GripperCommand, Readings
from longreach.control.safety_config import SafetyConfig

Cause = Literal[
    "emergency stop", "contact", "divergence", "late tick", "stale data", "client gone", "bad command", "silence"
]

NOT_HEARD = "The client was not heard"


class Stop(NamedTuple):
    """Why the robot is being stopped, since when [s], and whether it stays so until `reset`."""

    cause: Cause
    reason: str
    since: float
    latched: bool = False


class Innovation(NamedTuple):
    """How far one measurement was from what the estimate expected, as the filter reported it."""

    source: str
    nis: float
    dof: int


class Health(NamedTuple):
    """What is known of the estimate and of the client: new innovations, and when the client was heard last [s].

    pose (3,): where the base is, in a frame that stands still and does not jump; None: as it was commanded.
    contact: what the base has met, as a sentence (`base_contact`).
    """

    innovations: tuple[Innovation, ...] = ()
    heartbeat: float | None = None
    pose: Float[np.ndarray, "3"] | None = None
    contact: str = ""


class Watch(NamedTuple):
    """What the checks remember: the stamp of each source's newest reading [s], and each streak of high NIS.

    rest (3,): the mean of the IMU's acceleration, gravity for the most part; jolt: the largest level acceleration
    beyond it at this tick [m/s²].
    """

    since: float
    seen: Mapping[str, float]
    streaks: Mapping[str, int]
    rest: np.ndarray | None = None
    jolt: float = 0.0


def watch(state: Watch, config: SafetyConfig, readings: Readings, health: Health) -> Watch:
    """Take note of what came in; a record with a number that is not finite did not come (a scan's may)."""
    seen = state.seen
    for source in config.stale_after:
        usable = [r.stamp for r in getattr(readings, source) if _usable(source, r)]
        if usable:
            seen = {**seen, source: usable[-1]}
    rest, jolt = state.rest, 0.0
    for imu in readings.imu:
        if imu.acceleration is not None and _usable("imu", imu):
            rest, jolt = _jolted(rest, imu.acceleration, jolt)
    state = state._replace(seen=seen, rest=rest, jolt=jolt)
    if not health.innovations:
        return state
    streaks = dict(state.streaks)
    for source, nis, dof in health.innovations:
        if dof > 0:
            streaks[source] = 0 if nis <= config.nis_bound(dof) else streaks.get(source, 0) + 1
    return state._replace(streaks=streaks)


def _jolted(rest: np.ndarray | None, acceleration: np.ndarray, before: float) -> tuple[np.ndarray, float]:
    """Return the new mean of accelerations, and how far one is from it across gravity, or what was further before."""
    if rest is None:
        return acceleration, before
    away, up = acceleration - rest, rest / max(float(np.linalg.norm(rest)), 1e-9)
    level = away - (away @ up) * up
    return rest + _MEAN * away, max(before, math.sqrt(level @ level))


_MEAN = 0.02  # part of a reading in the mean of accelerations: half a second at 100 Hz; ours
_NUMBERS = {"imu": ("angular_velocity", "acceleration"), "joints": ("position",), "wrenches": ("force", "torque")}


def finite(array: Float[np.ndarray, " n"]) -> bool:
    """Whether all numbers are finite, and small enough for their squares to be; a fifth of numpy's own way's time."""
    return math.isfinite(array.dot(array))


def _usable(source: str, record: Any) -> bool:
    if not math.isfinite(record.stamp):
        return False
    names = _NUMBERS.get(source, ())
    if source == "wheels":
        names = ("speeds", "ticks", "twist", "pose")
    values = (getattr(record, name, None) for name in names)
    return all(finite(value) for value in values if value is not None)


def latching_stop(config: SafetyConfig, state: Watch, readings: Readings, health: Health, now: float) -> Stop | None:
    """Return the stop that holds until it is reset: emergency stop, contact, divergence."""
    if readings.emergency_stop:
        return Stop("emergency stop", "The emergency stop is pressed.", now, True)
    if health.contact:
        return Stop("contact", health.contact, now, True)
    for wrench in readings.wrenches:
        force, torque = math.hypot(*wrench.force.tolist()), math.hypot(*wrench.torque.tolist())
        if force > config.force_limit:
            reason = f"The tool touches something: {force:.0f} N, the limit is {config.force_limit:g} N."
            return Stop("contact", reason, now, True)
        if torque > config.torque_limit:
            reason = f"The tool touches something: {torque:.1f} N·m, the limit is {config.torque_limit:g} N·m."
            return Stop("contact", reason, now, True)
    if state.jolt > config.jolt_limit:
        reason = f"The base has hit something: {state.jolt:.0f} m/s², the limit is {config.jolt_limit:g} m/s²."
        return Stop("contact", reason, now, True)
    for source, streak in state.streaks.items():
        if streak >= config.divergence_streak:
            reason = f"The estimate has diverged: {streak} measurements of {source} in a row are far from it."
            return Stop("divergence", reason, now, True)
    return None


def transient_stop(config: SafetyConfig, state: Watch, health: Health, dt: float, now: float) -> Stop | None:
    """Return the stop that ends with its cause: a late tick, stale data, a client that is gone."""
    if not 0.0 <= dt <= config.longest_tick:
        reason = f"{dt:.3f} s went by since the last tick; {config.longest_tick:g} s are allowed."
        return Stop("late tick", reason, now)
    for source, patience in config.stale_after.items():
        age = now - state.seen.get(source, state.since)
        if not abs(age) <= patience:
            return Stop("stale data", f"The newest of {source} is {age:.3f} s old; {patience:g} s are allowed.", now)
    if config.heartbeat_timeout is not None:
        heard = state.since if health.heartbeat is None else health.heartbeat
        if not now - heard <= config.heartbeat_timeout:
            return Stop("client gone", f"{NOT_HEARD} for {now - heard:.2f} s.", now)
    return None


def fault(config: SafetyConfig, command: Command, q: np.ndarray | None) -> str:
    """Return why a command cannot be used where the arm is at q (n,), or an empty string."""
    arm, base, gripper = command.arm, command.base, command.gripper
    joints = 0 if config.arm is None else len(config.arm.names)
    if arm is not None and len(arm) != joints:
        return f"The command's arm has {len(arm)} numbers, but the arm has {joints} joints."
    if base is not None and config.base is None:
        return "The command moves a base, but there is none."
    usable = (arm is None or finite(arm)) and (base is None or finite(base))
    if not (usable and math.isfinite(command.stamp) and (gripper is None or math.isfinite(gripper.value))):
        return "The command has a number that is not finite."
    if arm is not None and q is not None and command.arm_mode == "position" and joints:
        away = float(np.abs(arm - q).max())
        if away > config.position_lag:
            return f"The commanded position is {away:.2f} rad away; {config.position_lag:g} rad are allowed."
    return ""


def within(config: SafetyConfig, command: GripperCommand | None) -> GripperCommand | None:
    """Return the gripper's command within its limits."""
    if command is None:
        return None
    top = {"velocity": config.gripper_velocity, "force": config.gripper_force}.get(command.mode)
    low, high = (0.0, 1.0) if top is None else (-top, top)
    return GripperCommand(command.mode, min(max(command.value, low), high))


@lru_cache(maxsize=64)
def places(names: tuple[str, ...], arm: tuple[str, ...]) -> list[int] | None:
    """Return where a joint state of `names` holds the arm's joints, or None where it does not hold them all."""
    return [names.index(name) for name in arm] if set(arm) <= set(names) else None
