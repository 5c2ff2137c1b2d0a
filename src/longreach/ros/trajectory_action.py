"""The FollowJointTrajectory action of an arm, as ros_control's joint trajectory controller offers it.

The protocol is actionlib's: goals and cancellations come in on topics, status, feedback and results go out. A new goal
takes the place of the one before. Goals come in on rospy's threads and are taken at the next tick.
Source: wiki.ros.org/actionlib/DetailedDescription; control_msgs/FollowJointTrajectory.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from pydantic import ValidationError

from longreach.control import joint_trajectory
from longreach.control.hardware import Promises
from longreach.control.interpolation import sample
from longreach.control.joint_trajectory import JointInput, JointOutput, JointTrajectoryConfig, JointTrajectoryState
from longreach.io import messages
from longreach.ros import wire
from longreach.ros.trajectory_points import GoalError, seconds, trajectory_of

_ACTIVE, _PREEMPTED, _SUCCEEDED, _ABORTED, _REJECTED = 1, 2, 3, 4, 5  # actionlib_msgs/GoalStatus
_CODES = {"reached": 0, "path tolerance violated": -4, "goal time exceeded": -5}
_KEPT = 5.0  # [s] that the status of a goal is told after its end; actionlib's
_STATUS_PERIOD, _FEEDBACK_PERIOD = 0.2, 0.05  # [s]; actionlib's, ros_control's
_ACTION = "control_msgs/msg/FollowJointTrajectory"


@dataclass
class _Goal:
    """One goal that was heard of: its message's id, how it stands, and since when it is over [s]."""

    id: Any
    status: int
    text: str = ""
    ended: float = math.inf


class TrajectoryAction:
    """The action's server under CONTROLLER/follow_joint_trajectory; also takes trajectories on CONTROLLER/command."""

    def __init__(self, controller: str, promises: Promises, config: JointTrajectoryConfig | None = None) -> None:
        self._names, self._limits = promises.arm_names, promises.arm_limits
        self._config = config or JointTrajectoryConfig()
        self._goals: list[_Goal] = []
        self._current: _Goal | None = None
        self._follower: JointTrajectoryState | None = None
        self._told, self._fed = -math.inf, -math.inf
        self._inbox: deque[tuple[str, Any]] = deque()
        name = f"{controller}/follow_joint_trajectory"
        self._status = wire.Publisher(f"{name}/status", "actionlib_msgs/msg/GoalStatusArray")
        self._feedback = wire.Publisher(f"{name}/feedback", f"{_ACTION}ActionFeedback")
        self._result = wire.Publisher(f"{name}/result", f"{_ACTION}ActionResult")
        listened = {
            "goal": (f"{name}/goal", f"{_ACTION}ActionGoal"),
            "cancel": (f"{name}/cancel", "actionlib_msgs/msg/GoalID"),
            "command": (f"{controller}/command", "trajectory_msgs/msg/JointTrajectory"),
        }
        for what, (topic, kind) in listened.items():
            wire.listen(topic, (kind,), lambda message, what=what: self._inbox.append((what, message)), wire.complain)

    def step(self, measured: JointInput, now: float, stopped: str = "") -> Float[np.ndarray, " n"] | None:
        """Take what came in, and return the arm's velocities (n,) [rad/s] at `now` [s]; None: nothing is followed.

        now is on the robot's clock, by which it moves, whatever ROS' clock does meanwhile. stopped: why the safety
        gate stops the robot until it is reset; goals are refused then.
        """
        while self._inbox:
            what, message = self._inbox.popleft()
            if what == "cancel":
                self._cancel(message, now)
            elif what == "goal":
                self._take(message, measured, now, stopped)
            else:
                self._command(message, measured, now)
        if stopped and self._follower is not None:
            self._end(_ABORTED, _CODES["path tolerance violated"], stopped, now)
            self._follower = None
        output = self._follow(measured, now)
        if now - self._told >= _STATUS_PERIOD:
            self._tell(now)
        return None if output is None else output.arm

    def drop(self, now: float) -> None:
        """Follow nothing any more, for the arm is told something else."""
        self._end(_PREEMPTED, 0, "The arm was commanded otherwise.", now)
        self._follower = None

    def _follow(self, measured: JointInput, now: float) -> JointOutput | None:
        if self._follower is None:
            return None
        before = self._follower.status
        self._follower, output = joint_trajectory.step(self._follower, measured, now)
        status = self._follower.status
        if status != before and status in _CODES:
            ended = _SUCCEEDED if status == "reached" else _ABORTED
            self._end(ended, _CODES[status], self._follower.reason, now)
        if self._current is not None and now - self._fed >= _FEEDBACK_PERIOD:
            self._fed = now
            self._feed(self._current, output, measured)
        return output

    def _take(self, message: Any, measured: JointInput, now: float, stopped: str) -> None:
        goal = _Goal(_identified(message.goal_id, wire.now()), _ACTIVE, "On the way.")
        self._goals.append(goal)
        try:
            if stopped:
                raise GoalError(-1, stopped)
            here = self._desired(measured, now)
            trajectory, late = trajectory_of(message.goal.trajectory, self._names, self._limits, here, wire.now())
            follower = joint_trajectory.init(self._tolerances(message.goal), now)
            self._end(_PREEMPTED, 0, "A newer goal took its place.", now)
            self._follower = joint_trajectory.follow(follower, trajectory, now - late)
        except GoalError as error:
            self._conclude(goal, _REJECTED, error.code, str(error), now)
            return
        self._current = goal
        self._tell(now)

    def _command(self, message: Any, measured: JointInput, now: float) -> None:
        if not message.points:  # ros_control stops then
            return self.drop(now)
        try:
            here = self._desired(measured, now)
            trajectory, late = trajectory_of(message, self._names, self._limits, here, wire.now())
        except GoalError as error:
            return wire.complain(str(error))
        self._end(_PREEMPTED, 0, "A trajectory on the command topic took its place.", now)
        self._follower = joint_trajectory.follow(joint_trajectory.init(self._config, now), trajectory, now - late)

    def _desired(self, measured: JointInput, now: float) -> JointInput:
        """Return where the joints should be, from where a new trajectory goes on; without one where they are."""
        follower = self._follower
        if follower is None or follower.trajectory is None or follower.hold is not None:
            return measured
        t = float(follower.trajectory.stamps[0]) + now - follower.start
        q, velocity, _ = sample(follower.trajectory, t, follower.config.degree)
        return JointInput(q, velocity)

    def _tolerances(self, goal: Any) -> JointTrajectoryConfig:
        """Return the settings with a goal's own tolerances; 0 is the default, less than 0 none at all."""
        changes: dict[str, Any] = {}
        for what in ("path_tolerance", "goal_tolerance"):
            given = {tolerance.name: tolerance.position for tolerance in getattr(goal, what) if tolerance.position}
            usual = np.broadcast_to(getattr(self._config, what), len(self._names)).tolist()
            values = (given.get(name, value) for name, value in zip(self._names, usual, strict=True))
            changes[what] = tuple(math.inf if value < 0 else value for value in values)
        if late := seconds(goal.goal_time_tolerance):
            changes["goal_time"] = late if late > 0 else math.inf
        try:
            return JointTrajectoryConfig(**{**self._config.model_dump(), **changes})
        except ValidationError as error:
            raise GoalError(-1, "A tolerance of the goal is not a number; leave it at 0 for the usual one.") from error

    def _cancel(self, message: Any, now: float) -> None:
        """End goals: the one with this id, those up to a time, or all, where neither is given."""
        goal, time = self._current, seconds(message.stamp)
        if goal is None:
            return
        everything = not message.id and time == 0.0
        if everything or message.id == goal.id.id or 0.0 < seconds(goal.id.stamp) <= time:
            self._end(_PREEMPTED, 0, "It was cancelled.", now)
            self._follower = None

    def _end(self, status: int, code: int, text: str, now: float) -> None:
        if self._current is not None:
            goal, self._current = self._current, None
            self._conclude(goal, status, code, text, now)

    def _conclude(self, goal: _Goal, status: int, code: int, text: str, now: float) -> None:
        goal.status, goal.text, goal.ended = status, text, now
        types = wire.message_types()
        result = types[f"{_ACTION}Result"](code, text)
        self._result.send(
            types[f"{_ACTION}ActionResult"](messages.header(types, wire.now(), ""), self._status_of(goal), result)
        )
        self._tell(now)

    def _status_of(self, goal: _Goal) -> Any:
        return wire.message_types()["actionlib_msgs/msg/GoalStatus"](goal.id, goal.status, goal.text)

    def _tell(self, now: float) -> None:
        """Tell how all goals stand that are not long over."""
        self._told = now
        self._goals = [goal for goal in self._goals if now - goal.ended < _KEPT or goal is self._current]
        types = wire.message_types()
        told = [self._status_of(goal) for goal in self._goals]
        self._status.send(types["actionlib_msgs/msg/GoalStatusArray"](messages.header(types, wire.now(), ""), told))

    def _feed(self, goal: _Goal, output: JointOutput, measured: JointInput) -> None:
        types, none = wire.message_types(), np.zeros(0)
        Point, Duration = types["trajectory_msgs/msg/JointTrajectoryPoint"], types["builtin_interfaces/msg/Duration"]
        points = [
            Point(q, v, none, none, Duration(0, 0))
            for q, v in ((output.reference, none), (measured.q, measured.velocity), (output.error, none))
        ]
        feedback = types[f"{_ACTION}Feedback"](messages.header(types, wire.now(), ""), list(self._names), *points)
        self._feedback.send(
            types[f"{_ACTION}ActionFeedback"](messages.header(types, wire.now(), ""), self._status_of(goal), feedback)
        )


def _identified(id: Any, now: float) -> Any:
    """Return a goal's id with a stamp, which whoever sent it may have left out."""
    if seconds(id.stamp) == 0.0:
        id.stamp = messages.header(wire.message_types(), now, "").stamp
    id.id = id.id or f"goal-{now:.9f}"
    return id
