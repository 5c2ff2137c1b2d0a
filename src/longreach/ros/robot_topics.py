"""The topics on which a robot says what it senses, named as in its description."""

from collections.abc import Callable
from typing import Any

import numpy as np

from longreach.control.hardware import Readings
from longreach.geometry import se2
from longreach.io import messages
from longreach.io.bag_topics import JOINT_STATE, ODOMETRY
from longreach.measurement import Odometry, Wheels, WheelSpeeds, WheelTicks
from longreach.odometry import wheel
from longreach.robot.description import RobotDescription
from longreach.ros import wire
from longreach.ros.sensors import topic_of
from longreach.sim.simulated import Simulated

_POSE = "geometry_msgs/msg/PoseStamped"
_TRUTH_PERIOD = 0.02  # [s]


class Topics:
    """What a robot sends: joints, wheels, what those make of the way, scans, IMU, wrench, and the truth."""

    def __init__(self, robot: RobotDescription, odometry: str) -> None:
        self._robot = robot
        joints = wire.Publisher(topic_of(robot, "joints"), JOINT_STATE)
        same = topic_of(robot, "wheels") == topic_of(robot, "joints")
        self._wheels = joints if same else wire.Publisher(topic_of(robot, "wheels"), JOINT_STATE)
        self._odometry = wire.Publisher(odometry, ODOMETRY)
        self._truth, self._due = wire.Publisher(robot.topics.truth or "/truth", _POSE), 0.0
        scans = wire.Publisher(topic_of(robot, "lidar"), "sensor_msgs/msg/LaserScan")
        imu = wire.Publisher(topic_of(robot, "imu"), "sensor_msgs/msg/Imu")
        wrench = wire.Publisher(topic_of(robot, "wrench"), "geometry_msgs/msg/WrenchStamped")
        self._records: dict[str, tuple[wire.Publisher, Callable[[messages.Types, float, Any], Any]]] = {
            "joints": (joints, messages.joint_state_of),
            "scans": (scans, messages.laser_scan),
            "imu": (imu, messages.imu),
            "wrenches": (wrench, messages.wrench),
        }
        self._odometry_state = wheel.init(robot)
        self._pose, self._twist = np.zeros(3), np.zeros(3)

    def send(self, readings: Readings, offset: float) -> None:
        """Send all that was read, `offset` [s] later than the robot's own clock says."""
        types = wire.message_types()
        for record in readings.wheels:
            self._wheels.send(self._wheel_state(record, record.stamp + offset))
        if readings.wheels:
            self._go_on(readings.wheels)
            stamp = readings.wheels[-1].stamp + offset
            self._odometry.send(messages.odometry(types, stamp, Odometry(stamp, self._pose, self._twist)))
        for kind, (publisher, make) in self._records.items():
            for record in getattr(readings, kind):
                publisher.send(make(types, record.stamp + offset, record))

    def send_truth(self, simulation: Simulated, offset: float) -> None:
        """Send where the robot really is, where that is due."""
        if simulation.stamp >= self._due:
            self._due = simulation.stamp + _TRUTH_PERIOD - 1e-6
            types, truth = wire.message_types(), simulation.truth()
            self._truth.send(messages.pose_stamped(types, truth.stamp + offset, truth.base))

    def _wheel_state(self, record: Wheels, stamp: float) -> Any:
        types, base = wire.message_types(), self._robot.base
        assert base is not None
        if isinstance(record, WheelTicks):
            return messages.joint_state(types, stamp, base.wheel_names, position=record.ticks)
        assert isinstance(record, WheelSpeeds)
        return messages.joint_state(types, stamp, base.wheel_names, velocity=record.speeds)

    def _go_on(self, records: tuple[Wheels, ...]) -> None:
        """Add the wheels' steps to where they alone say that the base is."""
        self._odometry_state, steps = wheel.step(self._odometry_state, records)
        for step in steps:
            self._pose = se2.compose(self._pose, step.pose)
            self._twist = se2.log(step.pose) / (step.stamp - step.stamp_reference)
