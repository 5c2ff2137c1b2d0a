"""The robot's side of a system that others command: `tracker`'s loop around whatever is asked for from outside.

All that is critical in time happens here. Commands and plans come as `Orders`, from wherever; what the loop knew and
did goes out as a `TickRecord`, to whomever. There is no network in here.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.app import tracker
from longreach.app.goals import Follow, Goal, Hold, VelocityGoal
from longreach.app.tracker import Tick, TrackerConfig, TrackerState
from longreach.control import base_contact, safety, ticker
from longreach.control.hardware import Command, GripperCommand, Hardware, Readings
from longreach.control.safety_checks import Stop
from longreach.control.ticker import Ticker
from longreach.robot.mobile_manipulator import MobileManipulator

_THERE, _LATE = 0.005, 3.0  # so near is a plan's end reached [rad, m], and so long is it waited for at most [s]; ours


class Orders(NamedTuple):
    """What has come since the last tick.

    goal: what to do from now on; stop: why to stop at once, until a reset; heartbeat: when whoever holds the robot was
    heard last [s], None where nobody does.
    """

    goal: Goal | None = None
    gripper: GripperCommand | None = None
    stop: str = ""
    reset: bool = False
    heartbeat: float | None = None


class TickRecord(NamedTuple):
    """What one tick knew and did; loop_time [s]: what the tick took."""

    tick: Tick
    readings: Readings
    state: TrackerState
    loop_time: float

    @property
    def wheels(self) -> Float[np.ndarray, "3"]:
        """The base's pose by the wheels alone."""
        return self.state.localizer.now.dead_reckoned


def step(state: TrackerState, readings: Readings, orders: Orders) -> tuple[TrackerState, Command, Tick]:
    """Take the orders and do one tick."""
    now, gate = readings.stamp, state.gate
    goal = _carried_on(state, now) if orders.goal is None else orders.goal  # a Hold is empty, and so false
    contact = state.contact
    if orders.reset:
        gate, contact = safety.reset(gate), base_contact.NOTHING
    if orders.stop:
        gate = replace(gate, stop=Stop("emergency stop", orders.stop, now, True))
    heartbeat = now if orders.heartbeat is None else orders.heartbeat  # where nobody holds the robot nobody is missed
    holds = isinstance(state.goal, Hold) and isinstance(goal, Hold)  # and is asked to: that is no new goal
    why = state.why if orders.goal is None or holds else ""
    return tracker.step(
        replace(state, goal=goal, gate=gate, contact=contact, why=why), readings, heartbeat, orders.gripper
    )


def _carried_on(state: TrackerState, now: float) -> Goal:
    """Return what to do where nothing new was asked for: the same, as long as there is a reason to."""
    goal = state.goal
    if isinstance(goal, VelocityGoal):
        fresh = now - goal.stamp <= state.config.safety.command_timeout
        return goal._replace(command=None) if fresh else Hold()
    return Hold() if state.ended and _arrived(state, goal, now) else goal


def _arrived(state: TrackerState, goal: Goal, now: float) -> bool:
    """Whether the robot is where its plan has ended, or has had the time to get there: a slow machine lags behind."""
    if not isinstance(goal, Follow) or goal.at > goal.plan.duration + state.config.after + _LATE:
        return True
    pose = state.localizer.belief(now).pose[: state.robot.base.stop]
    return bool(np.abs(np.concatenate([pose, state.arm]) - goal.plan.q[-1]).max() < _THERE)


def run(
    hardware: Hardware,
    wait_until: Callable[[float], None],
    robot: MobileManipulator,
    base: Float[np.ndarray, "3"],
    take: Callable[[float], Orders],
    publish: Callable[[TickRecord], None],
    ended: Callable[[], str],
    config: TrackerConfig | None = None,
) -> Ticker:
    """Serve the robot until somebody says why it shall end; then it is stopped by its own means.

    Arguments:
        wait_until: returns at a time of the hardware's clock [s].
        base: where the base is at the start [m, m, rad]: this lays down the frame map.
        take: returns what has come since it was called last, given the time [s].
        publish: is given what each tick knew and did.
        ended: returns why the loop shall end, or an empty string.

    Raises:
        ControlError: the robot does not say where its arm is.
    """
    state, _ = tracker.begin(hardware, wait_until, robot, Hold(), base, config or TrackerConfig())
    rhythm, reason = ticker.init(1.0 / hardware.capabilities.arm_rate, state.stamp), "interrupted"
    try:
        while not (over := ended()):
            wait_until(rhythm.due)
            readings = hardware.read()
            rhythm, began = ticker.tick(rhythm, readings.stamp), time.perf_counter()
            state, command, tick = step(state, readings, take(readings.stamp))
            hardware.write(command)
            took = time.perf_counter() - began
            rhythm = replace(rhythm, busy=ticker.counted(rhythm.busy, took))
            publish(TickRecord(tick, readings, state, took))
        reason = over
    finally:
        hardware.stop(reason)
    return rhythm
