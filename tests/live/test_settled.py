"""A log that is played through the loop and the server: what is settled is the estimate of the log."""

import numpy as np
import pytest
from arrivals import readings_of
from live_networks import free_port
from real.conftest import unchecked

from longreach.app import robot_side
from longreach.app.configuration import EstimateConfig
from longreach.app.estimate import estimate
from longreach.app.inputs import open_run
from longreach.app.tracker import TrackerConfig
from longreach.control.hardware import Readings, capabilities_of
from longreach.io.bag_file import open_bag
from longreach.io.bag_recorder import Recorder
from longreach.io.records import planar_pose
from longreach.io.robots import load_robot
from longreach.live.protocol import topics
from longreach.live.server.server import Server, ServerConfig
from longreach.measurement import Imu, JointState, LaserScan

LOGS = {
    "intel": "intel/intel.clf.bz2",
    "aces": "aces/aces.clf.bz2",
    "fr079": "fr079/fr079.clf.bz2",
    "csail": "csail/csail.clf.bz2",
    "brenner": "brenner",
    "polimi": "polimi/bag1.bag",
}
NOTHING = np.zeros(0)


class Played:
    """A robot without an arm that reads a log, whose scans come a little late."""

    def __init__(self, robot, log, period):
        self.capabilities = capabilities_of(robot)
        arriving = [(r.stamp + 0.04 * isinstance(r, LaserScan), i, r) for i, r in enumerate(readings_of(log))]
        self.stamp, self._waiting, self._period = arriving[0][0], sorted(arriving), period

    @property
    def over(self):
        return not self._waiting

    def read(self):
        self.stamp = max(self.stamp + self._period, self._waiting[0][0] if self._waiting else 0.0)
        new = []
        while self._waiting and self._waiting[0][0] <= self.stamp:
            new.append(self._waiting.pop(0)[2])
        of = {kind: tuple(r for r in new if isinstance(r, kind)) for kind in (LaserScan, Imu)}
        wheels = tuple(r for r in new if not isinstance(r, LaserScan | Imu))
        joints = (JointState(self.stamp, (), NOTHING, NOTHING, NOTHING),)
        return Readings(self.stamp, wheels=wheels, scans=of[LaserScan], imu=of[Imu], joints=joints)

    def write(self, command):
        pass

    def stop(self, reason):
        pass


@pytest.mark.parametrize("name", LOGS)
def test_a_log_through_the_server_settles_the_rows_of_its_estimate(data, tmp_path, name):
    run = open_run(data / LOGS[name], name)
    log = run.recording.replace(truth=None, wheels=run.recording.wheels[:1500], scans=run.recording.scans[:400])
    end = min(records[-1].stamp for records in (log.wheels, log.scans) if records)
    log = log.replace(wheels=tuple(w for w in log.wheels if w.stamp <= end), imu=())
    robot = load_robot(name)
    played, config = Played(robot, log, 0.02), TrackerConfig(estimate=EstimateConfig())
    with Recorder(tmp_path / "said.mcap") as recorder:
        address = f"127.0.0.1:{free_port()}"
        server = Server(robot, ("", ""), ServerConfig(address), config, recorder=recorder)
        try:
            unchecked(
                robot_side.run, played, lambda stamp: None, robot, np.zeros(3), server.take, server.publish,
                lambda: "The log is over." if played.over else "", config,
            )  # fmt: skip
        finally:
            server.close()
    with open_bag(tmp_path / "said.mcap") as bag:
        settled = {}
        for _, _, _, message in bag.messages([(topics.SETTLED.name, topics.SETTLED.type)]):
            stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
            P = np.reshape(message.pose.covariance, (6, 6))[np.ix_([0, 1, 5], [0, 1, 5])]
            pose = message.pose.pose
            settled[round(stamp, 6)] = np.append(planar_pose(pose.position, pose.orientation), P)
    fused = unchecked(estimate, log, run.robot).trajectories["fused"]
    rows = zip(fused.clock.tolist(), fused.poses, fused.covariance, strict=True)
    known = [(t, np.append(pose, P)) for t, pose, P in rows if t < played.stamp - 0.7]
    assert len(known) > 200
    for stamp, row in known:
        np.testing.assert_allclose(settled[round(stamp, 6)], row, rtol=0.0, atol=1e-12)
