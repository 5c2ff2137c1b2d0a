"""Robots that are simulated to be operated: each of those that come with the package."""

import numpy as np
import pytest

from longreach.app import robot_side
from longreach.app.goals import VelocityGoal
from longreach.app.operated import check_simulated, simulated
from longreach.app.robot_side import Orders
from longreach.control.hardware import Command
from longreach.errors import ConfigError
from longreach.io.config import shipped_descriptions
from longreach.io.robots import load_robot
from longreach.live.server.serving import rehearse, tracker_config
from longreach.sim.worlds import load_world

_TWIST = np.array([0.3, 0.0, 0.3])


@pytest.mark.parametrize("name", shipped_descriptions())
def test_every_shipped_robot_drives_for_two_seconds_and_the_estimate_follows(name):
    robot = load_robot(name)
    body, records = simulated("kinematic", robot, "laboratory", 0, scans=False), []
    arm = np.full(robot.dof - robot.base.stop, 0.1)
    twist = _TWIST if robot.base.stop else None

    def orders(now):
        return Orders(goal=VelocityGoal(Command(now, arm, "velocity", twist), now), heartbeat=now)

    robot_side.run(
        body, lambda stamp: body.advance(max(stamp - body.stamp, 0.0)), robot, np.zeros(3), orders, records.append,
        lambda: "over" if body.stamp >= 2.0 else "", tracker_config(body, robot, scans=False),
    )  # fmt: skip
    assert all(record.tick.stop is None for record in records)
    moved, estimated = body.truth().q - robot.home, records[-1].tick.q - robot.home
    assert np.allclose(estimated, moved, atol=0.03)
    assert np.all(np.abs(moved[robot.arm]) > 0.1)
    assert twist is None or (np.hypot(*moved[:2]) > 0.4 and moved[2] > 0.4)


@pytest.mark.parametrize("name", ["ur10", "husky", "panda_cart"])
def test_what_is_no_thing_can_be_rehearsed(name):
    rehearse(load_robot(name))


def test_what_has_no_physics_is_refused_with_what_can_be_simulated():
    world = load_world("laboratory")
    check_simulated("sim", load_robot("thing"), world)
    for name in ("panda_cart", "ur10", "intel"):
        check_simulated("kinematic", load_robot(name), world)
        with pytest.raises(ConfigError, match=rf"mecanum wheels have physics .*{name} is none.*--hardware kinematic"):
            check_simulated("sim", load_robot(name), world)
    with pytest.raises(ConfigError, match="There is no hardware 'real'; there are sim, kinematic and ros"):
        check_simulated("real", load_robot("thing"), world)
