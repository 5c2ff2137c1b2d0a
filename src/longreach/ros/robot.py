"""A simulated robot behind the topics that the thesis' robot has: what it senses goes out, commands come in.

Nothing reaches its motors but through the safety gate. Its time runs with ROS' own, or behind it where the machine is
too slow.
"""

import logging
import time
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from longreach.control import safety
from longreach.control.hardware import Command, Readings
from longreach.control.joint_trajectory import JointInput, JointTrajectoryConfig
from longreach.control.safety import SafetyState
from longreach.control.safety_checks import Health, places
from longreach.control.safety_config import SafetyConfig, limits_of
from longreach.io import messages
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.ros import wire
from longreach.ros.commands import Commands
from longreach.ros.diagnostics import status
from longreach.ros.gripper_action import GripperAction, closing_angle
from longreach.ros.robot_topics import Topics
from longreach.ros.trajectory_action import TrajectoryAction
from longreach.sim.simulated import Simulated

_LOG = logging.getLogger("longreach.ros")
_BEHIND = 0.03  # [s] that a slow machine makes good; beyond that the robot's clock is set anew
_EARLY = 0.002  # [s] that it may be ahead: less than any reading takes to arrive
_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"


class RobotConfig(BaseModel):
    """Settings of a simulated robot's node."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    base: str = Field(default="/cmd_vel", description="Topic of the base's twists; the Ridgeback's.")
    controller: str = Field(default="/arm_controller", description="Namespace of the arm's trajectory controller.")
    odometry: str = Field(
        default="/ridgeback_velocity_controller/odom",
        description="Topic of what the wheels alone make; the Ridgeback's.",
    )
    trajectory: JointTrajectoryConfig = JointTrajectoryConfig()
    safety: SafetyConfig = SafetyConfig()


class _Arm(NamedTuple):
    """Where the arm is (n,) each, and when that was measured [s]."""

    stamp: float
    q: np.ndarray
    velocity: np.ndarray


def run(robot: MobileManipulator, simulation: Simulated, config: RobotConfig | None = None) -> None:
    """Let a simulated robot live until the node is told to end.

    Raises:
        LiveError: rospy is not there, or no master answers.
    """
    config = config or RobotConfig()
    wire.start_node("longreach_robot")
    node = _Node(robot, simulation, config)
    _LOG.info("The simulated %s is ready.", robot.name)
    period, due = 1.0 / simulation.capabilities.arm_rate, time.monotonic()
    with wire.running() as goes_on:
        while goes_on():
            due += period
            wait = due - time.monotonic()
            if wait < -_BEHIND:
                due -= wait
            time.sleep(max(wait, 0.0))
            simulation.advance(period)
            node.tick()
    simulation.stop("The node has ended.")


class _Node:
    """What happens at each tick."""

    def __init__(self, robot: MobileManipulator, simulation: Simulated, config: RobotConfig) -> None:
        self._robot, self._simulation, self._config = robot, simulation, config
        self._offset = wire.now() - simulation.stamp  # from its clock to ROS' [s]
        capabilities = simulation.capabilities
        self._names = capabilities.arm_names
        self._gate: SafetyState = safety.init(limits_of(capabilities, config.safety), simulation.stamp, robot=robot)
        self._commands = Commands(config.base, len(self._names))
        self._action = TrajectoryAction(config.controller, capabilities, config.trajectory)
        angle = closing_angle(robot)
        self._gripper = GripperAction(angle, simulation.stamp) if angle else None
        self._topics = Topics(robot.description, config.odometry)
        self._diagnostics, self._told = wire.Publisher("/diagnostics", _ARRAY), 0.0
        self._arm: _Arm | None = None
        self._behind, self._pressed = 0.0, False

    def tick(self) -> None:
        """Read, tell, guard, write."""
        now = self._simulation.stamp
        lag = wire.now() - now - self._offset
        if not -_EARLY <= lag <= _BEHIND:
            self._offset += lag
            self._behind += max(lag, 0.0)
        pressed = self._commands.stop_pressed
        readings = replace(self._simulation.read(), emergency_stop=pressed)
        self._topics.send(readings, self._offset)
        self._topics.send_truth(self._simulation, self._offset)
        desired = self._desired(readings, now)
        if self._pressed and not pressed:
            self._gate = safety.reset(self._gate)  # the button was let go of
        self._pressed = pressed
        self._gate, command = safety.step(self._gate, desired, readings, Health(), now)
        self._simulation.write(command)
        if now - self._told >= 1.0:
            self._told = now
            self._tell(now)

    def _desired(self, readings: Readings, now: float) -> Command | None:
        """Return what base, arm and fingers are told, the arm by what came last: numbers or a trajectory."""
        self._arm = self._measured(readings) or self._arm
        base, arm = self._commands.take()
        if arm is not None:
            self._action.drop(now)
        velocities = None
        if self._arm is not None:
            ahead = now - self._arm.stamp
            measured = JointInput(self._arm.q + ahead * self._arm.velocity, self._arm.velocity)
            stop = self._gate.stop
            stopped = stop.reason if stop is not None and stop.latched else ""
            velocities = self._action.step(measured, now, stopped)
        if arm is None and velocities is not None:
            arm = "velocity", velocities
        fingers = None if self._gripper is None else self._gripper.step(readings.gripper, now)
        if base is None and arm is None and fingers is None:
            return None
        mode, numbers = arm or ("velocity", None)
        if fingers is not None and self._gate.stop is not None and self._gate.stop.cause == "silence":
            base = np.zeros(3) if base is None else base  # that the fingers are told something is no silence
            numbers = np.zeros(len(self._names)) if numbers is None else numbers
        return Command(now, numbers, mode, base, fingers)

    def _measured(self, readings: Readings) -> _Arm | None:
        for record in reversed(readings.joints):
            where = places(record.names, self._names)
            if where is not None:
                return _Arm(record.stamp, record.position[where], record.velocity[where])
        return None

    def _tell(self, now: float) -> None:
        types, stop = wire.message_types(), self._gate.stop
        # Standing without a command is what a robot does that nobody drives.
        quiet = stop is None or stop.cause == "silence"
        values = {"behind real time [s]": f"{self._behind:.3f}"}
        told = status(types, 0 if quiet else 2, "longreach: robot", "" if stop is None else stop.reason, values)
        self._diagnostics.send(types[_ARRAY](messages.header(types, now + self._offset, ""), [told]))
