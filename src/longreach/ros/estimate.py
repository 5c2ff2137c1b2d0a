"""The estimate as a ROS node: sensors in by topics, odometry with covariance, tf and diagnostics out.

`odometry/filtered` and tf are what is believed now, as robot_localization's are: of the newest measurement's stamp.
With absolute fixes `odometry/localized` says the same in the frame map, and tf has map → odom (REP-105).
`odometry/settled` are the rows of `longreach estimate`: each is sent once it is older than the filter's history, when
nothing that comes late can change it any more, so that a recording played in gives what it gives offline.
"""

import time
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.app import localizer
from longreach.app.configuration import EstimateConfig
from longreach.app.localizer import LocalizerState, Row
from longreach.app.start import start_pose
from longreach.estimation.fusion import Correction
from longreach.estimation.gaussian import Belief
from longreach.geometry import se2
from longreach.io import messages
from longreach.io.bag_topics import ODOMETRY
from longreach.measurement import LaserScan, Odometry
from longreach.robot.description import RobotDescription
from longreach.ros import wire
from longreach.ros.diagnostics import Diagnostics
from longreach.ros.frames import Broadcaster, Mounts, planar
from longreach.ros.sensors import Heard, Role, Sensors

_SOURCES: tuple[Role, ...] = ("wheels", "lidar", "imu", "fixes")
_BEFORE = 0.5  # [s] that is listened before the estimate begins with the oldest of it: the filter's history
_PIECE = 0.2  # [s]
_PATIENCE = 0.1  # [s] that a scan waits for the wheels that it is matched with


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
    """Estimate until the node is told to end.

    Raises:
        LiveError: rospy is not there, or no master answers.
        EstimationError: the wheels' topic carries what this robot's wheels cannot be read from.
    """
    config = config or NodeConfig()
    wire.start_node("longreach_estimate")
    sensors = Sensors(robot, config.estimate.sources or _SOURCES)
    unplaced = any(sensor is None or sensor.mount is None for sensor in (robot.lidar, robot.imu))
    estimator = Estimator(robot, config.estimate, Mounts() if unplaced else None)
    out, health = _Outputs(config), Diagnostics(sensors)
    with wire.running() as goes_on:
        while goes_on():
            time.sleep(1.0 / config.rate)
            before = estimator.where
            rows, corrections = estimator.take(sensors.take(), time.monotonic())
            out.settled(rows)
            if estimator.where is not None and (before is None or estimator.where.filter.stamp > before.filter.stamp):
                out.filtered(estimator.where)
            health.take(corrections)


class Estimator:
    """The estimate of what is heard, portion by portion; `where`: its state, None before it has begun."""

    def __init__(self, robot: RobotDescription, config: EstimateConfig, mounts: Mounts | None = None) -> None:
        self.where: LocalizerState | None = None
        self._robot, self._config, self._mounts = robot, config, mounts
        self._kept: list[Heard] = []
        self._began = 0.0
        self._held: list[tuple[float, LaserScan]] = []  # and when it came
        self._wheels = -np.inf  # stamp of the newest [s]

    def take(self, heard: Heard, now: float) -> tuple[list[Row], list[Correction]]:
        """Return the rows that this has settled, and what became of the measurements; now [s] on any clock."""
        heard = self._in_time(heard, now)
        if self.where is None:
            if not self._kept:
                self._began = now
            self._kept += [heard] if _says_something(heard) else []
            if not self._kept or now - self._began < _BEFORE:
                return [], []
            heard, self._kept = _merged(self._kept), []
            robot, readings = self._robot, heard.readings
            if self._mounts is not None:
                robot = self._mounts.described(robot, readings.scans, readings.imu)
            self.where = begin(robot, self._config, heard)
        rows: list[Row] = []
        corrections: list[Correction] = []
        for piece in _pieces(heard):
            before = self.where
            self.where, judged = localizer.step(before, piece.readings, piece.fixes)
            rows += localizer.settled(before, self.where)
            corrections += judged
        return rows, corrections

    def _in_time(self, heard: Heard, now: float) -> Heard:
        """Hold scans back until the wheels up to their stamps are there, which a replay looks for a match with."""
        readings = heard.readings
        if readings.wheels:
            self._wheels = readings.wheels[-1].stamp
        self._held += [(now, scan) for scan in readings.scans]
        ready = 0
        for came, scan in self._held:
            if np.isfinite(self._wheels) and scan.stamp > self._wheels and now - came < _PATIENCE:
                break
            ready += 1
        scans = tuple(scan for _, scan in self._held[:ready])
        self._held = self._held[ready:]
        return heard._replace(readings=replace(readings, scans=scans))


def begin(robot: RobotDescription, config: EstimateConfig, first: Heard) -> LocalizerState:
    """Start with the oldest of what was heard: at the identity, on the map where absolute poses say the robot was."""
    fixes = first.fixes if config.sources is None or "fixes" in config.sources else ()
    stamp = min([localizer.oldest(first.readings, config), *(fix.stamp for fix in fixes)])
    return localizer.init(robot, stamp, np.zeros(3), config, start_pose(fixes, (), stamp) if fixes else None)


def _says_something(heard: Heard) -> bool:
    readings = heard.readings
    return any((readings.wheels, readings.scans, readings.imu, heard.fixes))


def _merged(kept: list[Heard]) -> Heard:
    """Return several portions as one."""
    together = {
        name: tuple(record for heard in kept for record in getattr(heard.readings, name))
        for name in ("wheels", "scans", "imu")
    }
    return Heard(replace(kept[-1].readings, **together), tuple(fix for heard in kept for fix in heard.fixes))


def _pieces(heard: Heard) -> list[Heard]:
    """Return a portion cut into pieces by stamp, each much shorter than the filter's history, in which rows settle."""
    parts: dict[int, dict[str, list[Any]]] = {}
    named = {"fixes": heard.fixes, **{name: getattr(heard.readings, name) for name in ("wheels", "scans", "imu")}}
    for name, records in named.items():
        for record in records:
            parts.setdefault(int(record.stamp // _PIECE), {name: [] for name in named})[name].append(record)
    pieces = []
    for _, part in sorted(parts.items()):
        fixes = tuple(part.pop("fixes"))
        pieces.append(Heard(replace(heard.readings, **{name: tuple(part[name]) for name in part}), fixes))
    return pieces


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
        belief, config = where.filter.belief, self._config
        stamp = belief.stamp
        self._filtered.send(self._odometry(config.frame, belief))
        frames = {config.base: (config.frame, planar(belief.pose))}
        if where.localized is not None:
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
