"""test1.bag of robot_localization with its configuration: its regression values, and messages that come late."""

import numpy as np
import pytest
from real.conftest import unchecked

from longreach.estimation.spatial.batch import estimate_in_space
from longreach.io.robot_localization import read_parameters
from longreach.io.robot_localization_bag import read_spatial_recording

MOUNT = f"base_link:imu_link=0,-0.3,0.52,{np.pi / 2},0,{-np.pi / 2}"
PARAMETERS = """
frequency: 30
sensor_timeout: 0.1
odom0: /husky_velocity_controller/odom
odom0_config: [false, false, false, false, false, false, true, true, true, false, false, false, false, false, false]
imu0: /imu/data
imu0_config: [false, false, false, true, true, true, false, false, false, true, true, false, true, true, true]
imu0_remove_gravitational_acceleration: true
process_noise_covariance: [.05, .05, .06, .03, .03, .06, .025, .025, .04, .01, .01, .02, .01, .01, .015]
initial_estimate_covariance: [1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9]
"""
LAST = {"ekf": (-40.0454, -76.9988, -2.6974), "ukf": (-39.7333, -76.9820, -2.4427)}
BAR = {"ekf": 0.30, "ukf": 0.40}


@pytest.fixture(scope="module")
def settings(tmp_path_factory):
    path = tmp_path_factory.mktemp("husky") / "husky.yaml"
    path.write_text(PARAMETERS)
    return lambda **changes: read_parameters(path, changes=changes).settings


@pytest.fixture(scope="module")
def husky(data, settings):
    return unchecked(read_spatial_recording, data / "robot_localization" / "test1.bag", settings(), [MOUNT])


def last(recording, settings):
    return unchecked(estimate_in_space, recording, settings).states[-1, :3]


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize("as_is", [True, False])
def test_the_last_position_is_that_of_robot_localization(husky, settings, kind, as_is):
    found = last(husky, settings(filter=kind, as_robot_localization=as_is))
    assert np.linalg.norm(found - LAST[kind]) < BAR[kind]


@pytest.mark.parametrize("as_is", [True, False])
def test_messages_up_to_200_ms_late_change_nothing(husky, settings, rng, as_is):
    late = np.array([reading.stamp for reading in husky.readings]) + rng.uniform(0.0, 0.2, len(husky.readings))
    shuffled = type(husky)(
        husky.name, tuple(husky.readings[i] for i in np.argsort(late)), (), husky.mounts, husky.origins
    )
    s = settings(as_robot_localization=as_is)
    assert np.linalg.norm(last(shuffled, s) - last(husky, s)) < 1e-6
