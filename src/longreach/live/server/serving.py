"""A robot served: hardware, loop, network and recording, until somebody ends it."""

import logging
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np

from longreach.app import robot_side
from longreach.app.configuration import EstimateConfig
from longreach.app.goals import Follow, ServoGoal, VelocityGoal
from longreach.app.operated import simulated
from longreach.app.paced import Paced
from longreach.app.tracker import TrackerConfig
from longreach.configuration import ConfigurationTrajectory
from longreach.control.hardware import Command, Hardware
from longreach.control.safety_config import SafetyConfig
from longreach.control.ticker import Ticker
from longreach.io.bag_recorder import Recorder
from longreach.io.config import description_file, to_yaml
from longreach.io.robots import load_robot
from longreach.live.protocol.topics import Sensed
from longreach.live.server import publisher
from longreach.live.server.server import HEARTBEAT_TIMEOUT, Server, ServerConfig
from longreach.rejection_counts import RejectionCounts
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.simulated import Simulated

_LOG = logging.getLogger("longreach.live")
_REHEARSED = 60  # ticks


def described(robot: str) -> tuple[str, str]:
    """Return the YAML of a robot's description, given by its name or a file, and its URDF or an empty text."""
    path = Path(robot) if robot.endswith(".urdf") else description_file(robot)
    description = load_robot(robot).description
    arm = description.arm
    urdf = "" if arm is None or arm.urdf is None else (path.parent / arm.urdf).read_text(encoding="utf-8")
    return to_yaml(description), urdf


def tracker_config(
    hardware: Hardware, robot: MobileManipulator, scans: bool = True, obstacles: bool = True
) -> TrackerConfig:
    """Return the loop's settings: whoever holds the robot is watched, and so are the sensors that it has."""
    stale = {"joints": 0.1, "wheels": 0.2, "scans": 0.25}
    sources: tuple[str, ...] = ("wheels", "lidar", "imu")
    if not scans or robot.description.lidar is None:
        del stale["scans"]
        sources = ("wheels", "imu")
    if robot.description.bolted:
        stale.pop("wheels", None)
        stale.pop("scans", None)
    return TrackerConfig(
        estimate=EstimateConfig.model_validate({"sources": sources}),
        safety=SafetyConfig.model_validate(
            {"heartbeat_timeout": HEARTBEAT_TIMEOUT, "stale_after": stale, "obstacles": obstacles and scans}
        ),
    )


def rehearse(robot: MobileManipulator, kind: str = "kinematic") -> None:
    """Do all that the loop does, on a robot that only pretends, so that no tick has to load or compile anything."""
    body = simulated(kind, robot, "laboratory", 0)
    still = ConfigurationTrajectory(np.array([0.0, 0.1]), np.stack([robot.home, robot.home]))
    zero = Command(0.0, np.zeros(robot.dof - robot.base.stop))
    goals = iter([Follow(still, 0.0), ServoGoal(robot.forward(robot.home)), VelocityGoal(zero, 0.0)])
    records: list[robot_side.TickRecord] = []

    def orders(now: float) -> robot_side.Orders:
        return robot_side.Orders(goal=next(goals, None) if len(records) % 4 == 3 else None)

    robot_side.run(
        body, lambda stamp: body.advance(max(stamp - body.stamp, 0.0)), robot, np.zeros(3), orders, records.append,
        lambda: "The rehearsal is over." if len(records) > _REHEARSED else "", tracker_config(body, robot),
    )  # fmt: skip
    for topic, message in [
        m for record in records for m in publisher.state(robot, Sensed.of(robot.description), record, body.truth())
    ]:
        topic.pack(message)


def serve(
    hardware: Hardware,
    wait_until: Callable[[float], None] | None,
    robot: MobileManipulator,
    description: tuple[str, str],
    config: ServerConfig,
    ended: Callable[[], str],
    *,
    record: Path | None = None,
    scans: bool = True,
    obstacles: bool = True,
    rejections: RejectionCounts | None = None,
    ready: Callable[[Server], None] = lambda server: None,
) -> tuple[Ticker, str]:
    """Serve a robot until `ended` says why it shall end; wait_until: None paces a simulated one to the wall's time.

    Returns how its ticks were, whose lateness is by the wall, of a simulated robot, too, and what is wrong with the
    recording; an empty text where nothing is.

    Raises:
        LiveError: it cannot listen there. RecordingError: it cannot record there.
    """
    truth, base = None, np.zeros(3)
    if isinstance(hardware, Simulated):
        truth, base = hardware.truth, hardware.truth().base
    paced = None
    if wait_until is None:
        assert isinstance(hardware, Simulated)
        wait_until = paced = Paced(hardware)
    settings = tracker_config(hardware, robot, scans, obstacles)
    with nullcontext() if record is None else Recorder(record) as recorder:
        server = Server(robot, description, config, settings, truth, recorder, rejections)
        try:
            ready(server)
            rhythm = robot_side.run(hardware, wait_until, robot, base, server.take, server.publish, ended, settings)
        finally:
            server.close()
    wrong = "" if recorder is None else recorder.error
    if paced is None:
        return rhythm, wrong
    if paced.behind:
        _LOG.warning("The simulation has fallen behind the wall's clock by %.1f s in all.", paced.behind)
    return replace(rhythm, late=paced.late, lateness=paced.lateness), wrong
