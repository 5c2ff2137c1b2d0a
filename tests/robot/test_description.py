"""Descriptions: the shipped ones load and say what the facts say; wrong ones are refused by name."""

from importlib.resources import files

import numpy as np
import pytest
import yaml
from pydantic import ValidationError

from longreach.geometry import se3
from longreach.robot.bases import DifferentialBase, MecanumBase
from longreach.robot.description import Encoder, Mount, RobotDescription

SHIPPED = {
    path.name.removesuffix(".yaml"): path
    for path in files("longreach.robot").joinpath("descriptions").iterdir()
    if path.name.endswith(".yaml")
}


def shipped(name):
    return RobotDescription.model_validate(yaml.safe_load(SHIPPED[name].read_text(encoding="utf-8")))


@pytest.mark.parametrize("name", sorted(SHIPPED))
def test_every_shipped_description_loads_under_its_own_name_and_survives_yaml(name):
    robot = shipped(name)
    assert robot.name == name
    again = RobotDescription.model_validate(yaml.safe_load(yaml.safe_dump(robot.model_dump(mode="json"))))
    assert again == robot


def test_which_robots_are_there_and_which_can_move_sideways():
    assert {name: shipped(name).holonomic for name in SHIPPED} == {
        "thing": True,
        "polimi": True,
        "intel": False,
        "aces": False,
        "fr079": False,
        "csail": False,
        "brenner": False,
        "husky": False,
        "panda_cart": False,
        "ur10": True,
    }


def test_the_thing_has_the_ridgebacks_base_and_sensors():
    thing = shipped("thing")
    assert isinstance(thing.base, MecanumBase)
    assert thing.base.lever == pytest.approx(0.5945)
    assert thing.encoder.radians_per_tick == 1.0
    assert thing.encoder.resolution == pytest.approx(2 * np.pi / (1024 * 34.97))
    np.testing.assert_allclose(thing.lidar.mount.matrix()[:3, 3], [0.3932, 0.0, 0.233])
    np.testing.assert_allclose(thing.imu.mount.matrix()[:3, 3], [0.2085, -0.2902, 0.1681])
    assert 1 - 2 * thing.lidar.angle_min / thing.lidar.angle_increment == pytest.approx(1081)
    assert thing.velocity_limits == (1.1, 1.1, 2.0)


def test_a_count_of_brenners_tracks_is_0_349_mm():
    robot = shipped("brenner")
    assert isinstance(robot.base, DifferentialBase)
    assert robot.encoder.radians_per_tick * robot.base.wheel_radius == pytest.approx(0.349e-3, rel=5e-4)
    assert robot.lidar.angle_min == pytest.approx(-330 * 0.0061359 - 0.0698)


def test_a_wheel_of_polimi_makes_210_counts_a_turn():
    assert 2 * np.pi / shipped("polimi").encoder.radians_per_tick == pytest.approx(210)


def test_a_mount_turns_in_the_order_roll_pitch_yaw():
    T = shipped("husky").imu.mount.matrix()
    np.testing.assert_allclose(T @ se3.inverse(T), np.eye(4), atol=1e-15)
    np.testing.assert_allclose(T[:3, 3], [0.0, -0.3, 0.52])
    # Rolled by 90° about its own x and then turned by -90° about z: x points to the base's right, y up, z back.
    np.testing.assert_allclose(T[:3, :3], [[0, 0, -1], [-1, 0, 0], [0, 1, 0]], atol=1e-15)
    np.testing.assert_array_equal(Mount().matrix(), np.eye(4))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"colour": "red"}, "colour"),
        ({"base": {"kind": "tricycle"}}, "kind"),
        ({"base": {"kind": "differential", "wheel_radius": 0.1, "track_width": 0.3}}, "not both"),
        ({"encoder": {"signal": "ticks"}}, "needs counts_per_revolution"),
        ({"velocity_limits": [1.0, 0.0, 1.0]}, "greater than 0"),
        ({"lidar": {"range_max": float("inf")}}, "finite"),
        ({"arm": {"urdf": "a.urdf", "dh": [{"d": 0.1}]}}, "either urdf or dh"),
        ({"arm": {}}, "either urdf or dh"),
        ({"arm": {"dh": [{"d": 0.1, "joint": "helical"}]}}, "joint"),
    ],
)
def test_a_description_that_cannot_be_is_refused(change, message):
    with pytest.raises(ValidationError, match=message):
        RobotDescription.model_validate({"name": "x", "drive": "differential", **change})


def test_without_base_and_drive_nothing_forbids_moving_sideways():
    assert RobotDescription(name="handheld").holonomic


def test_an_angle_needs_no_counts():
    assert Encoder(signal="speed").radians_per_tick == 1.0
    assert Encoder().resolution is None
