"""What a robot's description says of its filter."""

import numpy as np
import pytest

from longreach.estimation.planar.config import FilterConfig
from longreach.localization.config import LocalizerConfig, filter_for
from longreach.robot.description import ImuSensor, RobotDescription

ROBOT = RobotDescription(name="r", acceleration_limits=(1.0, 2.0, 3.0))


def test_the_robots_limits_say_how_hard_it_accelerates():
    config = filter_for(LocalizerConfig(), ROBOT)
    assert config.acceleration_deviation == pytest.approx(tuple(np.array([1.0, 2.0, 3.0]) / np.sqrt(3)))
    set_by_hand = LocalizerConfig(filter=FilterConfig(acceleration_deviation=(5.0, 5.0, 5.0)))
    assert filter_for(set_by_hand, ROBOT).acceleration_deviation == (5.0, 5.0, 5.0)


def test_the_imu_says_how_its_bias_walks():
    robot = ROBOT.model_copy(update={"imu": ImuSensor(gyro_bias_walk=0.5, gyro_bias_deviation=0.25)})
    config = filter_for(LocalizerConfig(), robot)
    assert (config.gyro_bias_walk, config.initial_gyro_bias_deviation) == (0.5, 0.25)
    set_by_hand = LocalizerConfig(filter=FilterConfig(gyro_bias_walk=0.125))
    assert filter_for(set_by_hand, robot).gyro_bias_walk == 0.125


def test_one_setting_that_is_given_leaves_the_others_as_a_localizer_has_them():
    plain, changed = LocalizerConfig(), LocalizerConfig.model_validate({"filter": {"gyro_bias_walk": 0.5}})
    assert filter_for(changed, ROBOT) == filter_for(plain, ROBOT).changed(gyro_bias_walk=0.5)
    assert filter_for(plain, ROBOT).gate_mode == "inflate"


def test_settings_that_were_made_for_a_robot_stay_as_they_are_for_it():
    made = LocalizerConfig(filter=filter_for(LocalizerConfig(), ROBOT))
    assert filter_for(made, ROBOT.model_copy(update={"acceleration_limits": (9.0, 9.0, 9.0)})) == made.filter
