"""Every kind of base is simulated and its wheels read, or a sentence says that it is not."""

from pathlib import Path

import numpy as np
import pytest

import longreach as lr
from longreach.control.hardware import Command
from longreach.errors import ConfigError, PlanningError
from longreach.geometry import se2
from longreach.io import records
from longreach.measurement import WheelSpeeds
from longreach.odometry.wheel import wheel_odometry
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator
from longreach.sim.kinematic_config import KinematicConfig
from longreach.sim.kinematic_robot import KinematicRobot

SKID = {"kind": "differential", "wheel_radius": 0.165, "track_width": 0.57, "wheel_names": ["fl", "fr", "rl", "rr"]}
OMNI = {"kind": "omni", "wheel_radius": 0.05, "centre_distance": 0.2}
THREE = OMNI | {"wheel_angles": [0.5, 2.6, 4.7], "wheel_names": ["a", "b", "c"]}
FOUR = OMNI | {"wheel_angles": [0.7, 2.3, 3.9, 5.5], "wheel_names": ["a", "b", "c", "d"]}
CAR = {"kind": "ackermann", "wheel_radius": 0.1, "wheelbase": 0.5, "track_width": 0.4, "rear_wheels": ["l", "r"]}
CAR |= {"steering": "s"}


def robot(base, signal="angle"):
    description = RobotDescription.model_validate({"name": "cart", "base": base, "encoder": {"signal": signal}})
    return MobileManipulator.from_description(description, Path())


@pytest.mark.parametrize("base", [SKID, THREE, FOUR])
def test_wheels_of_a_simulated_base_say_where_it_went(base):
    cart = robot(base)
    config = KinematicConfig(slip=(0.0, 0.0, 0.0), slip_deviation=(0.0, 0.0, 0.0))
    simulated, wheels = KinematicRobot(cart, "laboratory", config=config, seed=1), []
    for k in range(150):
        twist = np.array([0.4, 0.1, 0.2]) if k < 75 else np.zeros(3)  # at rest at the end: readings have a latency
        simulated.write(Command(simulated.stamp, base=twist))
        simulated.advance(0.02)
        wheels += simulated.read().wheels
    pose = np.zeros(3)
    for step in wheel_odometry(wheels, cart.description).measurements:
        pose = se2.compose(pose, step.pose)
    np.testing.assert_allclose(pose, simulated.truth().base, atol=1e-3)
    assert np.hypot(*pose[:2]) > 0.4


def test_a_base_that_is_steered_like_a_car_is_neither_simulated_nor_planned_for():
    car = robot(CAR)
    with pytest.raises(ConfigError, match="cart is steered like a car and cannot be simulated"):
        KinematicRobot(car, "laboratory")
    reference = lr.Reference(np.zeros(1), base=np.zeros((1, 3)))
    with pytest.raises(PlanningError, match="cart is steered like a car, and plans would turn it on the spot"):
        lr.plan(car, reference, np.zeros(3))


class Message:
    name = ("s", "r", "l")
    position = np.array([0.3, 20.0, 10.0])
    velocity = np.array([0.0, 2.0, 1.0])


def test_a_cars_steering_angle_is_read_beside_the_speeds_of_its_wheels():
    found = records.wheels(Message, robot(CAR, "speed").description)
    record = found[1](stamp=0.0)
    assert isinstance(record, WheelSpeeds)
    np.testing.assert_array_equal(record.speeds, [1.0, 2.0, 0.3])
    by_angle = records.wheels(Message, robot(CAR).description)[1](stamp=0.0)
    np.testing.assert_array_equal(by_angle.ticks, [10.0, 20.0, 0.3])
