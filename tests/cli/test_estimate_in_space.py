"""longreach estimate with a parameter file of robot_localization: what it leaves, and what it says."""

import json

import numpy as np
import pytest
import spatial_bags
import yaml
from spatial_bags import MOUNT

from longreach.io.tum import read_spatial_tum

LEFT = {"fused.tum", "covariance.npz", "metrics.json", "config.yaml", "report.html", "figures"}


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    path = tmp_path_factory.mktemp("bags") / "drive.bag"
    spatial_bags.write(path)
    return path


@pytest.fixture
def parameters(tmp_path):
    path = tmp_path / "ekf.yaml"
    path.write_text(spatial_bags.PARAMETERS)
    return path


@pytest.mark.parametrize("more", [(), ("--as-robot-localization",), ("--filter", "ukf")])
def test_a_parameter_file_is_followed(run, bag, parameters, tmp_path, more):
    answer = run("estimate", bag, "--config", parameters, "--transform", MOUNT, *more, "--out", tmp_path / "out")
    assert answer.code == 0, answer.err
    assert {path.name for path in (tmp_path / "out").iterdir()} == LEFT
    assert "note: Without effect here: publish_tf." in answer.out
    stamps, T = read_spatial_tum(tmp_path / "out" / "fused.tum")
    np.testing.assert_allclose(T[-1][:3, 3], spatial_bags.truth()[-1][:3, 3], atol=0.05)
    with np.load(tmp_path / "out" / "covariance.npz") as arrays:
        np.testing.assert_allclose(arrays["fused_stamps"], stamps, atol=1e-8)
        assert arrays["fused_covariance"].shape == (len(stamps), 6, 6)
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())["fused"]
    assert metrics["path_length"]["value"] == pytest.approx(3.0, abs=0.1)
    assert metrics["odom0_twist_used"]["value"] == spatial_bags.COUNT
    names = {"plane.png", "height.png", "angles.png", "velocity.png", "innovation.png"}
    assert {path.name for path in (tmp_path / "out" / "figures").iterdir()} == names


def test_the_settings_that_ran_repeat_the_run(run, bag, parameters, tmp_path):
    more = ("--transform", MOUNT, "--as-robot-localization", "--filter", "ukf")
    assert run("estimate", bag, "--config", parameters, *more, "--out", tmp_path / "a").code == 0
    ran = yaml.safe_load((tmp_path / "a" / "config.yaml").read_text())["ekf_node"]["ros__parameters"]
    assert (ran["filter"], ran["as_robot_localization"], ran["transforms"]) == ("ukf", True, [MOUNT])
    assert run("estimate", bag, "--config", tmp_path / "a" / "config.yaml", "--out", tmp_path / "b").code == 0
    assert (tmp_path / "b" / "fused.tum").read_bytes() == (tmp_path / "a" / "fused.tum").read_bytes()


def test_messages_that_come_late_change_nothing(run, bag, parameters, tmp_path, rng):
    spatial_bags.write(tmp_path / "late.bag", late=rng.uniform(0.0, 0.2, 2 * spatial_bags.COUNT))
    for path in (bag, tmp_path / "late.bag"):
        answer = run("estimate", path, "--config", parameters, "--transform", MOUNT, "--out", tmp_path / path.stem)
        assert answer.code == 0, answer.err
    a, b = ((tmp_path / name / "fused.tum").read_bytes() for name in ("drive", "late"))
    assert a == b


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        ((), "say where it is by --transform base_link:imu_link=x,y,z,roll,pitch,yaw"),
        (("--robot", "thing"), "beside which --robot cannot be given"),
        (("--transform", MOUNT, "--filter", "particle"), "filter is 'particle'; it takes ekf or ukf"),
        (("--node", "moon"), "has no node moon with sensors; there are: ekf_node"),
        (("--transform", "base_link:imu_link=1"), "is no transform"),
    ],
)
def test_what_is_wrong_is_one_sentence(run, bag, parameters, tmp_path, more, sentence):
    answer = run("estimate", bag, "--config", parameters, *more, "--out", tmp_path / "out")
    assert answer.code == 2
    assert sentence in answer.sentence
    assert not (tmp_path / "out").exists()


def test_options_of_a_parameter_file_need_one(run, bag, tmp_path):
    answer = run("estimate", bag, "--robot", "thing", "--filter", "ukf", "--out", tmp_path / "out")
    assert answer.code == 2
    assert "need parameters of robot_localization as --config" in answer.sentence


def test_without_either_a_robot_is_asked_for(run, bag, tmp_path):
    answer = run("estimate", bag, "--out", tmp_path / "out")
    assert answer.code == 2
    assert "Give --robot" in answer.sentence
