"""The estimate as a ROS node: sensors in by topics, odometry with covariance, tf and diagnostics out.

`odometry/filtered` and tf are what is believed now, as robot_localization's are: of the newest measurement's stamp.
With absolute fixes `odometry/localized` says the same in the frame map, and tf has map → odom (REP-105).
`odometry/settled` are the rows of `longreach estimate`: each is sent once it is older than the filter's history, when
nothing that comes late can change it any more, so that a recording played in gives what it gives offline.
"""

import logging
import math
import time

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.app.configuration import EstimateConfig
from longreach.app.tracker import sensed
from longreach.estimation.planar.state import Belief
from longreach.geometry import se2
from longreach.io import messages
from longreach.io.bag_topics import ODOMETRY
from longreach.localization import localizer
from longreach.localization.config import LocalizerConfig
from longreach.localization.localizer import LocalizerState, Output, Row
from longreach.measurement import Odometry
from longreach.robot.description import RobotDescription
from longreach.ros import wire
from longreach.ros.diagnostics import Diagnostics
from longreach.ros.frames import Broadcaster, Mounts, planar
from longreach.ros.sensors import Heard, Role, Sensors

_LOG = logging.getLogger("longreach.ros")
_SOURCES: tuple[Role, ...] = ("wheels", "lidar", "imu", "fixes")
_BEFORE = 0.5  # [s] that tf is listened to before the estimate begins


class NodeConfig(BaseModel):
    """Settings of the node around an estimate."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    estimate: EstimateConfig = Field(default=EstimateConfig(), description="As `longreach estimate --config`.")
    rate: float = Field(default=50.0, gt=0, le=1000, description="How often odometry is sent at most [Hz]; ours.")
    frame: str = Field(default="odom", min_length=1, description="Frame of the smooth estimate, which no fix moves.")
    map: str = Field(default="map", min_length=1, description="Frame of the fixes; sent where there are any.")
    base: str = Field(default="base_link", min_length=1, description="Frame of the base.")
    tf: bool = Field(default=True, description="Whether tf is sent as well; one node alone may send it.")


def run(robot: RobotDescription, config: NodeConfig | None = None) -> None:
    """Estimate until the node is ended.

    Raises:
        LiveError: rospy is not there, or no master answers.
        EstimationError: the wheels' topic carries what this robot's wheels cannot be read from.
    """
    config = config or NodeConfig()
    wire.start_node("longreach_estimate")
    sensors = Sensors(robot, config.estimate.sources or _SOURCES)
    without_mount = any(sensor is None or sensor.mount is None for sensor in (robot.lidar, robot.imu))
    estimator = Estimator(robot, config.estimate, Mounts() if without_mount else None)
    out, health = _Outputs(config), Diagnostics(robot)
    _LOG.info("The estimate of %s is ready.", robot.name)
    with wire.running() as goes_on:
        while goes_on():
            time.sleep(1.0 / config.rate)
            before = estimator.where
            heard = sensors.take()
            output = estimator.take(heard, time.monotonic())
            out.settled(output.rows)
            if estimator.where is not None and (before is None or estimator.where.stamp > before.stamp):
                out.filtered(estimator.where)
            health.take(heard.readings, output)


class Estimator:
    """The estimate of what is heard, portion by portion; `where`: its state, None before it has begun.

    mounts: where sensors are that the description does not place. It begins when tf has had the time to say that.
    """

    def __init__(self, robot: RobotDescription, config: LocalizerConfig, mounts: Mounts | None = None) -> None:
        self.where: LocalizerState | None = None
        self._robot, self._config, self._mounts = robot, config, mounts
        self._kept: list[Heard] = []
        self._began = math.inf

    def take(self, heard: Heard, now: float) -> Output:
        """Return the rows that this has settled, and what became of the measurements; now [s] on any clock."""
        self._kept.append(heard)
        readings = [one for some in self._kept for one in (*sensed(some.readings, self._robot), *some.fixes)]
        readings.sort(key=lambda reading: reading.stamp)
        if not readings:
            self._kept.clear()
            return Output([], [], [], [], [])
        self._began = min(self._began, now)
        if self.where is None:
            if self._mounts is not None and now - self._began < _BEFORE:
                return Output([], [], [], [], [])
            robot = self._robot
            if self._mounts is not None:
                scans = tuple(scan for some in self._kept for scan in some.readings.scans)
                robot = self._mounts.described(robot, scans, tuple(i for some in self._kept for i in some.readings.imu))
            self.where = localizer.init(robot, self._config)
        self._kept.clear()
        self.where, output = localizer.step(self.where, readings)
        return output


class _Outputs:
    """The topics that the node sends."""

    def __init__(self, config: NodeConfig) -> None:
        self._config = config
        self._filtered = wire.Publisher("odometry/filtered", ODOMETRY)
        self._localized = wire.Publisher("odometry/localized", ODOMETRY)
        self._settled = wire.Publisher("odometry/settled", ODOMETRY)
        self._tf = Broadcaster() if config.tf else None

    def filtered(self, where: LocalizerState) -> None:
        """Send what is believed, on its topics and as tf: odom → base, and where there are fixes map → odom."""
        belief, config = where.belief(), self._config
        stamp = belief.stamp
        self._filtered.send(self._odometry(config.frame, belief))
        frames = {config.base: (config.frame, planar(belief.pose))}
        if where.now.global_ is not None:
            localized = where.belief_on_map(stamp)
            self._localized.send(self._odometry(config.map, localized))
            frames[config.frame] = config.map, planar(se2.compose(localized.pose, se2.inverse(belief.pose)))
        if self._tf is not None:
            self._tf.send(stamp, frames)

    def settled(self, rows: list[Row]) -> None:
        """Send rows that nothing changes any more."""
        for row in rows:
            self._settled.send(self._message(self._config.frame, row))

    def _odometry(self, frame: str, belief: Belief) -> object:
        P = belief.covariance
        row = Row(belief.stamp, belief.pose, P[:3, :3])
        return self._message(frame, row, twist=belief.twist, twist_covariance=P[3:6, 3:6])

    def _message(self, frame: str, row: Row, **twist: Float[np.ndarray, "..."]) -> object:
        record = Odometry(row.stamp, row.pose, pose_covariance=in_frame(row.pose, row.covariance), **twist)
        message = messages.odometry(wire.message_types(), row.stamp, record, frame)
        message.child_frame_id = self._config.base
        return message


def in_frame(pose: Float[np.ndarray, "3"], covariance: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Return the covariance of x, y, θ along the axes of the odometry's frame, as ROS has it, from that of ξ."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return R @ covariance @ R.T
