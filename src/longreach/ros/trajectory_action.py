"""The FollowJointTrajectory action of an arm, as ros_control's joint trajectory controller offers it.

Source: control_msgs/FollowJointTrajectory; ros_control, joint_trajectory_controller.
"""

import math
from typing import Any

import numpy as np
from jaxtyping import Float
from pydantic import ValidationError

from longreach.control import joint_trajectory
from longreach.control.hardware import Capabilities
from longreach.control.interpolation import sample
from longreach.control.joint_trajectory import JointInput, JointOutput, JointTrajectoryConfig, JointTrajectoryState
from longreach.io import messages
from longreach.ros import wire
from longreach.ros.goals import ABORTED, PREEMPTED, REJECTED, SUCCEEDED, Goals
from longreach.ros.trajectory_points import GoalError, seconds, trajectory_of

_CODES = {"reached": 0, "path tolerance violated": -4, "goal time exceeded": -5}
_ACTION = "control_msgs/msg/FollowJointTrajectory"


class TrajectoryAction:
    """The action's server under CONTROLLER/follow_joint_trajectory; also takes trajectories on CONTROLLER/command."""

    def __init__(
        self, controller: str, capabilities: Capabilities, config: JointTrajectoryConfig | None = None
    ) -> None:
        self._names, self._limits = capabilities.arm_names, capabilities.arm_limits
        self._config = config or JointTrajectoryConfig()
        self._follower: JointTrajectoryState | None = None
        self._goals = Goals(f"{controller}/follow_joint_trajectory", _ACTION)
        self._goals.listen("command", f"{controller}/command", "trajectory_msgs/msg/JointTrajectory")

    def step(self, measured: JointInput, now: float, stopped: str = "") -> Float[np.ndarray, " n"] | None:
        """Take what came in, and return the arm's velocities (n,) [rad/s] at `now` [s]; None: nothing is followed.

        now is on the robot's clock, by which it moves, whatever ROS' clock does meanwhile. stopped: why the safety
        gate stops the robot until it is reset; goals are refused then.
        """
        while self._goals.inbox:
            what, message = self._goals.inbox.popleft()
            if what == "cancel":
                if self._goals.is_cancelled(message):
                    self._end(PREEMPTED, 0, "It was cancelled.", now)
                    self._follower = None
            elif what == "goal":
                self._take(message, measured, now, stopped)
            else:
                self._command(message, measured, now)
        if stopped and self._follower is not None:
            self._end(ABORTED, _CODES["path tolerance violated"], stopped, now)
            self._follower = None
        output = self._follow(measured, now)
        self._goals.tell_if_due(now)
        return None if output is None else output.arm

    def drop(self, now: float) -> None:
        """Follow nothing any more, for the arm is told something else."""
        self._end(PREEMPTED, 0, "The arm was commanded otherwise.", now)
        self._follower = None

    def _follow(self, measured: JointInput, now: float) -> JointOutput | None:
        if self._follower is None:
            return None
        before = self._follower.status
        self._follower, output = joint_trajectory.step(self._follower, measured, now)
        status = self._follower.status
        if status != before and status in _CODES:
            ended = SUCCEEDED if status == "reached" else ABORTED
            self._end(ended, _CODES[status], self._follower.reason, now)
        if self._goals.feeds(now):
            self._feed(output, measured)
        return output

    def _take(self, message: Any, measured: JointInput, now: float, stopped: str) -> None:
        goal = self._goals.new(message)
        try:
            if stopped:
                raise GoalError(-1, stopped)
            here = self._desired(measured, now)
            trajectory, late = trajectory_of(message.goal.trajectory, self._names, self._limits, here, wire.now())
            follower = joint_trajectory.init(self._tolerances(message.goal), now)
            self._end(PREEMPTED, 0, "A newer goal took its place.", now)
            self._follower = joint_trajectory.follow(follower, trajectory, now - late)
        except GoalError as error:
            self._goals.conclude(goal, REJECTED, str(error), now, error.code, str(error))
            return
        self._goals.begin(goal, now)

    def _command(self, message: Any, measured: JointInput, now: float) -> None:
        if not message.points:  # ros_control stops then
            return self.drop(now)
        try:
            here = self._desired(measured, now)
            trajectory, late = trajectory_of(message, self._names, self._limits, here, wire.now())
        except GoalError as error:
            return wire.complain(str(error))
        self._end(PREEMPTED, 0, "A trajectory on the command topic took its place.", now)
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
        for key, tolerances, what in (
            ("path_tolerance", goal.path_tolerance, "position"),
            ("path_velocity_tolerance", goal.path_tolerance, "velocity"),
            ("goal_tolerance", goal.goal_tolerance, "position"),
            ("stopped_velocity", goal.goal_tolerance, "velocity"),
        ):
            given = {one.name: getattr(one, what) for one in tolerances if getattr(one, what)}
            usual = np.broadcast_to(getattr(self._config, key), len(self._names)).tolist()
            values = (given.get(name, value) for name, value in zip(self._names, usual, strict=True))
            changes[key] = tuple(math.inf if value < 0 else value for value in values)
        if late := seconds(goal.goal_time_tolerance):
            changes["goal_time"] = late if late > 0 else math.inf
        try:
            return JointTrajectoryConfig(**{**self._config.model_dump(), **changes})
        except ValidationError as error:
            raise GoalError(-1, "A tolerance of the goal is not a number; leave it at 0 for the usual one.") from error

    def _end(self, status: int, code: int, text: str, now: float) -> None:
        self._goals.end(status, text, now, code, text)

    def _feed(self, output: JointOutput, measured: JointInput) -> None:
        types, none = wire.message_types(), np.zeros(0)
        Point, Duration = types["trajectory_msgs/msg/JointTrajectoryPoint"], types["builtin_interfaces/msg/Duration"]
        points = [
            Point(q, v, none, none, Duration(0, 0))
            for q, v in ((output.reference, none), (measured.q, measured.velocity), (output.error, none))
        ]
        self._goals.feed(messages.header(types, wire.now(), ""), list(self._names), *points)
