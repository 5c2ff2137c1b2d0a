"""Bags of real robots."""

from importlib.resources import files

import numpy as np
import pytest
import yaml

from longreach.io.bag import read_bag
from longreach.io.bag_info import inspect
from longreach.io.bag_writer import write_bag
from longreach.robot.description import RobotDescription
from longreach.trajectory import PoseTrajectory


def described(name):
    text = files("longreach.robot").joinpath("descriptions", f"{name}.yaml").read_text(encoding="utf-8")
    return RobotDescription.model_validate(yaml.safe_load(text))


@pytest.mark.parametrize(("name", "wheels", "truth"), [("bag1", 2871, 9924), ("bag3", 5149, 17799)])
def test_polimis_bags_hold_wheels_and_truth(data, name, wheels, truth):
    found = read_bag(data / "polimi" / f"{name}.bag", described("polimi"))
    assert (len(found.wheels), len(found.truth), found.remarks) == (wheels, truth, ())
    assert found.truth.has_heading
    if name == "bag1":
        np.testing.assert_array_equal(found.wheels[0].ticks, [17313, 11359, 15421, 13209])
        assert found.wheels[0].stamp == pytest.approx(1649348542.220450401, abs=1e-6)


def test_polimis_wheels_are_the_same_in_every_format(data, tmp_path):
    robot = described("polimi")
    whole = read_bag(data / "polimi" / "bag1.bag", robot)
    truth = PoseTrajectory(whole.truth.stamps[:500], whole.truth.poses[:500])
    wanted = whole.replace(wheels=whole.wheels[:500], truth=truth)
    for name in ("a.bag", "a.mcap", "a"):
        write_bag(tmp_path / name, wanted, robot)
        found = read_bag(tmp_path / name, robot)
        assert [w.stamp for w in found.wheels] == [w.stamp for w in wanted.wheels]
        assert [w.ticks.tolist() for w in found.wheels] == [w.ticks.tolist() for w in wanted.wheels]
        np.testing.assert_array_equal(found.truth.stamps, wanted.truth.stamps)
        np.testing.assert_allclose(found.truth.poses, wanted.truth.poses, atol=1e-12)


def test_the_huskys_bag_holds_imu_and_odometry(data):
    path = data / "robot_localization" / "test1.bag"
    found = read_bag(path, described("husky"))
    assert (len(found.imu), len(found.wheels)) == (11865, 3952)
    np.testing.assert_allclose(found.wheels[0].twist_covariance.diagonal(), [0.001, 0.001, 0.03])
    told = {topic.topic: topic for topic in inspect(path).topics}
    assert told["/imu/data"].count == 11865
    assert told["/imu/data"].rate == pytest.approx(30.0, abs=0.1)
    assert told["/husky_velocity_controller/odom"].longest_gap == pytest.approx(0.208, abs=1e-3)
    assert told["/fix"].type == "sensor_msgs/msg/NavSatFix"
