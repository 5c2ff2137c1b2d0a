"""Where the settings of a run come from."""

import numpy as np
import pytest
from pydantic import ValidationError

from longreach.app.configuration import EstimateConfig, filter_for
from longreach.estimation.filter_config import FilterConfig
from longreach.measurement import Odometry, Recording
from longreach.robot.description import ImuSensor, RobotDescription
from longreach.trajectory import stamp_deviation

ROBOT = RobotDescription(name="r", acceleration_limits=(1.0, 2.0, 3.0))


def recorded(stamps):
    return Recording("r", wheels=tuple(Odometry(float(t), pose=np.zeros(3)) for t in stamps))


def test_the_robots_limits_say_how_hard_it_accelerates():
    config = filter_for(EstimateConfig(), ROBOT, recorded([0.0, 1.0]))
    assert config.acceleration_deviation == pytest.approx(tuple(np.array([1.0, 2.0, 3.0]) / np.sqrt(3)))
    set_by_hand = EstimateConfig(filter=FilterConfig(acceleration_deviation=(5.0, 5.0, 5.0)))
    assert filter_for(set_by_hand, ROBOT, recorded([0.0])).acceleration_deviation == (5.0, 5.0, 5.0)


def test_the_imu_says_how_its_bias_walks():
    robot = ROBOT.model_copy(update={"imu": ImuSensor(gyro_bias_walk=0.5, gyro_bias_deviation=0.25)})
    config = filter_for(EstimateConfig(), robot, recorded([0.0]))
    assert (config.gyro_bias_walk, config.initial_gyro_bias_deviation) == (0.5, 0.25)
    set_by_hand = EstimateConfig(filter=FilterConfig(gyro_bias_walk=0.125))
    assert filter_for(set_by_hand, robot, recorded([0.0])).gyro_bias_walk == 0.125


def test_the_rhythm_of_the_recording_says_how_good_its_stamps_are(rng):
    stamps = np.arange(0.0, 20.0, 0.1) + 0.01 * rng.normal(size=200)
    config = filter_for(EstimateConfig(), ROBOT, recorded(stamps))
    assert config.stamp_deviation == stamp_deviation(stamps)
    set_by_hand = EstimateConfig(filter=FilterConfig(stamp_deviation=0.0))
    assert filter_for(set_by_hand, ROBOT, recorded(stamps)).stamp_deviation == 0.0


def test_a_pause_may_be_as_long_as_the_recording():
    assert filter_for(EstimateConfig(), ROBOT, recorded([5.0, 1000.0])).longest_prediction == 995.0
    assert filter_for(EstimateConfig(), ROBOT, recorded([5.0, 6.0])).longest_prediction == 60.0
    assert filter_for(EstimateConfig(), ROBOT, Recording("r")).longest_prediction == 60.0


@pytest.mark.parametrize(
    "changes", [{"sources": ()}, {"sources": ("sonar",)}, {"colour": 1}, {"filter": {"history": -1}}]
)
def test_what_cannot_be_set_is_refused(changes):
    with pytest.raises(ValidationError):
        EstimateConfig.model_validate(changes)


def test_every_setting_says_what_it_is():
    def fields(model):
        for name, field in model.model_fields.items():
            nested = getattr(field.annotation, "model_fields", None)
            if nested:
                yield from fields(field.annotation)
            else:
                yield f"{model.__name__}.{name}", field.description

    assert not [name for name, description in fields(EstimateConfig) if not description]
