"""actionlib's side of an action server: goals come in on topics, their status, feedback and results go out.

Goals come in on rospy's threads and wait in `inbox` for the next tick. A new goal takes the place of the one before.
Source: wiki.ros.org/actionlib/DetailedDescription.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

from longreach.io import messages
from longreach.ros import wire
from longreach.ros.trajectory_points import seconds

ACTIVE, PREEMPTED, SUCCEEDED, ABORTED, REJECTED = 1, 2, 3, 4, 5  # actionlib_msgs/GoalStatus
_KEPT = 5.0  # [s] that the status of a goal is told after its end; actionlib's
_STATUS_PERIOD, _FEEDBACK_PERIOD = 0.2, 0.05  # [s]; actionlib's, ros_control's


@dataclass
class Goal:
    """One goal that was heard of: its message's id, how it stands, and since when it is over [s]."""

    id: Any
    status: int = ACTIVE
    text: str = "On the way."
    ended: float = math.inf


class Goals:
    """The goals of an action NAME of a type, `current` the one that is followed; inbox: what came in, newest last."""

    def __init__(self, name: str, kind: str) -> None:
        self.current: Goal | None = None
        self.inbox: deque[tuple[str, Any]] = deque()
        self._kind, self._heard_of = kind, list[Goal]()
        self._told, self._fed = -math.inf, -math.inf
        self._status = wire.Publisher(f"{name}/status", "actionlib_msgs/msg/GoalStatusArray")
        self._feedback = wire.Publisher(f"{name}/feedback", f"{kind}ActionFeedback")
        self._result = wire.Publisher(f"{name}/result", f"{kind}ActionResult")
        self.listen("goal", f"{name}/goal", f"{kind}ActionGoal")
        self.listen("cancel", f"{name}/cancel", "actionlib_msgs/msg/GoalID")

    def listen(self, what: str, topic: str, kind: str) -> None:
        """Put what comes in on a topic into the inbox."""
        wire.listen(topic, (kind,), lambda message: self.inbox.append((what, message)))

    def new(self, message: Any) -> Goal:
        """Return the goal of a message."""
        goal = Goal(_identified(message.goal_id, wire.now()))
        self._heard_of.append(goal)
        return goal

    def begin(self, goal: Goal, now: float) -> None:
        """Take a goal for the current one."""
        self.current = goal
        self.tell(now)

    def end(self, status: int, text: str, now: float, *result: Any) -> None:
        """End the current goal, where there is one, with a result of its fields."""
        if self.current is not None:
            goal, self.current = self.current, None
            self.conclude(goal, status, text, now, *result)

    def conclude(self, goal: Goal, status: int, text: str, now: float, *result: Any) -> None:
        """Say how a goal has ended."""
        goal.status, goal.text, goal.ended = status, text, now
        types = wire.message_types()
        said = types[f"{self._kind}Result"](*result)
        self._result.send(types[f"{self._kind}ActionResult"](_header(), _status_of(goal), said))
        self.tell(now)

    def is_cancelled(self, message: Any) -> bool:
        """Whether a GoalID means the current goal: it has its id, or a later stamp, or is of all."""
        goal, time = self.current, seconds(message.stamp)
        if goal is None:
            return False
        everything = not message.id and time == 0.0
        return everything or message.id == goal.id.id or 0.0 < seconds(goal.id.stamp) <= time

    def feeds(self, now: float) -> bool:
        """Whether feedback is due, which is counted as given then."""
        due = self.current is not None and now - self._fed >= _FEEDBACK_PERIOD
        self._fed = now if due else self._fed
        return due

    def feed(self, *feedback: Any) -> None:
        """Say how the current goal goes, in the fields of the action's feedback."""
        if self.current is not None:
            types = wire.message_types()
            said = types[f"{self._kind}Feedback"](*feedback)
            self._feedback.send(types[f"{self._kind}ActionFeedback"](_header(), _status_of(self.current), said))

    def tell_if_due(self, now: float) -> None:
        """Tell how the goals stand, from time to time."""
        if now - self._told >= _STATUS_PERIOD:
            self.tell(now)

    def tell(self, now: float) -> None:
        """Tell how all goals stand that are not long over."""
        self._told = now
        self._heard_of = [goal for goal in self._heard_of if now - goal.ended < _KEPT or goal is self.current]
        told = [_status_of(goal) for goal in self._heard_of]
        self._status.send(wire.message_types()["actionlib_msgs/msg/GoalStatusArray"](_header(), told))


def _header() -> Any:
    return messages.header(wire.message_types(), wire.now(), "")


def _status_of(goal: Goal) -> Any:
    return wire.message_types()["actionlib_msgs/msg/GoalStatus"](goal.id, goal.status, goal.text)


def _identified(id: Any, now: float) -> Any:
    """Return a goal's id with a stamp, which whoever sent it may have left out."""
    if seconds(id.stamp) == 0.0:
        id.stamp = messages.header(wire.message_types(), now, "").stamp
    id.id = id.id or f"goal-{now:.9f}"
    return id
