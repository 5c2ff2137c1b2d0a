"""What clients ask of a robot, and who of them holds it: from the network's threads to the loop's."""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from threading import Lock
from typing import Any

from longreach.app.goals import Follow, Goal, Hold, ServoGoal, VelocityGoal
from longreach.app.robot_side import Orders, TickRecord
from longreach.app.tracker import TrackerConfig, check_plan
from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import Command, GripperCommand
from longreach.control.obstacles import met_by
from longreach.errors import LiveError, LongreachError
from longreach.live.protocol import commands, topics
from longreach.live.protocol.message_header import MessageHeader
from longreach.live.protocol.topics import TYPES, Topic
from longreach.live.protocol.transport import OPERATOR, WATCHER
from longreach.live.server.authentication import Authentication, Rejected, is_watcher
from longreach.robot.mobile_manipulator import MobileManipulator

_LOG = logging.getLogger("longreach.live")
_FORGOTTEN = 2.0  # a client that is gone for so long holds the robot no more [s]; ours
_STREAM_AGE, _ANSWER_AGE = 0.25, 2.0  # beyond which a command, or a question, does nothing [s]; the driver's, ours
_NAME, _REASON = 60, 200  # characters of a client's name, and of its reason for a stop; ours
_OURS = 0.05  # of the time between two ticks that counts as silence [s]: beyond it the loop itself was late; ours


@dataclass
class _Asked:
    """What has come since the loop looked last."""

    goal: Goal | None = None
    direct: Command | None = None
    gripper: GripperCommand | None = None
    stop: str = ""
    reset: bool = False


@dataclass
class Holder:
    """Who holds the robot: nobody where `sender` is empty.

    heard: whether there was a sign of life since the last tick; silent: for how long there was none before that [s].
    """

    sender: bytes = b""
    name: str = ""
    heard: bool = True
    silent: float = 0.0


class Listener:
    """Receives what clients send on a session.

    record: returns what the loop did last, None before its first tick; clock: the time on the robot's clock [s].
    """

    def __init__(
        self,
        session: Any,
        robot: MobileManipulator,
        authentication: Authentication,
        record: Callable[[], TickRecord | None],
        clock: Callable[[], float],
        config: TrackerConfig,
    ) -> None:
        self._robot, self._authentication, self._record, self._config = robot, authentication, record, config
        self._clock, self._lock, self._asked = clock, Lock(), _Asked()
        self.holder, self._taken, self._missed = Holder(), math.inf, -math.inf
        self.plan: ConfigurationTrajectory | None = None
        self.stopped, self.stopped_by = "", ""  # why a client has stopped the robot last, and which
        self.plans, self._given = 0, 0  # how many the loop has begun with, and how many were given
        self._ordered = 0  # the number of the holder's newest order or plan
        streams = {
            topics.TWIST: lambda message: partial(self._direct, commands.twist(message, robot)),
            topics.JOINTS: lambda message: partial(self._direct, commands.arm(message, robot)),
            topics.TOOL: lambda message: partial(self._set, goal=ServoGoal(commands.tool(message))),
            topics.GRIPPER: lambda message: partial(self._set, gripper=commands.gripper(message, robot)),
            topics.HEARTBEAT: lambda message: lambda: None,
        }
        questions = {topics.ORDER: self._order, topics.EXECUTE: self._execute}
        self._declared = [
            *(session.declare_subscriber(t.key, partial(self._hear, t, read)) for t, read in streams.items()),
            *(session.declare_queryable(t.key, partial(self._answer, t, do)) for t, do in questions.items()),
        ]

    def take(self, now: float) -> Orders:
        """Return what was asked for since the last call, at a time of the robot's clock [s]."""
        with self._lock:
            asked, self._asked, self.plans = self._asked, _Asked(), self._given
            holder, since, self._taken = self.holder, max(now - self._taken, 0.0), now
            holder.silent = 0.0 if holder.heard else holder.silent + min(since, _OURS)
            holder.heard = False
            if holder.sender and holder.silent > (self._config.safety.heartbeat_timeout or math.inf):
                self._missed = now
            if holder.sender and holder.silent > _FORGOTTEN:
                _LOG.warning("%s was not heard for %.1f s and holds the robot no more.", holder.name, holder.silent)
                holder = self.holder = Holder()
                asked = _Asked(Hold(), stop=asked.stop)
        goal = asked.goal if asked.direct is None else VelocityGoal(asked.direct, min(asked.direct.stamp, now))
        heartbeat = now - holder.silent if holder.sender else None
        return Orders(goal, asked.gripper, asked.stop, asked.reset, heartbeat)

    def _hear(self, topic: Topic, read: Callable[[Any], Callable[[], None]], sample: Any) -> None:
        """Take a message of a stream, which nobody waits for an answer to; read: returns what does as it says."""
        try:
            about, message = self._authentication.admit(topic, sample)
            with self._lock:
                self._check_holder(about)
            if topic is not topics.HEARTBEAT:  # whose stamp is not filled in
                self._check_age(message, _STREAM_AGE)
            do = read(message)
            with self._lock:
                if topic is not topics.HEARTBEAT:
                    self._check_current(about, message)
                do()
        except Exception as rejection:
            self._reject(rejection, topic)

    def _reject(self, rejection: Exception, topic: Topic) -> str:
        """Count a rejection and return its reason; what nobody has thought of is one, too, for it came from outside."""
        expected = isinstance(rejection, Rejected | LongreachError)
        reason = str(rejection) if expected else "not usable"
        if not expected:
            _LOG.debug("A message on %s has raised %r.", topic.name, rejection)
        self._authentication.rejections.count(reason, topic.name)
        return reason

    def _answer(self, topic: Topic, do: Callable[[MessageHeader, Any], str], query: Any) -> None:
        """Do what a query asks for, and answer with a std_msgs/String: what was refused and why, or nothing."""
        with query:
            try:
                answer = do(*self._authentication.admit(topic, query))
            except Exception as rejection:
                answer = f"refused: {self._reject(rejection, topic)}"
            query.reply(topic.key, topics.ORDER.pack(TYPES["std_msgs/msg/String"](answer)))

    def _check_holder(self, about: MessageHeader) -> None:
        """Refuse what does not come from the holder, and note that it was heard; the lock is held."""
        if self.holder.sender != about.sender:
            raise Rejected("from a client that does not hold the robot")
        self.holder.heard = True

    def _check_age(self, message: Any, most: float) -> None:
        """Refuse what was on its way for too long."""
        if self._clock() - commands.stamp_of(message) > most:
            raise Rejected(f"older than {most:g} s")

    def _check_current(self, about: MessageHeader, message: Any) -> None:
        """Refuse what does not count any more: messages are read beside each other, and a later one may come first."""
        if self.holder.sender != about.sender:
            raise Rejected("from a client that does not hold the robot")
        if commands.stamp_of(message) < self._missed:
            raise Rejected("sent before the client was missed")
        if about.number < self._ordered:
            raise Rejected("sent before its client has asked for something else")

    def _set(self, **asked: Any) -> None:
        for name, value in asked.items():
            setattr(self._asked, name, value)
        if "goal" in asked:
            self._asked.direct = None

    def _direct(self, command: Command) -> None:
        """Put a command for base or arm beside what came for the other since the last tick."""
        before = self._asked.direct
        if before is not None:
            arm = (before.arm, before.arm_mode) if command.arm is None else (command.arm, command.arm_mode)
            base = before.base if command.base is None else command.base
            command = Command(max(before.stamp, command.stamp), *arm, base)
        self._asked.direct = command

    def _order(self, about: MessageHeader, message: Any) -> str:
        """Do what one word asks for; the rest of the line is a name or a reason."""
        word, _, rest = message.data.partition(" ")
        with self._lock:
            if word == "stop":
                self.stopped = commands.one_line(rest, _REASON) or "A client says stop."
                holds = about.sender == self.holder.sender
                self.stopped_by = self.holder.name if holds else "a client that does not hold the robot"
                self._set(goal=Hold(), gripper=None, stop=self.stopped)
                return ""
            if word == "role":
                return WATCHER if is_watcher(about) else OPERATOR
            if word == "take":
                self._give(about, commands.one_line(rest, _NAME) or "somebody")
                return ""
            self._check_holder(about)
            if word == "reset":
                self._check_stop(rest)
                self._set(goal=Hold(), gripper=None, reset=True)  # what came before it does not count after it
            elif word in ("hold", "release"):
                self._set(goal=Hold())
            else:
                raise Rejected("an unknown order")
            self._ordered = about.number
            if word == "release":
                self.holder = Holder()
        return ""

    def _check_stop(self, since: str) -> None:
        """Refuse a reset of another stop than the robot's: somebody has pressed stop while it was on its way.

        since: of the stop that its sender sees, as the status has it; empty: it is for any.
        """
        record = self._record()
        stop = None if record is None else record.tick.stop
        if since and stop is not None and stop.latched and since != f"{stop.since:.6f}":
            raise LiveError(f"The robot was stopped anew: {stop.reason} Look why, then reset it.")

    def _give(self, about: MessageHeader, name: str) -> None:
        if self.holder.sender not in (b"", about.sender):
            raise LiveError(f"{self.holder.name} holds the robot; wait until it is released.")
        if not self.holder.sender:
            self._ordered = about.number
        self.holder = Holder(about.sender, name)
        _LOG.info("%s holds the robot.", name)

    def _execute(self, about: MessageHeader, message: Any) -> str:
        """Let the robot follow a trajectory; the answer is the plan's number."""
        with self._lock:
            self._check_holder(about)
        self._check_age(message, _ANSWER_AGE)
        record = self._record()
        if record is None:
            raise LiveError("The robot is not ready yet.")
        if record.tick.stop is not None and record.tick.stop.latched:
            raise LiveError(f"The robot is stopped: {record.tick.stop.reason} Clear it with reset() first.")
        plan = commands.trajectory(message, self._robot)
        check_plan(self._robot, plan, record.tick.q, record.state.config)
        around = record.state.gate.obstacles
        if around is not None and (met := met_by(around, plan)):
            raise LiveError(f"{met} Plan another way, or let the laser look again.")
        with self._lock:  # a long plan takes a while to look at: much may have happened since
            self._check_current(about, message)
            self._ordered = about.number
            self.plan, self._given = plan, self._given + 1
            self._set(goal=Follow(plan, -self._config.before))
            return f"plan {self._given}"
