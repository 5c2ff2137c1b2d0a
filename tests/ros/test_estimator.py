"""What the node does with what it hears, without a ROS: the same rows as offline, whenever and in whatever order."""

from dataclasses import replace

import numpy as np
import pytest
from ros_nodes import portions, rows_heard

from longreach.app.configuration import EstimateConfig, EvaluationConfig
from longreach.app.estimate import estimate
from longreach.control.hardware import Readings
from longreach.geometry import se2
from longreach.io.config import load_description
from longreach.measurement import PoseMeasurement
from longreach.ros.estimate import Estimator, in_frame
from longreach.ros.sensors import Heard
from longreach.sim.kinematic import make_recording

CONFIG = EstimateConfig(evaluation=EvaluationConfig(align="none"))


@pytest.fixture(scope="module")
def thing():
    return load_description("thing")


@pytest.fixture(scope="module")
def recording(thing):
    recording = make_recording(thing, seed=2, duration=1.6, lidar_rate=10.0, beams=90)
    deviation = np.array([0.01, 0.01, 0.02])
    fixes = [
        PoseMeasurement(stamp, pose, np.diag(deviation**2), source="fixes")
        for stamp, pose in zip(recording.truth.clock[::25].tolist(), recording.truth.poses[::25], strict=True)
    ]
    return recording.replace(fixes=tuple(fixes))


@pytest.mark.parametrize(
    ("late", "tick"),
    [
        ({"wheels": 0.002, "scans": 0.03, "imu": 0.004}, 0.02),
        ({"wheels": 0.08, "scans": 0.0, "imu": 0.2}, 0.02),  # scans come before the wheels that they are matched with
        ({"wheels": 0.0, "scans": 0.0, "imu": 0.0}, 1.1),  # a node that slept
        ({"wheels": 0.0, "scans": 0.01, "imu": 0.0, "fixes": 0.1}, 0.02),
    ],
)
def test_whatever_comes_when_the_settled_rows_are_those_of_the_recording(thing, recording, plain, late, tick):
    heard = recording if "fixes" in late else recording.replace(fixes=())
    fused = plain(estimate, heard, thing, CONFIG).trajectories["fused"]
    rows = plain(rows_heard, thing, CONFIG, heard, late, tick)
    settled = np.flatnonzero(fused.stamps < max(rows)).tolist()
    assert len(settled) > 50
    for i in settled:
        row = rows[float(fused.stamps[i])]
        np.testing.assert_array_equal(row.pose, fused.poses[i])
        np.testing.assert_array_equal(row.covariance, fused.covariance[i])


def test_a_stamp_from_another_century_is_refused_and_costs_nothing(thing, recording):
    heard = list(portions(recording.replace(fixes=()), {"wheels": 0.0, "imu": 0.0}, 0.02))
    portion, now = heard[40]
    imu = replace(portion.readings.imu[0], stamp=4e9)
    heard[40] = portion._replace(readings=replace(portion.readings, imu=(*portion.readings.imu, imu))), now
    estimator = Estimator(thing, CONFIG)
    judged = [correction for portion, now in heard for correction in estimator.take(portion, now).corrections]
    assert [c.stamp for c in judged if c.status == "refused"] == [4e9]
    assert estimator.where.stamp < 4.0


def test_before_anything_is_heard_there_is_no_estimate(thing):
    estimator = Estimator(thing, CONFIG)
    assert estimator.take(Heard(Readings(1.0), ()), 100.0) == ([], [], [], [], [])
    assert estimator.where is None


def test_a_covariance_in_the_frame_is_that_of_the_frames_axes(rng):
    pose = np.array([1.0, 2.0, 0.7])
    A = rng.normal(size=(3, 3))
    P = 1e-8 * A @ A.T
    draws = rng.multivariate_normal(np.zeros(3), P, size=2000)
    poses = np.array([se2.retract(pose, xi) for xi in draws])
    np.testing.assert_allclose(np.cov((poses - pose).T), in_frame(pose, P), rtol=0.2, atol=5e-10)
