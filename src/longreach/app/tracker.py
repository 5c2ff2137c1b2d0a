"""The loop that drives a robot along a plan: read, estimate, sample the plan, correct, guard, write.

`step` is one tick and only computes, whatever the robot is asked to do; `run` is the loop around it for one plan, and
the only one who speaks to the hardware. Nothing here knows who made the plan, or whether the robot is simulated.
`longreach.app.robot_side` is the loop around it for whoever commands the robot from outside.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.app.configuration import EstimateConfig
from longreach.app.goals import Follow, Goal, Hold, desired_command
from longreach.configuration import ConfigurationTrajectory
from longreach.control import base_contact, safety, ticker
from longreach.control.base_contact import ContactState
from longreach.control.hardware import Command, GripperCommand, Hardware, Readings
from longreach.control.safety import SafetyState
from longreach.control.safety_checks import Health, Innovation, Stop, places
from longreach.control.safety_config import SafetyConfig, limits_of
from longreach.control.ticker import Ticker
from longreach.control.whole_body import WholeBodyConfig
from longreach.errors import ControlError
from longreach.estimation.planar.state import Correction
from longreach.geometry import se2
from longreach.localization import localizer
from longreach.localization.localizer import LocalizerState, Output, Reading, Row
from longreach.measurement import Odometry, Wheels, WheelTicks
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator

_HALT = 0.25  # a stop that lasts longer ends the goal [s]; as long as a command counts
_BLOCKED, _BLOCKED_PART = 2.0, 0.02  # so long [s] may an obstacle leave less than this part of the speed; ours
_WAIT_FOR_JOINTS = 2.0  # [s] until a robot says where its arm is


class TrackerConfig(BaseModel):
    """Settings of the loop and of what runs in it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    whole_body: WholeBodyConfig = WholeBodyConfig()
    estimate: EstimateConfig = EstimateConfig()
    safety: SafetyConfig = SafetyConfig()
    before: float = Field(default=0.3, ge=0, description="The robot stands before the plan begins [s]; ours.")
    after: float = Field(default=0.5, ge=0, description="And after it has ended [s]; ours.")


class Tick(NamedTuple):
    """What one tick knew and did; q_reference (n,) of the goal, q (n,) as estimated, base first, both at `stamp` [s].

    covariance (3, 3) of the base's ξ; command: what left the gate; stop: why it stopped the robot, or None.
    rows: what is settled of the estimate now.
    """

    stamp: float
    q_reference: np.ndarray
    q: np.ndarray
    covariance: np.ndarray
    command: Command
    stop: Stop | None
    rows: Sequence[Row] = ()


@dataclass(frozen=True, slots=True, eq=False)
class TrackerState:
    """The loop's memory, and what the robot is asked to do, which may be exchanged between two ticks.

    commanded (3,): where the base would be if it did as it is commanded; contact: whether it has met something.
    blocked: since when an obstacle holds up the plan [s]; why: why the goal before ended early, empty where it did not.
    given: what the estimate gave out at the last tick.
    """

    robot: MobileManipulator
    config: TrackerConfig
    goal: Goal
    stamp: float
    arm: Float[np.ndarray, " m"]
    localizer: LocalizerState
    gate: SafetyState
    base_period: float
    base_due: float
    commanded: Float[np.ndarray, "3"]
    contact: ContactState = base_contact.NOTHING
    blocked: float | None = None
    why: str = ""
    given: Output | None = None

    @property
    def ended(self) -> bool:
        """Whether the plan, and the rest after it, is over; what is no plan does not end."""
        return isinstance(self.goal, Follow) and self.goal.at > self.goal.plan.duration + self.config.after


def init(
    robot: MobileManipulator,
    hardware: Hardware,
    goal: Goal,
    q: Float[np.ndarray, " n"],
    now: float,
    config: TrackerConfig | None = None,
) -> TrackerState:
    """Start at rest at q (n,), base first: where the run's own frame says that the robot is.

    Raises:
        ControlError: a plan is of other joints than the robot's, or does not begin near q.
    """
    config, capabilities = config or TrackerConfig(), hardware.capabilities
    if isinstance(goal, Follow):
        check_plan(robot, goal.plan, q, config)
    gate = safety.init(limits_of(capabilities, config.safety), now, q[robot.arm], robot)
    pose = q[robot.base] if robot.base.stop else np.zeros(3)
    where = localizer.init(robot.description, config.estimate, pose)
    return TrackerState(robot, config, goal, now, q[robot.arm], where, gate, 1.0 / capabilities.base_rate, now, pose)


def check_plan(
    robot: MobileManipulator, plan: ConfigurationTrajectory, q: Float[np.ndarray, " n"], config: TrackerConfig
) -> None:
    """Raise a ControlError where a plan is of other joints than the robot's, or does not begin near q (n,)."""
    if plan.q.shape[1] != robot.dof:
        raise ControlError(f"The plan is of {plan.q.shape[1]} joints, but {robot.name} has {robot.dof}.")
    apart = plan.q[0] - q
    if robot.base.stop:
        apart[2] = (
            np.remainder(apart[2] + np.pi, 2 * np.pi) - np.pi
        )  # the estimate's heading is wrapped, a plan's is not
    away = float(np.abs(apart).max())
    if away > config.safety.position_lag:
        raise ControlError(f"The plan begins {away:.2f} rad or m away from where the robot is; plan from there.")


def step(
    state: TrackerState, readings: Readings, heartbeat: float | None = None, gripper: GripperCommand | None = None
) -> tuple[TrackerState, Command, Tick]:
    """Return what may be sent at `readings.stamp`, and what it was made of.

    heartbeat: when the client was heard [s]; gripper: a new command for the fingers.
    """
    now, robot, config, goal = readings.stamp, state.robot, state.config, state.goal
    where, estimated = localizer.step(state.localizer, sensed(readings, robot.description))  # estimate
    belief = where.belief(now)
    arm = _arm(state, readings)
    q = np.concatenate([belief.pose[: robot.base.stop], arm])

    if isinstance(goal, Follow):  # the plan's clock stands while the robot is stopped, and slows down before obstacles
        around = state.gate.obstacles
        rate = 0.0 if state.gate.stop is not None else 1.0 if around is None else around.part
        goal = goal._replace(at=goal.at + rate * (now - state.stamp), rate=rate)
    desired, q_reference = desired_command(goal, robot, config.whole_body, q, now)  # sample the plan, correct
    if gripper is not None:
        desired = Command(now, gripper=gripper) if desired is None else replace(desired, gripper=gripper)

    innovations = tuple(_innovation(c) for c in estimated.corrections if c.dof or c.status == "refused")
    commanded, contact = state.commanded, state.contact
    if "wheels" in state.gate.config.stale_after:
        lasted = min(now - state.stamp, config.safety.command_timeout)  # beyond it a driver stops by itself
        commanded = se2.compose(commanded, se2.exp(lasted * state.gate.twist))
        contact = base_contact.step(contact, now, commanded, where.now.dead_reckoned, belief.pose)
    health = Health(innovations, heartbeat, belief.pose, contact.reason)
    gate, command = safety.step(state.gate, desired, readings, health, now)  # guard
    due = now > state.base_due - 1e-6
    if not due:
        command = replace(command, base=None)  # it takes commands at a slower pace, and goes on with the last
    base_due = max(state.base_due + state.base_period, now) if due else state.base_due
    tick = Tick(now, q_reference, q, belief.covariance[:3, :3], command, gate.stop, estimated.rows)
    after = replace(
        state,
        goal=goal,
        stamp=now,
        arm=arm,
        localizer=where,
        gate=gate,
        base_due=base_due,
        commanded=commanded,
        contact=contact,
        given=estimated,
    )
    return _ended_early(after, state.stamp), command, tick


def _ended_early(state: TrackerState, before: float) -> TrackerState:
    """Return the state without a goal that must not go on by itself: after a stop, or in front of an obstacle.

    before: of the tick before [s]: where the loop itself halted, the robot has stood since then.
    """
    stop, around, now = state.gate.stop, state.gate.obstacles, state.stamp
    blocked = around is not None and around.part < _BLOCKED_PART and isinstance(state.goal, Follow) and stop is None
    since = (state.blocked or now) if blocked else None
    why = ""
    if stop is not None and (stop.latched or stop.cause == "client gone" or now - min(stop.since, before) > _HALT):
        why = stop.reason
    elif around is not None and since is not None and now - since > _BLOCKED:
        why = f"{around.reason} The plan has waited {_BLOCKED:g} s for it to go."
    if not why:
        return replace(state, blocked=since)
    return replace(state, goal=Hold(), blocked=None, why=state.why if isinstance(state.goal, Hold) else why)


def sensed(readings: Readings, robot: RobotDescription) -> list[Reading]:
    """Return what a localizer takes of the readings; which of two kinds came first is not known, so by their stamps."""
    wheels = [one for one in readings.wheels if not wheels_fault(one, robot)]
    return sorted([*wheels, *readings.imu, *readings.scans], key=lambda reading: reading.stamp)


def wheels_fault(record: Wheels, robot: RobotDescription) -> str:
    """Return why wheels' readings are not the robot's, as the end of a sentence that starts with "each"; else ""."""
    if isinstance(record, Odometry) or robot.base is None:
        return ""
    count, wheels = len(record.ticks if isinstance(record, WheelTicks) else record.speeds), robot.base.wheel_names
    return "" if count == len(wheels) else f"has {count} numbers for {len(wheels)} wheels"


def _arm(state: TrackerState, readings: Readings) -> np.ndarray:
    """Return where the arm's joints are (m,), carried on from the newest joint state to now."""
    names = state.robot.joint_names[state.robot.arm]
    for record in reversed(readings.joints):
        where = places(record.names, names)
        if where is not None and np.isfinite(record.position[where]).all():
            q = record.position[where]
            ahead = readings.stamp - record.stamp
            if len(record.velocity) == len(record.names) and 0.0 < ahead < 0.1:
                velocity = record.velocity[where]
                q = q + ahead * np.where(np.isfinite(velocity), velocity, 0.0)
            return q
    return state.arm + state.gate.velocity * (readings.stamp - state.stamp)


def _innovation(correction: Correction) -> Innovation:
    """Return what the gate knows of a correction; what was refused is as far off as can be."""
    if correction.status == "refused":
        return Innovation(correction.source, math.inf, 1)
    return Innovation(correction.source, correction.nis, correction.dof)


@dataclass(frozen=True, eq=False)
class Run:
    """What came of a run: its ticks and readings, and how late and how long each tick was.

    rows: the estimate at each stamp with all that was measured up to then, what came late included.
    reason: why it ended before the plan did; empty where it did not.
    """

    ticks: Sequence[Tick]
    readings: Sequence[Readings]
    rows: Sequence[Row]
    ticker: Ticker
    reason: str


def run(
    hardware: Hardware,
    wait_until: Callable[[float], None],
    robot: MobileManipulator,
    plan: ConfigurationTrajectory,
    base: Float[np.ndarray, "3"],
    config: TrackerConfig | None = None,
    watch: Callable[[Tick, float], None] | None = None,
    heartbeat: Callable[[], float] | None = None,
) -> Run:
    """Drive a robot along a plan, and stop it when the plan has ended or whatever else ends the run.

    Arguments:
        wait_until: returns at a time of the hardware's clock [s]; a simulation's lets that time pass.
        base: where the base is at the start [m, m, rad], in the plan's frame.
        watch: called after each tick with it and how much of the plan is done, 0 to 1.
        heartbeat: tells when the client was heard last [s], where one is (`SafetyConfig.heartbeat_timeout`).

    Raises:
        ControlError: the robot does not say where its arm is, or the plan does not begin there.
    """
    config = config or TrackerConfig()
    state, kept = begin(hardware, wait_until, robot, Follow(plan, -config.before), base, config)
    now = state.stamp
    rhythm = ticker.init(1.0 / hardware.capabilities.arm_rate, now)
    ticks: list[Tick] = []
    rows: list[Row] = []
    reason = "interrupted"
    try:
        while not state.ended and isinstance(state.goal, Follow):
            wait_until(rhythm.due)
            readings = hardware.read()
            rhythm, began = ticker.tick(rhythm, readings.stamp), time.perf_counter()
            state, command, tick = step(state, readings, None if heartbeat is None else heartbeat())
            hardware.write(command)
            rhythm = replace(rhythm, busy=ticker.counted(rhythm.busy, time.perf_counter() - began))
            rows += tick.rows
            ticks.append(tick)
            kept.append(readings)
            if watch is not None:
                watch(tick, state.goal.progress if isinstance(state.goal, Follow) else 0.0)
        reason = state.why
    finally:
        hardware.stop(reason or "The plan has ended.")
    return Run(ticks, kept, [*rows, *localizer.settled(state.localizer).rows], rhythm, reason)


def begin(
    hardware: Hardware,
    wait_until: Callable[[float], None],
    robot: MobileManipulator,
    goal: Goal,
    base: Float[np.ndarray, "3"],
    config: TrackerConfig,
) -> tuple[TrackerState, list[Readings]]:
    """Return the loop before its first tick, and what was read until the robot said where its arm is."""
    kept, arm = _first_readings(hardware, wait_until, robot)
    state = init(robot, hardware, goal, np.concatenate([base[: robot.base.stop], arm]), kept[-1].stamp, config)
    where, _ = localizer.step(
        state.localizer, [one for readings in kept for one in sensed(readings, robot.description)]
    )
    return replace(state, localizer=where), kept


def _first_readings(
    hardware: Hardware, wait_until: Callable[[float], None], robot: MobileManipulator
) -> tuple[list[Readings], np.ndarray]:
    """Read until the robot says where its arm is; return what was read, and the arm's joints (m,)."""
    names = robot.joint_names[robot.arm]
    kept = [hardware.read()]
    until = kept[0].stamp + _WAIT_FOR_JOINTS
    while True:
        for record in reversed(kept[-1].joints):
            where = places(record.names, names)
            if where is not None and np.isfinite(record.position[where]).all():
                return kept, record.position[where]
        if kept[-1].stamp > until:
            raise ControlError(
                f"The robot has not said in {_WAIT_FOR_JOINTS:g} s where its arm is: {', '.join(names)}."
            )
        wait_until(kept[-1].stamp + 1.0 / hardware.capabilities.arm_rate)
        kept.append(hardware.read())
