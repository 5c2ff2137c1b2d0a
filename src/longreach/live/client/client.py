"""The client side: watch a robot that `longreach serve` serves, plan for it, and command it.

`Client` has the face of `longreach.Hardware`, so that whatever drives a robot drives one at the other end of a network.
"""

import getpass
import logging
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import Capabilities, Command, GripperCommand, Readings, capabilities_of
from longreach.control.safety_checks import NOT_HEARD
from longreach.errors import LiveError, PlanningError
from longreach.geometry import se3
from longreach.io import messages
from longreach.io.bag_recorder import Recorder
from longreach.live.client import motions
from longreach.live.client.connection import Connection, explained, read_description
from longreach.live.client.state import LiveState
from longreach.live.client.subscriber import Subscriber
from longreach.live.protocol import commands, topics
from longreach.live.protocol.frames import connected
from longreach.live.protocol.topics import TYPES
from longreach.measurement import LaserScan
from longreach.reference import Reference
from longreach.robot.mobile_manipulator import MobileManipulator

Method = Literal["task-priority", "sqp"]
_LOG = logging.getLogger("longreach.live")
_PATIENCE = 5.0  # with a plan that does not get on [s]
_CONFIRMED = 1.0  # for how long we wait until the robot says that it has done what it was asked for [s]
_CUT = 60.0  # for how long a network may be cut until execute gives up to resume [s]
_SETTLING = 1.0  # for how long it may take, after the end of a plan, until the robot is there [s]
_SILENT = 1.0  # who was not heard for so long is to be named [s]
_GONE = 5.0  # who was not heard for so long has gone, as for `connect` [s]
# So near is there, by the robot's own estimate: what its side calls arrived (5 mm, 5 mrad), the base's estimate being
# noisy by as much; and what the tool, at the end of all that, is to be off at most [rad], [m].
_JOINT, _BASE, _TURN = 0.005, 0.01, np.radians(0.5)
_TOOL = 0.005


def connect(
    address: str = "127.0.0.1:7447",
    token: str | None = None,
    *,
    name: str = "",
    certificates: Path | str | None = None,
    timeout: float = 5.0,
) -> "Client":
    """Connect to a robot and wait until it says where it is [at most `timeout` s].

    Arguments: address: host:port; token: the server's secret, where it has one; name: what others see of whoever holds
    the robot (else user@host); certificates: a folder with ca.pem, and client.pem with client.key where the server asks
    for a certificate: given, the connection is TLS.

    Raises:
        LiveError: nobody answers there, or the server refuses us.
    """
    if not commands.numbers(timeout, "The timeout", ()) > 0.0:
        raise LiveError(f"The timeout is {timeout:g} s; give it more than 0 s.")
    connection = Connection(address, token, None if certificates is None else Path(certificates), timeout)
    try:
        with explained():
            client = Client(connection, name or _own_name())
        connection.start()
        heard = client._subscriber
        if heard.wait(lambda: heard.tick_status and heard.state, timeout) is None:
            raise LiveError(f"The robot at {address} has not said within {timeout:g} s where it is.")
    except BaseException:
        connection.close()
        raise
    connected.append(client._subscriber.frames)
    return client


def _own_name() -> str:
    with suppress(OSError, KeyError, ImportError):  # a user without a name
        return f"{getpass.getuser()}@{socket.gethostname()}"
    return "somebody"


class Client:
    """A robot at the other end of a network; made by `connect`. All of it may be called from any thread.

    What it raises is a LongreachError. All that moves the robot raises a LiveError while it is stopped until `reset`,
    while another client holds it, and where a number cannot be meant: see `longreach.live.protocol.commands`.
    """

    def __init__(self, connection: Connection, name: str) -> None:
        self._connection, self.name = connection, name
        self._recorders: list[Recorder] = []
        self._robot = read_description(connection)
        self._subscriber = subscriber = Subscriber(connection.session, self._robot)
        connection.confirmed = lambda: subscriber.status.get("holder_id") == connection.sender.hex()
        plan = connection.lasting(topics.PLAN)
        if plan is not None:
            self._subscriber.plan = commands.trajectory(plan, self._robot)

    @property
    def capabilities(self) -> Capabilities:
        """What the robot can do."""
        return capabilities_of(self._robot, gripper=len(self.state.joints) > self._robot.dof - self._robot.base.stop)

    @property
    def robot(self) -> MobileManipulator:
        """The robot, from the description that it publishes."""
        return self._robot

    @property
    def state(self) -> LiveState:
        """The newest state."""
        state = self._subscriber.state
        assert state is not None  # `connect` has waited for it
        return state

    @property
    def scan(self) -> LaserScan | None:
        """The newest scan, or None before the first."""
        return self._subscriber.scan

    @property
    def plan_running(self) -> ConfigurationTrajectory | None:
        """The plan that the robot follows or has followed last, whoever sent it."""
        return self._subscriber.plan

    @property
    def age(self) -> float:
        """How long ago the newest state came [s]; the robot is to be taken for silent beyond 0.25 s."""
        return time.monotonic() - self._subscriber.heard

    @property
    def role(self) -> str:
        """What the robot takes us for: an operator, or a watcher, who may look and stop only."""
        return self._connection.role

    @property
    def offset(self) -> float:
        """The robot's clock less this machine's `time.time()` [s], by the fastest of the last pings."""
        return self._connection.offset

    @property
    def lost(self) -> int:
        """How many messages the robot has sent and we have not received."""
        return self._subscriber.lost

    @property
    def delays(self) -> Float[np.ndarray, " n"]:
        """How long the last messages were under way (n,) [s], true where both sides share a machine's clock."""
        return np.array(self._subscriber.delays)

    @property
    def holds(self) -> bool:
        """Whether this client holds the robot, so that its commands count."""
        return self._connection.holds and self._connection.confirmed()

    def on_state(self, callback: Callable[[LiveState], None]) -> Callable[[], None]:
        """Call back with each new state, from the network's thread: be quick there. Returns what ends it."""
        self._subscriber.on_state.append(callback)
        return _ending(self._subscriber.on_state, callback)

    def on_scan(self, callback: Callable[[LaserScan], None]) -> Callable[[], None]:
        """Call back with each new scan, from the network's thread. Returns what ends it."""
        self._subscriber.on_scan.append(callback)
        return _ending(self._subscriber.on_scan, callback)

    def record(self, path: Path | str) -> Recorder:
        """Record all that the robot says into an MCAP, until what this returns is closed: use it with `with`.

        Raises:
            RecordingError: nothing can be written there.
        """
        recorder, start = Recorder(Path(path)), self.state.stamp
        self._recorders.append(recorder)
        recorder.ended = self._subscriber.tap(recorder.write)
        for topic in (topics.TF_STATIC, topics.PLAN):  # said once, perhaps long ago
            message = self._connection.lasting(topic)
            if message is not None:
                recorder.write(topic.name, topic.type, topic.pack(message), start)
        return recorder

    def __iter__(self) -> Iterator[LiveState]:
        """Yield each new state; one that comes while the last is still looked at is passed over for a newer one.

        It ends where this client is closed, or no state has come for 5 s: then the robot has gone.
        """
        subscriber, seen = self._subscriber, None
        while subscriber.wait(lambda seen=seen: subscriber.closed or subscriber.state is not seen, _GONE):
            if subscriber.closed:
                return
            seen = self.state
            yield seen

    def lookup(self, target: str, source: str, stamp: float | None = None) -> Float[np.ndarray, "4 4"]:
        """Return T_target_source at a time of the robot's clock [s] in the last 10 s, else (None) the newest.

        Raises:
            LiveError: there is no such frame, or none at that time.
        """
        when = None if stamp is None else float(commands.numbers(stamp, "The stamp", ()))
        return self._subscriber.frames.lookup(str(target), str(source), when)

    def read(self) -> Readings:
        """Return what was said since the last call, without waiting; wheels, IMU and wrench from the first call on."""
        with explained():
            self._subscriber.sense()
        return self._subscriber.readings(self._connection.now)

    def write(self, command: Command) -> None:
        """Send velocities or positions, from now on for 0.25 s; takes the robot where nobody holds it.

        Raises:
            LiveError: another client holds the robot, it is stopped, or a number cannot be meant.
        """
        if not isinstance(command, Command):
            raise LiveError("Give write a longreach.Command.")
        commands.check_command(command, self._robot)
        self._begin()
        stamp = self._connection.now
        if command.base is not None:
            self._connection.send(topics.TWIST, commands.twist_message(stamp, command.base))
        if command.arm is not None:
            names = self._robot.joint_names[self._robot.arm]
            self._connection.send(
                topics.JOINTS, messages.joint_state(TYPES, stamp, names, **{command.arm_mode: command.arm})
            )
        if command.gripper is not None:
            self._connection.send(topics.GRIPPER, commands.gripper_message(stamp, command.gripper))

    def velocity(self, arm: Float[np.ndarray, " m"] | None = None, base: Float[np.ndarray, "3"] | None = None) -> None:
        """Send velocities of the arm's joints (m,) [rad/s] and a body twist of the base (3,); None: zero."""
        robot = self._robot
        joints, still = robot.dof - robot.base.stop, np.zeros(3) if robot.base.stop else None
        speeds = np.zeros(joints) if arm is None else commands.numbers(arm, "Velocities of the arm", (joints,))
        twist = still if base is None else commands.numbers(base, "A velocity of the base", (3,))
        self.write(Command(self._connection.now, speeds, "velocity", twist))

    def gripper(self, value: float, mode: Literal["position", "velocity", "force"] = "position") -> None:
        """Close the fingers: position 0 open to 1 closed, velocity [1/s], or force [N]."""
        closed = float(commands.numbers(value, "What the gripper is to do", ()))
        self.write(Command(self._connection.now, gripper=GripperCommand(mode, closed)))

    def plan(
        self, goal: Reference | Float[np.ndarray, "4 4"], method: Method = "task-priority"
    ) -> ConfigurationTrajectory:
        """Plan from where the robot is along a reference, or to a tool pose T_map_tool (4, 4); nothing moves yet.

        The answer begins and ends at rest, within the robot's limits of speed and acceleration.

        Raises:
            PlanningError: there is no way there. LiveError: the pose is not of finite numbers.
        """
        if isinstance(goal, Reference):
            return motions.along(self._robot, self.state.q, goal, method)
        T = commands.rigid(goal, "A pose of the tool")
        plan = motions.to_pose(self._robot, self.state.q, T, method)
        if away := _tool_away(self._robot, plan.q[-1], T, 0.5):
            raise PlanningError(f"The plan would end where {away}; choose a pose that the robot can reach.")
        return plan

    def execute(
        self, trajectory: ConfigurationTrajectory, wait: bool = True, timeout: float | None = None, resume: bool = False
    ) -> LiveState:
        """Let the robot follow a trajectory of all its joints; with `wait` return when it is where that ends.

        There is within 5 mrad of each joint of the arm, and 1 cm and 0.5° of the base, by the robot's own estimate.
        resume: where the network was cut on the way, and is back within a minute, command what is left of it, from
        where the robot stands; the log says so. The robot itself never goes on.

        Raises:
            LiveError: the robot refuses it, was stopped on the way, or does not arrive; the sentence says why, and how
                far off it is.
        """
        if not isinstance(trajectory, ConfigurationTrajectory):
            raise LiveError("Give execute a trajectory, as plan returns it.")
        end, since = trajectory.q[-1], self.state.stamp
        while True:
            try:
                return self._execute(trajectory, wait, timeout, lambda state: _joints_away(self._robot, state.q, end))
            except LiveError:
                if not (wait and resume and self._is_back(since)):
                    raise
                state = self.state
                done, since = state.progress, state.stamp
                trajectory = motions.what_is_left(self._robot, trajectory, state.q, done)
                _LOG.warning("The network was cut when %.0f %% was done; what is left is commanded now.", 100 * done)

    def _is_back(self, since: float) -> bool:
        """Whether a cut has ended a goal after a stamp [s], and the robot is heard again and may be commanded."""
        heard = self._subscriber.wait(lambda: self.age < _SILENT and self.state.stamp > since, _CUT)
        self._subscriber.wait(lambda: not self.state.stop, _PATIENCE)
        return bool(heard and self.state.why.startswith(NOT_HEARD) and not self.state.stop)

    def _execute(
        self,
        trajectory: ConfigurationTrajectory,
        wait: bool,
        timeout: float | None,
        away: Callable[[LiveState], str],
    ) -> LiveState:
        """Follow a trajectory; away: says how far from its end a state is, and nothing where that is near enough."""
        patience = None if timeout is None else float(commands.numbers(timeout, "The timeout", ()))
        commands.check_trajectory(trajectory, self._robot)
        self._begin()
        answer = self._connection.ask(
            topics.EXECUTE, messages.joint_trajectory(TYPES, self._connection.now, trajectory)
        )
        if not wait:
            return self.state
        word, _, number = answer.partition(" ")
        if word != "plan" or not number.isdecimal():
            raise LiveError("The robot's answer cannot be read; is this a longreach server?")
        self._ended(int(number), patience, away)
        self._subscriber.wait(lambda: not away(self.state), _SETTLING)
        if off := away(self.state):
            raise LiveError(f"The plan has ended, but {off}: {self._why('it stands still there')}")
        return self.state

    def _why(self, otherwise: str) -> str:
        """Return why the robot does not do what it should, as far as it is known, as the end of a sentence."""
        silent = f"the robot was not heard for {self.age:.1f} s" if self.age > _SILENT else ""
        return _ended_sentence(silent or self.state.stop or otherwise)

    def _ended(self, plan: int, timeout: float | None, away: Callable[[LiveState], str]) -> None:
        """Return when a plan, given by its number, has ended."""
        subscriber = self._subscriber

        def over() -> bool:
            number = int(subscriber.tick_status.get("plan") or 0)
            done = subscriber.tick_status.get("goal") != "follow" or subscriber.tick_status.get("latched") == "1"
            return number > plan or (number == plan and done)

        before = None
        while not subscriber.wait(over, _PATIENCE if timeout is None else timeout):
            if timeout is not None or subscriber.tick_status.get("progress") == before:
                off = away(self.state) or "the robot is where it ends"
                raise LiveError(f"The plan has not ended in time, {off}: {self._why('it still goes on')}")
            before = subscriber.tick_status.get("progress")  # a simulation may be slow, a robot wait for its client
        state = self.state
        if state.plan > plan or state.progress < 1.0:
            off = away(state) or "the robot is where it ends"
            raise LiveError(f"The plan ended early, {off}: {self._why('the robot was asked for something else')}")

    def move_to(
        self,
        goal: Float[np.ndarray, " n"] | Float[np.ndarray, "4 4"],
        wait: bool = True,
        method: Method = "task-priority",
    ) -> LiveState:
        """Move straight to a configuration q (n,), base first, or (m,) of the arm, or plan to a tool pose (4, 4).

        With `wait` it returns when the robot is there by its own estimate: the tool within 5 mm and 0.5° of a pose; for
        a configuration see `execute`.

        Raises:
            PlanningError: the goal is outside the joints' limits, or there is no way to it.
            LiveError: the robot refuses it, was stopped on the way, or does not arrive; the sentence says why, and how
                far off it is.
        """
        robot, q = self._robot, self.state.q
        target = commands.numbers(goal, "A goal", (4, 4), (robot.dof,), (robot.dof - robot.base.stop,))
        if target.ndim == 2:
            plan = self.plan(target, method)
            return self._execute(plan, wait, None, lambda state: _tool_away(robot, state.q, target))
        target = np.concatenate([q[: robot.dof - len(target)], target])
        return self.execute(motions.straight(robot, q, target), wait)

    def reach(self, T_map_tool: Float[np.ndarray, "4 4"]) -> None:
        """Let the arm pull the tool to a pose at once, the base standing; send it anew as a dragged gizmo moves."""
        T = commands.rigid(T_map_tool, "A pose of the tool")
        self._begin()
        self._connection.send(topics.TOOL, messages.tool_pose(TYPES, self._connection.now, T))

    def hold(self) -> None:
        """Let the robot stand where it is; ends a plan."""
        self._take_if_free()
        self._connection.order("hold")

    def stop(self, reason: str = "The client says stop.") -> None:
        """Brake at once, whoever holds the robot; it stays so until `reset`.

        Raises:
            LiveError: the robot does not answer, or does not say within 1 s that it is stopped.
        """
        before, subscriber = self._since, self._subscriber
        self._connection.order(f"stop {reason}")
        stopped = subscriber.wait(lambda: self._latched and self._since != before, _CONFIRMED)
        if not stopped and not subscriber.is_this_thread():  # a callback's thread cannot wait
            raise LiveError(
                f"The robot has not said within {_CONFIRMED:g} s that it is stopped; use its own red button."
            )

    def reset(self) -> None:
        """Let the robot move again after a stop that holds.

        Raises:
            LiveError: another client holds the robot, or it was stopped anew, which this client has not heard of yet.
        """
        self._take_if_free()
        self._connection.order(f"reset {self._since}")
        self._subscriber.wait(lambda: not self._latched, _CONFIRMED)

    def take(self) -> None:
        """Take the robot, so that this client's commands count and others' do not.

        Raises:
            LiveError: another client holds it; the sentence names it.
        """
        self._connection.take(self.name)
        self._subscriber.wait(lambda: self.holds, _CONFIRMED)

    @property
    def _latched(self) -> bool:
        return self._subscriber.tick_status.get("latched") == "1"

    @property
    def _since(self) -> str:
        """Since when the robot is stopped, as its status has it: which stop that is."""
        return self._subscriber.tick_status.get("since", "")

    def _begin(self) -> None:
        """Take the robot where nobody holds it, unless it is stopped: then nothing moves it."""
        if self._latched:
            raise LiveError(f"The robot is stopped: {_ended_sentence(self.state.stop)} Clear it with reset() first.")
        self._take_if_free()

    def _take_if_free(self) -> None:
        if not self.holds:
            self.take()

    def release(self) -> None:
        """Let go of the robot; it stands until somebody takes it."""
        if self._connection.holds:
            self._connection.release()

    def close(self) -> None:
        """End recordings, release the robot and hang up."""
        for recorder in self._recorders:
            recorder.close()
        if self._subscriber.frames in connected:
            connected.remove(self._subscriber.frames)
        self._subscriber.close()
        with suppress(LiveError):
            self.release()
        self._connection.close()

    def __enter__(self) -> "Client":
        """Return the client."""
        return self

    def __exit__(self, *_: object) -> None:
        """Hang up."""
        self.close()


def _ending(callbacks: list[Callable[..., None]], callback: Callable[..., None]) -> Callable[[], None]:
    """Return what takes a callback away; called again, it does nothing."""

    def end() -> None:
        with suppress(ValueError):
            callbacks.remove(callback)

    return end


def _ended_sentence(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else f"{text}."


def _tool_away(
    robot: MobileManipulator, q: Float[np.ndarray, " n"], T: Float[np.ndarray, "4 4"], part: float = 1.0
) -> str:
    """Return how far the tool at q (n,) is from a pose, or nothing where that is within `part` of what is allowed."""
    now = robot.forward(q)
    way = float(np.linalg.norm(now[:3, 3] - T[:3, 3]))
    turn = float(np.linalg.norm(se3.difference(now, T)[3:]))
    if way <= part * _TOOL and turn <= part * _TURN:
        return ""
    return f"the tool is {1e3 * way:.1f} mm and {np.degrees(turn):.2f}° off"


def _joints_away(robot: MobileManipulator, q: Float[np.ndarray, " n"], goal: Float[np.ndarray, " n"]) -> str:
    """Return how far q (n,) is from a configuration, or nothing where that is near enough."""
    off = q - goal
    base, arm = off[robot.base], np.abs(off[robot.arm])
    if robot.base.stop:
        way, turn = float(np.hypot(base[0], base[1])), abs((base[2] + np.pi) % (2.0 * np.pi) - np.pi)
        if way > _BASE or turn > _TURN:
            return f"the base is {1e3 * way:.0f} mm and {np.degrees(turn):.2f}° off"
    if arm.max(initial=0.0) > _JOINT:
        i = int(arm.argmax())
        return f"{robot.joint_names[robot.arm][i]} is {1e3 * arm[i]:.0f} mrad off"
    return ""
