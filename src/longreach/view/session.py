"""What a robot does while somebody drives it by hand, written as a recording that `longreach view` shows again."""

from pathlib import Path
from typing import Any

import numpy as np

from longreach.errors import RecordingError
from longreach.io.bag_writer import write_bag
from longreach.measurement import JointState, Odometry, Recording
from longreach.trajectory import PoseTrajectory
from longreach.view.robot_client import RobotClient


class Session:
    """Takes all states and scans of a client from now on, until it is written."""

    def __init__(self, client: RobotClient) -> None:
        self._robot = client.robot
        self._states: list[Any] = []
        self._scans: list[Any] = []
        self._ends = (client.on_state(self._states.append), client.on_scan(self._scans.append))

    def write(self, path: Path) -> int:
        """End it, write an MCAP and return how many states are in it.

        Raises:
            RecordingError: nothing has come.
        """
        for end in self._ends:
            end()
        robot = self._robot
        states = [s for i, s in enumerate(self._states) if i == 0 or s.stamp > self._states[i - 1].stamp]
        if len(states) < 2:
            raise RecordingError("Nothing was recorded: no state has come from the robot.")
        stamps = np.array([s.stamp for s in states])
        names, arm = robot.joint_names[robot.arm], robot.arm
        truths = [s for s in states if s.truth is not None]
        recording = Recording(
            name=path.stem,
            wheels=tuple(Odometry(s.stamp, np.array(s.wheels)) for s in states),
            scans=tuple(self._scans),
            joints=tuple(JointState(s.stamp, names, s.q[arm], s.velocity[arm], np.zeros(0)) for s in states),
            truth=PoseTrajectory(np.array([s.stamp for s in truths]), np.array([s.truth for s in truths]))
            if truths
            else None,
        )
        online = PoseTrajectory(stamps, np.array([s.q[:3] for s in states]), np.array([s.covariance for s in states]))
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bag(path, recording, robot.description, estimate=online)
        return len(states)
