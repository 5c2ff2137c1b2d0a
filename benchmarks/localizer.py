"""The localizer: time of a reading and of a tick of the 125 Hz loop, and sweeps of a base that turns at 2 rad/s.

    python benchmarks/localizer.py [--seconds S]

* A simulated Thing whose scanner sends 1081 beams 40 times a second, wheels at 50 Hz, IMU at 100 Hz: processor time of
  `localizer.step` for one reading of each kind, in the order of arrival. Beside it range flow (2016) on the same scans.
* The loop that drives the robot, everything on, at 125 Hz: processor time of a tick, which includes what arrived late.
* Sweeps of 0.1 s around, on a base that turns to and fro at up to 2 rad/s and drives at 0.2 m/s: ATE and NEES with the
  time of each beam, and taken for instants.

Kernels are warm, one core. Exit code 1: a bar missed.
"""

import argparse
import sys
import time

import numpy as np

from longreach.app import robot_side
from longreach.app.goals import VelocityGoal
from longreach.app.robot_side import Orders
from longreach.app.tracker import TrackerConfig, sensed
from longreach.control.hardware import Command
from longreach.evaluation.alignment import rigid_alignment
from longreach.geometry import se2
from longreach.io.robots import load_robot
from longreach.localization import localizer
from longreach.measurement import Imu, LaserScan
from longreach.odometry.lidar import lidar_odometry
from longreach.odometry.matchers import range_flow
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.room import cast, polygonal_room

ROBOT = "thing"
BARS = {"scan, median": 1.0, "tick, median": 1.0, "tick, p99": 3.0}  # ms
MISSED: list[str] = []


def show(what: str, value: float, unit: str, high: float = float("nan"), low: float = 0.0) -> None:
    """Print a figure beside its bar."""
    met = bool(low <= value <= high)
    if not met and high == high:
        MISSED.append(what)
    bar = "" if high != high else f"bar {low:g} to {high:<6g} {'met' if met else 'MISSED'}"
    print(f"{what:58} {value:9.4f} {unit:4} {bar}", flush=True)


def drive(seconds: float) -> list[robot_side.TickRecord]:
    """Drive to and fro in the laboratory; return what each tick knew and took."""
    robot, moments = load_robot(ROBOT), list[robot_side.TickRecord]()
    body = KinematicRobot(robot, seed=1, config=KinematicConfig(present=("wheels", "imu", "joints", "lidar")))

    def orders(now: float) -> Orders:
        side = 1.0 if int(now / 4.0) % 2 == 0 else -1.0
        return Orders(
            goal=VelocityGoal(Command(now, np.zeros(6), base=np.array([0.4, 0.2, 0.5]) * side), now), heartbeat=now
        )

    robot_side.run(
        body, lambda stamp: body.advance(max(stamp - body.stamp, 0.0)), robot, body.truth().base, orders,
        moments.append, lambda: "The drive is over." if body.stamp >= seconds else "", TrackerConfig(),
    )  # fmt: skip
    return moments


def times(seconds: float) -> None:
    """Print what a reading of each kind and a tick take."""
    drive(1.0)  # kernels are loaded
    moments = drive(seconds)
    ticks = 1e3 * np.array([moment.loop_time for moment in moments[20:]])
    show("a tick of the 125 Hz loop, median", float(np.median(ticks)), "ms", BARS["tick, median"])
    show("a tick of the 125 Hz loop, p99", float(np.percentile(ticks, 99)), "ms", BARS["tick, p99"])
    readings = [reading for moment in moments for reading in sensed(moment.readings)]
    state, took = localizer.init(load_robot(ROBOT).description), {}
    for reading in readings:
        began = time.process_time()
        state, _ = localizer.step(state, [reading])
        kind = "scan" if isinstance(reading, LaserScan) else "IMU" if isinstance(reading, Imu) else "wheels"
        took.setdefault(kind, []).append(1e3 * (time.process_time() - began))
    for kind, one in took.items():
        show(f"{kind} through the localizer, median", float(np.median(one)), "ms", BARS.get(f"{kind}, median", np.nan))
        show(f"{kind} through the localizer, p99", float(np.percentile(one, 99)), "ms")
    scans = [reading for reading in readings if isinstance(reading, LaserScan)]
    began = time.process_time()
    range_flow.lidar_odometry(scans, np.eye(4))
    flow = 1e3 * (time.process_time() - began) / len(scans)
    show("range flow of the same scans", flow, "ms")
    show("a scan through the localizer over range flow", float(np.median(took["scan"])) / flow, "")


def sweeps(n: int = 360, count: int = 300, seed: int = 1) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Return ranges of sweeps from -π on, the twists during each, and the poses at which each begins."""
    rng, walls = np.random.default_rng(seed), polygonal_room()
    twists = [np.array([0.02 * np.cos(0.05 * i), 0.0, 0.2 * np.sin(0.1 * i)]) for i in range(count)]
    poses = [np.array([-1.0, 0.0, 0.0])]
    for twist in twists[:-1]:
        poses.append(se2.compose(poses[-1], se2.exp(twist)))
    ranges = []
    for pose, twist in zip(poses, twists, strict=True):
        at = np.array([se2.compose(pose, se2.exp(twist * k / n)) for k in range(n)])
        angles = -np.pi + 2 * np.pi / n * np.arange(n)
        seen = np.array([cast(walls, at[k][None], angles[k : k + 1])[0, 0] for k in range(n)])
        ranges.append(seen + 0.01 * rng.standard_normal(n))
    return ranges, twists, np.array(poses)


def turning() -> None:
    """Print errors at 2 rad/s with and without the time of each beam."""
    ranges, twists, truth = sweeps()
    n, found = len(ranges[0]), {}
    for increment in (0.1 / n, 0.0):
        scans = [LaserScan(0.1 * i, r, -np.pi, 2 * np.pi / n, time_increment=increment) for i, r in enumerate(ranges)]
        matches = lidar_odometry(scans, np.eye(4), priors=[None, *(se2.exp(twist) for twist in twists[:-1])])
        poses, row, nees = [truth[0]], {scan.stamp: i for i, scan in enumerate(scans)}, []
        for match in matches:
            m = match.measurement
            assert m is not None
            reference = row[m.stamp_reference]
            poses.append(se2.compose(poses[reference], m.pose))
            xi = se2.difference(m.pose, se2.between(truth[reference], truth[row[m.stamp]]))
            nees.append(xi @ np.linalg.solve(m.covariance, xi))
        path = np.array(poses)
        off = se2.compose(rigid_alignment(path[:, :2], truth[:, :2]), path)[:, :2] - truth[:, :2]
        found[increment] = float(np.sqrt((off**2).sum(axis=1).mean())), float(np.mean(nees))
    (ate, nees), (without, nees_without) = found[0.1 / n], found[0.0]
    show("sweeps at 2 rad/s, ATE", ate, "m", 0.010)  # the bar of fast scans of 360 beams
    show("sweeps at 2 rad/s, NEES", nees, "", 4.0, 2.0)
    show("sweeps taken for instants, ATE", without, "m")
    show("sweeps taken for instants, NEES", nees_without, "")
    show("sweeps taken for instants, times the ATE", without / ate, "", np.inf, 1.5)


def main() -> int:
    """Print all figures; 0 when all bars are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0, help="of driving")
    times(parser.parse_args().seconds)
    turning()
    return 1 if MISSED else 0


if __name__ == "__main__":
    sys.exit(main())
