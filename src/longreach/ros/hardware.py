"""A robot that speaks ROS 1, behind the same `Hardware` as any other: sensors by topics, arm and base by commands."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from longreach.control.hardware import ArmMode, Capabilities, Command, Readings, capabilities_of
from longreach.control.safety_checks import places
from longreach.errors import ControlError, LiveError
from longreach.io import messages
from longreach.measurement import GripperState
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.ros import wire
from longreach.ros.commands import BOOL, EMERGENCY_STOP, NUMBERS, TWIST
from longreach.ros.gripper_action import closing_angle, goal_message, goal_of, publisher
from longreach.ros.sensors import Role, Sensors
from longreach.sim.places import Hand

_LOG = logging.getLogger("longreach.ros")
ArmInterface = Literal["velocity", "position", "trajectory"]
_ROLES: tuple[Role, ...] = ("wheels", "lidar", "imu", "joints", "wrench")
_CONTROLLERS: dict[ArmInterface, str] = {
    "velocity": "/arm_velocity_controller",
    "position": "/arm_position_controller",
    "trajectory": "/arm_controller",
}
_MODES: dict[ArmInterface, tuple[ArmMode, ...]] = {
    "velocity": ("velocity",),
    "position": ("position",),
    "trajectory": ("velocity", "position"),
}
_TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
_AHEAD, _BRAKING = 0.1, 0.25  # of a velocity sent as a trajectory: how long it lasts, and until it is at rest [s]; ours
_LAG = 0.2  # [rad] that an arm may lag behind what it was told; ours


def connect_ros(
    robot: MobileManipulator,
    *,
    arm: ArmInterface = "velocity",
    controller: str | None = None,
    base: str = "/cmd_vel",
    scans: bool = True,
    timeout: float = 10.0,
) -> "RosHardware":
    """Become a node and connect to a robot, whose sensors are on the topics that its description names.

    Arguments:
        arm: what the arm takes: velocity or position, an array of numbers on CONTROLLER/command as ros_control's group
            controllers take it; or trajectory, on CONTROLLER/command as its joint trajectory controller takes it, each
            ending at rest, so that the arm stops by itself where nothing follows.
        controller: None: /arm_velocity_controller, /arm_position_controller or /arm_controller.
        base: topic of the base's twists. scans: whether it has its laser, where its description has one.
        timeout: for how long a master, the sensors and whoever takes commands are waited for, each [s].

    Raises:
        LiveError: rospy is not there, no master answers, the robot does not say where its joints are or what it sees,
            or nobody takes commands.
    """
    wire.start_node("longreach_hardware", timeout)
    hardware = RosHardware(robot, arm, controller or _CONTROLLERS[arm], base)
    hardware.wait(timeout, scans and robot.description.lidar is not None)
    return hardware


class RosHardware:
    """A robot over ROS; made by `connect_ros`. See `longreach.control.hardware.Hardware`.

    Where no command was written for `capabilities.timeout` it lets the robot stand.
    """

    def __init__(self, robot: MobileManipulator, arm: ArmInterface, controller: str, base: str) -> None:
        self._hand, self._angle, self._gripped_to = Hand.of(robot), closing_angle(robot), 0.0
        self._capabilities = replace(capabilities_of(robot, gripper=self._angle > 0.0), arm_modes=_MODES[arm])
        self._interface: ArmInterface = arm
        self._sensors = Sensors(robot.description, _ROLES)
        self._q: np.ndarray | None = None
        self._aim: tuple[float, np.ndarray] | None = None  # where velocities sent as trajectories lead, and when [s]
        self._pressed, self._stopped, self._lock = False, "", threading.Lock()
        self._written: float | None = None  # on the monotonic clock [s]; None: the robot stands
        self._button = wire.listen(EMERGENCY_STOP, (BOOL,), self._press)
        kind = _TRAJECTORY if arm == "trajectory" else NUMBERS
        self._arm = wire.Publisher(f"{controller}/command", kind) if self._capabilities.arm_names else None
        self._base = None if self._capabilities.base_velocity is None else wire.Publisher(base, TWIST)
        self._fingers = publisher() if self._capabilities.gripper else None
        self._cancel = wire.Publisher(f"{controller}/follow_joint_trajectory/cancel", "actionlib_msgs/msg/GoalID")
        wire.before_the_end(lambda: self.stop("The process ends."))
        self._closed = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    @property
    def capabilities(self) -> Capabilities:
        """What the robot can do: as its description says."""
        return self._capabilities

    def wait(self, timeout: float, scans: bool) -> None:
        """Wait until the robot speaks and listens [at most `timeout` s].

        Raises:
            LiveError: it does not.
        """
        commanded = [publisher for publisher in (self._arm, self._base) if publisher is not None]
        role: Role = "joints" if self._arm is not None else "wheels"
        for ready, what in (
            (lambda: self._sensors.speaks(role), f"says where its {role} are on {self._sensors.topic(role)}"),
            (lambda: not scans or self._sensors.speaks("lidar"), f"sends scans on {self._sensors.topic('lidar')}"),
            (lambda: all(p.listeners for p in commanded), f"listens on {' and '.join(p.topic for p in commanded)}"),
        ):
            _LOG.info("Waiting for a robot that %s, for %g s at most.", what, timeout)
            if not _within(timeout, ready):
                self.close()
                raise LiveError(f"No robot {what}; start it, or name its topics.")
            _LOG.info("A robot %s.", what)

    def read(self) -> Readings:
        """Return everything that has arrived since the last call."""
        readings = replace(self._sensors.take().readings, emergency_stop=self._pressed)
        for record in reversed(readings.joints):
            where = places(record.names, self._capabilities.arm_names)
            if where is not None and np.isfinite(record.position[where]).all():
                self._q = record.position[where]
                break
        return replace(readings, gripper=self._gripped(readings))

    def _gripped(self, readings: Readings) -> GripperState | None:
        """Return how far the fingers are closed, where their joints were told."""
        for record in reversed(readings.joints):
            where = places(record.names, self._hand.names)
            if self._capabilities.gripper and where is not None and len(record.velocity) == len(record.names):
                closed, speed = (float(self._hand.share @ x[where]) for x in (record.position, record.velocity))
                self._gripped_to = closed
                return GripperState(record.stamp, closed, speed)
        return None

    def write(self, command: Command) -> None:
        """Send a command; after a stop none is sent.

        Raises:
            ControlError: numbers that are not finite, or not one for each joint, or a mode that the arm does not take.
        """
        for part, value, count in (("arm", command.arm, len(self._capabilities.arm_names)), ("base", command.base, 3)):
            if value is not None and not (len(value) == count and np.isfinite(value).all()):
                raise ControlError(f"The {part} takes {count} finite numbers, but the command has {value}.")
        if command.arm is not None and command.arm_mode not in self._capabilities.arm_modes:
            raise ControlError(
                f"The arm's {self._interface} controller takes no {command.arm_mode}; connect with another `arm`."
            )
        with self._lock:
            if self._stopped:
                return
            self._written = time.monotonic()
            self._send(command.base, command.arm, command.arm_mode)
            if command.gripper is not None and self._fingers is not None:
                self._fingers.send(goal_message(wire.now(), *goal_of(command.gripper, self._angle, self._gripped_to)))

    def stop(self, reason: str) -> None:
        """Cancel whatever moves the arm, and let base and arm stand."""
        with self._lock:
            self._stopped = self._stopped or reason or "It was stopped."
            self._stand()
            self._cancel.send(wire.message_types()["actionlib_msgs/msg/GoalID"](_no_time(), ""))

    def wait_until(self, stamp: float) -> None:
        """Return at a time of the robot's clock [s]."""
        while (left := stamp - wire.now()) > 0.0 and not wire.rospy().is_shutdown():
            time.sleep(min(left, 0.1))

    def close(self) -> None:
        """Stop, and listen no more."""
        self.stop("The connection is closed.")
        self._closed.set()
        self._sensors.close()
        self._button.unregister()

    def _watch(self) -> None:
        """Let the robot stand where nothing was written for too long."""
        timeout = self._capabilities.timeout
        while not self._closed.wait(timeout / 5.0):
            with self._lock:
                if self._written is not None and time.monotonic() - self._written > timeout:
                    self._stand()

    def _stand(self) -> None:
        """Let base and arm stand; positions hold by themselves, a trajectory without points is ros_control's stop."""
        numbers = np.zeros(len(self._capabilities.arm_names)) if self._interface == "velocity" else None
        self._send(np.zeros(3), numbers, "velocity")
        if self._interface == "trajectory" and self._arm is not None:
            types = wire.message_types()
            self._arm.send(types[_TRAJECTORY](messages.header(types, 0.0, ""), list(self._capabilities.arm_names), []))
        self._written = self._aim = None

    def _send(self, base: np.ndarray | None, arm: np.ndarray | None, mode: ArmMode) -> None:
        types = wire.message_types()
        if base is not None and self._base is not None:
            vector = types["geometry_msgs/msg/Vector3"]
            x, y, turn = base.tolist()
            self._base.send(types[TWIST](vector(x, y, 0.0), vector(0.0, 0.0, turn)))
        if arm is None or self._arm is None:
            return
        if self._interface != "trajectory":
            layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
            self._arm.send(types[NUMBERS](layout, np.array(arm)))
        elif self._q is not None:
            self._arm.send(self._trajectory(self._led(self._q, arm), arm, mode))

    def _led(self, q: Float[np.ndarray, " n"], velocity: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return where velocities have led the arm, which is at q (n,) and may lag behind a little."""
        now = time.monotonic()
        if self._aim is not None and now - self._aim[0] < _AHEAD:
            q = np.clip(self._aim[1] + (now - self._aim[0]) * velocity, q - _LAG, q + _LAG)
        self._aim = now, q
        return q

    def _trajectory(self, q: Float[np.ndarray, " n"], arm: Float[np.ndarray, " n"], mode: ArmMode) -> Any:
        """Return a trajectory from q: to a position within a tick, or on with a velocity and then to rest."""
        types, none, limits = wire.message_types(), np.zeros(0), self._capabilities.arm_limits
        Point, Duration = types["trajectory_msgs/msg/JointTrajectoryPoint"], types["builtin_interfaces/msg/Duration"]
        if mode == "position":
            rows = [(1.0 / self._capabilities.arm_rate, arm, np.zeros(len(arm)))]
        else:
            rows = [
                (_AHEAD, q + _AHEAD * arm, arm),
                (_AHEAD + _BRAKING, q + (_AHEAD + 0.5 * _BRAKING) * arm, np.zeros(len(arm))),
            ]
        points = [
            Point(np.clip(position, limits.lower, limits.upper), velocity, none, none, Duration(0, round(1e9 * after)))
            for after, position, velocity in rows
        ]
        header = messages.header(types, 0.0, "")  # without a stamp: from now on
        return types[_TRAJECTORY](header, list(self._capabilities.arm_names), points)

    def _press(self, message: Any) -> None:
        self._pressed = bool(message.data)


def _no_time() -> Any:
    return wire.message_types()["builtin_interfaces/msg/Time"](0, 0)


def _within(timeout: float, condition: Callable[[], bool]) -> bool:
    """Wait until a condition holds [at most `timeout` s], and return whether it does."""
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.02)
    return True
