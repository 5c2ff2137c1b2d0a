"""The joint trajectory controller: follows timed points, watches the tolerances, says how it ended.

What ros_control's does: path tolerances on the way, goal tolerances and a speed at which a joint counts as standing at
the end, and a goal time that it may come late by. Where it gives up it stands where it is, and the reason is a value.
Source: ros_control, joint_trajectory_controller, and control_msgs/FollowJointTrajectory.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.configuration import ConfigurationTrajectory
from longreach.control import pid
from longreach.control.hardware import ArmMode
from longreach.control.interpolation import Degree, sample
from longreach.errors import ControlError

Status = Literal["idle", "running", "reached", "path tolerance violated", "goal time exceeded"]
_Tolerance = Annotated[float, Field(gt=0)]


class JointTrajectoryConfig(BaseModel):
    """Settings of the joint trajectory controller; a tolerance is one number for all joints, or one a joint."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["joint_trajectory"] = "joint_trajectory"
    degree: Degree = Field(default="cubic", description="Interpolation between the points; ros_control: cubic.")
    command: ArmMode = Field(default="velocity", description="What is commanded: the UR10 takes both.")
    gains: pid.PidConfig = Field(default=pid.PidConfig(), description="From position error [rad] to velocity [rad/s].")
    path_tolerance: tuple[_Tolerance, ...] = Field(
        default=(0.1,), min_length=1, description="Largest error on the way [rad]; ours."
    )
    goal_tolerance: tuple[_Tolerance, ...] = Field(
        default=(0.01,), min_length=1, description="Largest error at the end [rad]; ours."
    )
    path_velocity_tolerance: tuple[_Tolerance, ...] = Field(
        default=(math.inf,),
        min_length=1,
        description="Largest one of the velocity on the way [rad/s]; ros_control: any.",
    )
    stopped_velocity: _Tolerance | tuple[_Tolerance, ...] = Field(
        default=0.01, description="Below this a joint stands [rad/s]; ros_control's stopped_velocity_tolerance."
    )
    goal_time: float = Field(default=0.5, ge=0, description="How late the end may be reached [s]; ours.")


class JointInput(NamedTuple):
    """Where the joints are and how fast, (n,) each [rad, rad/s], as measured or estimated."""

    q: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " n"]


class JointOutput(NamedTuple):
    """The joints' commands (n,), as `mode` says, where they should be and by how much they are not (n,) [rad]."""

    arm: Float[np.ndarray, " n"]
    mode: ArmMode
    reference: Float[np.ndarray, " n"]
    error: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True, eq=False)
class JointTrajectoryState:
    """What is followed since when [s], how it goes, and the sentence about it; `hold` (n,): where it gave up."""

    config: JointTrajectoryConfig
    stamp: float
    trajectory: ConfigurationTrajectory | None = None
    start: float = 0.0
    correction: pid.PidState | None = None
    status: Status = "idle"
    reason: str = "There is no trajectory to follow."
    hold: np.ndarray | None = None


def init(config: JointTrajectoryConfig, now: float) -> JointTrajectoryState:
    """Start without a trajectory: the joints stand where they are."""
    return JointTrajectoryState(config, now)


def follow(
    state: JointTrajectoryState, trajectory: ConfigurationTrajectory, start: float | None = None
) -> JointTrajectoryState:
    """Follow a trajectory instead of what was followed before; its first row is due at `start` [s], None: now.

    Raises:
        ControlError: tolerances or gains are of another number of joints.
    """
    joints, config = trajectory.q.shape[1], state.config
    gains = config.gains
    for name, numbers in {
        "path_tolerance": config.path_tolerance,
        "goal_tolerance": config.goal_tolerance,
        "path_velocity_tolerance": config.path_velocity_tolerance,
        "stopped_velocity": np.atleast_1d(config.stopped_velocity),
        **{f"gains.{name}": getattr(gains, name) for name in ("p", "i", "d", "output_limit")},
    }.items():
        if len(numbers) not in (1, joints):
            raise ControlError(f"{name} has {len(numbers)} numbers for {joints} joints; give one, or one a joint.")
    start = state.stamp if start is None else start
    return JointTrajectoryState(config, state.stamp, trajectory, start, pid.init(joints), "running", "On the way.")


def step(state: JointTrajectoryState, measured: JointInput, now: float) -> tuple[JointTrajectoryState, JointOutput]:
    """Return what to tell the joints at `now` [s], and how it goes in the new state.

    Raises:
        ControlError: the trajectory is of another number of joints than were measured.
    """
    config, trajectory = state.config, state.trajectory
    if trajectory is not None and trajectory.q.shape[1] != len(measured.q):
        raise ControlError(f"A trajectory of {trajectory.q.shape[1]} joints cannot move {len(measured.q)}.")
    if trajectory is not None and state.hold is None:
        t = trajectory.stamps[0] + (now - state.start)
        q, qd, _ = sample(trajectory, float(t), config.degree)
        error = q - measured.q
        after = float(t - trajectory.stamps[-1])
        status, reason = _judged(state, error, measured.velocity, qd - measured.velocity, after)
        if status in ("running", "reached"):
            assert state.correction is not None
            inner, correction = pid.step(config.gains, state.correction, error, now - state.stamp)
            arm = q if config.command == "position" else qd + correction
            state = replace(state, stamp=now, correction=inner, status=status, reason=reason)
            return state, JointOutput(arm, config.command, q, error)
        state = replace(state, status=status, reason=reason)
    hold = measured.q if state.hold is None else state.hold
    arm = hold if config.command == "position" else np.zeros(len(hold))
    return replace(state, stamp=now, hold=hold), JointOutput(arm, config.command, hold, hold - measured.q)


def _judged(
    state: JointTrajectoryState, error: np.ndarray, velocity: np.ndarray, off: np.ndarray, after: float
) -> tuple[Status, str]:
    """How it goes, `after` [s] after the end (negative: before it), and a sentence."""
    config = state.config
    if state.status == "reached":
        return state.status, state.reason
    if after <= 0.0:
        worst = _worst(state, error, config.path_tolerance)
        worst = worst or _worst(state, off, config.path_velocity_tolerance, " rad/s")
        if worst:
            return "path tolerance violated", f"{worst}, {-after:.2f} s before the end."
        return "running", "On the way."
    worst = _worst(state, error, config.goal_tolerance)
    if not worst and np.all(np.abs(velocity) <= np.asarray(config.stopped_velocity)):
        return "reached", f"The goal was reached {after:.2f} s after its time."
    if after <= config.goal_time:
        return "running", "Past the last point, on the way into the goal's tolerance."
    return "goal time exceeded", f"{worst or 'A joint does not stand still'}, {after:.2f} s after the end."


def _worst(state: JointTrajectoryState, error: np.ndarray, tolerance: tuple[float, ...], unit: str = "") -> str:
    """Return the joint that is furthest beyond its tolerance, as half a sentence; empty: none is. NaN is beyond."""
    part = np.abs(error) / np.asarray(tolerance)
    if np.all(part <= 1.0):
        return ""
    assert state.trajectory is not None
    i = int(np.argmax(np.where(np.isnan(part), np.inf, part)))
    names = state.trajectory.joint_names
    bound = np.broadcast_to(tolerance, part.shape)[i]
    return f"{names[i] if names else f'Joint {i} (from 0)'} is {abs(error[i]):.3f}{unit} off, {bound:g} are allowed"
