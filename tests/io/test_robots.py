"""Robots from files: the shipped ones, calibrated copies, bare URDFs, and files that are wrong."""

import numpy as np
import pytest
import yaml

import longreach as lr
from longreach.errors import ConfigError, ModelError
from longreach.io.config import load_description, shipped_descriptions
from longreach.io.robots import load_robot

LINK = '<robot name="post"><link name="foot"/><link name="top"/>{}</robot>'
JOINT = '<joint name="j" type="{}"><parent link="foot"/><child link="top"/><axis xyz="0 0 1"/></joint>'


@pytest.mark.parametrize("name", shipped_descriptions())
def test_every_shipped_robot_loads_with_its_description(name):
    robot = lr.load_robot(name)
    assert robot.name == name
    assert robot.description == load_description(name)
    assert robot.forward(np.zeros(robot.dof)).shape == (4, 4)
    assert robot.dof >= 3


def test_calibrated_parameters_are_loaded_from_a_description(tmp_path):
    values = yaml.safe_load(yaml.safe_dump(load_description("ur10").model_dump(mode="json")))
    rows = values["arm"]["dh"]
    lengths = [(0.12826, 0.0), (0.0, -0.61276), (0.0, -0.57167), (0.16343, 0.0), (0.11568, 0.0), (0.09205, 0.0)]
    for row, (d, a) in zip(rows, lengths, strict=True):
        row["d"], row["a"] = d, a
    values["frames"] = {"pen": {"parent": "flange", "z": 0.1}}
    values["tool"] = "pen"
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(values))
    mine, nominal = load_robot(tmp_path / "mine.yaml"), load_robot("ur10")
    np.testing.assert_allclose(mine.frame("flange", np.zeros(6))[0, 3], -0.61276 - 0.57167, atol=1e-15)
    apart = np.linalg.norm(mine.frame("flange", np.zeros(6))[:3, 3] - nominal.forward(np.zeros(6))[:3, 3])
    assert 1e-4 < apart < 5e-3
    beyond = np.linalg.inv(mine.frame("flange", np.zeros(6))) @ mine.forward(np.zeros(6))
    np.testing.assert_allclose(beyond[:3, 3], [0.0, 0.0, 0.1], atol=1e-12)


def test_a_table_on_a_base_that_drives_starts_at_base_link(tmp_path):
    rows = [{"d": 0.5, "joint": "fixed", "frame": "mount"}, {"a": 0.3, "lower": -1.0, "upper": 1.0}]
    (tmp_path / "r.yaml").write_text(yaml.safe_dump({"name": "r", "drive": "differential", "arm": {"dh": rows}}))
    robot = load_robot(tmp_path / "r.yaml")
    np.testing.assert_allclose(robot.forward(np.array([1.0, 2.0, np.pi / 2, 0.0]))[:3, 3], [1.0, 2.3, 0.5], atol=1e-15)
    assert robot.upper[3] == 1.0


def test_a_bare_urdf_is_an_arm_bolted_down(tmp_path):
    (tmp_path / "post.urdf").write_text(LINK.format(JOINT.format("continuous")))
    robot = load_robot(tmp_path / "post.urdf")
    assert (robot.name, robot.dof, robot.tool, robot.base) == ("post", 1, "top", slice(0, 0))


def test_files_that_are_not_there_or_wrong_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"neither a robot that longreach knows \(.*panda_cart.*thing, ur10\)"):
        load_robot("nothing")
    with pytest.raises(ModelError, match=r"nothing\.urdf cannot be read"):
        load_robot(tmp_path / "nothing.urdf")
    (tmp_path / "post.urdf").write_text(LINK.format(JOINT.format("screw")))
    with pytest.raises(ModelError, match=r"post\.urdf: Joint j: It is of the type 'screw'"):
        load_robot(tmp_path / "post.urdf")
    (tmp_path / "r.yaml").write_text(yaml.safe_dump({"name": "r", "arm": {"urdf": "gone.urdf"}}))
    with pytest.raises(ModelError, match=r"gone\.urdf cannot be read"):
        load_robot(tmp_path / "r.yaml")
    (tmp_path / "r.yaml").write_text(yaml.safe_dump({"name": "r", "arm": {"dh": [{"lower": 2.0, "upper": 1.0}]}}))
    with pytest.raises(ModelError, match="lower limit 2 is not below its upper limit 1"):
        load_robot(tmp_path / "r.yaml")
    (tmp_path / "r.yaml").write_text(yaml.safe_dump({"name": "r", "tool": "pen"}))
    with pytest.raises(ModelError, match=r"no frame 'pen'; there are world, .*base_link"):
        load_robot(tmp_path / "r.yaml")
    (tmp_path / "r.yaml").write_text(
        yaml.safe_dump({"name": "r", "arm": {"dh": [{"d": 1.0}], "accelerations": [1.0] * 5}})
    )
    with pytest.raises(ModelError, match="5 accelerations for 4 joints"):
        load_robot(tmp_path / "r.yaml")
