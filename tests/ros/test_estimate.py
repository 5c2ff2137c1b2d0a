"""A recording played into the node through a real ROS comes out as `longreach estimate` gives it."""

import numpy as np
import pytest
import yaml
from ros_nodes import played

from longreach.app.configuration import EstimateConfig, EvaluationConfig
from longreach.app.estimate import estimate
from longreach.io.config import load_description
from longreach.ros.estimate import in_frame
from longreach.sim.kinematic import make_recording


@pytest.fixture(scope="module")
def thing():
    return load_description("thing")


def test_a_recording_played_in_comes_out_as_the_estimate_of_it(thing, launched, other, tmp_path):
    recording = make_recording(thing, seed=1, duration=4.0, lidar_rate=20.0, beams=270)
    recording = recording.replace(wheels=recording.wheels[1:], scans=recording.scans[1:], imu=recording.imu[1:])
    unplaced = thing.model_dump(mode="json", exclude_unset=True)
    del unplaced["lidar"]["mount"], unplaced["imu"]["mount"]  # tf tells them
    robot = tmp_path / "thing.yaml"
    robot.write_text(yaml.safe_dump(unplaced))
    with launched("estimate.launch", f"robot:={robot}", "options:=--no-tf"):
        online = other(played, thing, recording, 2.0, "/odometry/settled")
    config = EstimateConfig(evaluation=EvaluationConfig(align="none"))
    fused = other(estimate, recording, thing, config).trajectories["fused"]
    settled = np.flatnonzero(fused.stamps < fused.stamps[-1] - 0.52).tolist()
    assert len(settled) > 200
    for i in settled:
        pose, covariance = online[float(fused.stamps[i])]
        np.testing.assert_allclose(pose, fused.poses[i], atol=1e-6)
        np.testing.assert_allclose(covariance, in_frame(fused.poses[i], fused.covariance[i]), atol=1e-9)
