"""Does the robot run into things? Random drives by hand and random goals in four worlds, without forces.

    python benchmarks/obstacles.py [--count 500] [--seed 0] [--worlds warehouse …]

Each case starts at the world's origin with whatever the laser sees from there. Half of them are driven by hand, with
twists that change every 1.5 s, for 8 s; half are plans straight to a goal within 3 m, which are refused where they lead
through what has been seen. A contact is where the robot's true outline meets what stands at the laser's height; it
counts as avoidable where the laser had seen that place. Prints a table (markdown); exit code 1 at an avoidable contact.
"""

import argparse
import sys
from collections import Counter

import numpy as np

import longreach as lr
from longreach.app import robot_side
from longreach.app.goals import Follow, VelocityGoal
from longreach.app.robot_side import Orders, TickRecord
from longreach.control import _obstacle_kernels as kernels
from longreach.control.hardware import Command
from longreach.control.obstacles import met_by
from longreach.live.client.motions import straight
from longreach.live.server.serving import tracker_config
from longreach.robot.footprint import footprint_of
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot
from longreach.sim.worlds import load_world

WORLDS = ("laboratory", "office", "corridor", "warehouse")
_CONFIG = KinematicConfig(present=("wheels", "imu", "joints", "lidar"))
_SEEN = 0.1  # so near a remembered point what was met had been seen [m]
_BEGIN, _HELD, _DRIVE = 0.5, 1.5, 8.0  # when a drive begins, how long a twist is held, and the whole drive [s]


def walls(world: str, height: float) -> np.ndarray:
    """Return points (n, 2) [m], 2 cm apart, on all that stands at a height."""
    rows = []
    for x0, y0, x1, y1 in load_world(world).at_height(height):
        t = np.linspace(0.0, 1.0, max(int(np.hypot(x1 - x0, y1 - y0) / 0.02), 1) + 1)[:, None]
        rows.append(np.array([x0, y0]) + t * np.array([x1 - x0, y1 - y0]))
    return np.vstack(rows)


class Case:
    """One drive: what the operator asks for, and what became of it."""

    def __init__(self, robot: lr.MobileManipulator, world: str, points: np.ndarray, seed: int) -> None:
        self.robot, self.points, self.rng = robot, points, np.random.default_rng(seed)
        self.body = KinematicRobot(robot, world, seed=seed, config=_CONFIG)
        self.footprint, self.newest = footprint_of(robot), None
        self.by_hand, self.outcome, self.clearance, self.ticks = seed % 2 == 0, "", np.inf, 0
        self.twist, self.until = np.zeros(3), _BEGIN

    def orders(self, now: float) -> Orders:
        """Return what is asked for at a time [s]."""
        if self.by_hand:
            if now >= self.until:
                self.twist, self.until = self.rng.uniform(-1.0, 1.0, 3) * [1.1, 1.1, 1.5], now + _HELD
            command = Command(now, np.zeros(6), base=self.twist)
            return Orders(goal=VelocityGoal(command, now) if now >= _BEGIN else None, heartbeat=now)
        if now < _BEGIN or self.outcome or self.newest is None:
            return Orders(heartbeat=now)
        q = self.newest.tick.q
        goal = q.copy()
        goal[:3] += self.rng.uniform(-1.0, 1.0, 3) * [3.0, 3.0, 2.0]
        plan = straight(self.robot, q, goal)
        why = met_by(self.newest.state.gate.obstacles, plan)
        self.outcome = f"refused: {why}" if why else "planned"
        return Orders(goal=None if why else Follow(plan, 0.0), heartbeat=now)

    def look(self, record: TickRecord) -> None:
        """Take what a tick did, and see from time to time how near the robot really is to something."""
        self.newest, self.ticks = record, self.ticks + 1
        if record.state.why:
            self.outcome = f"ended early: {record.state.why}"
        if self.ticks % 5 or "contact" in self.outcome:
            return
        truth = self.body.truth()
        capsules = self.footprint.capsules(truth.q[self.robot.arm])
        near = self.points[np.hypot(*(self.points - truth.base[:2]).T) < 2.5]
        away = [kernels.distance_from(p, truth.base, self.footprint.rectangle, capsules) for p in near]
        if away and min(away) < self.clearance:
            self.clearance = min(away)
            if self.clearance < 0.0:
                around, met = record.state.gate.obstacles, near[int(np.argmin(away))]
                known = np.hypot(*(around.points[: around.count] - met).T).min(initial=np.inf) < _SEEN
                self.outcome = "contact, seen" if known else "contact, not seen before"

    def run(self) -> None:
        """Drive."""
        robot_side.run(
            self.body, lambda stamp: self.body.advance(max(stamp - self.body.stamp, 0.0)), self.robot, np.zeros(3),
            self.orders, self.look, self._over, tracker_config(self.body, self.robot),
        )  # fmt: skip

    def _over(self) -> str:
        return "over" if self.body.stamp > _DRIVE or self.outcome.startswith(("refused", "contact")) else ""


def main() -> None:
    """Drive all cases, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--worlds", nargs="+", choices=WORLDS, default=WORLDS)
    options = parser.parse_args()
    robot = lr.load_robot("thing")
    height = robot.description.lidar.mount.z
    avoidable = 0
    print("| world | cases | plans refused | blocked on the way | contacts: seen / not seen | nearest otherwise [m] |")
    print("|---|---|---|---|---|---|")
    for world in options.worlds:
        points = walls(world, height)
        cases = [Case(robot, world, points, options.seed + i) for i in range(options.count // len(WORLDS))]
        for case in cases:
            case.run()
        kinds = Counter(case.outcome.split(":")[0] for case in cases)
        seen, unseen = kinds["contact, seen"], kinds["contact, not seen before"]
        avoidable += seen
        nearest = min(case.clearance for case in cases if "contact" not in case.outcome)
        print(
            f"| {world} | {len(cases)} | {kinds['refused']} | {kinds['ended early']} | {seen} / {unseen} "
            f"| {nearest:.3f} |",
            flush=True,
        )
    sys.exit(int(avoidable > 0))


if __name__ == "__main__":
    main()
