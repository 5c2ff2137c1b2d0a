"""Controllers by name, their settings as YAML, and the double of a robot driven through the whole chain."""

from dataclasses import replace

import numpy as np
import pytest
from control.recorded import NAMES, PERIOD, RecordedHardware, readings
from pydantic import BaseModel, ValidationError

from longreach.control import joint_trajectory, safety
from longreach.control.controllers import CONTROLLERS, ControllerConfig, controller
from longreach.control.hardware import Command, Hardware, Readings
from longreach.control.interpolation import timed_points
from longreach.control.joint_trajectory import JointInput, JointTrajectoryConfig
from longreach.control.safety_checks import Health
from longreach.control.safety_config import SafetyConfig, limits_of
from longreach.errors import ControlError
from longreach.io.config import read_config, to_yaml, validated
from longreach.measurement import Wrench


class Settings(BaseModel):
    controllers: dict[str, ControllerConfig]


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_controller_is_found_by_the_name_that_its_settings_bear(name):
    found = controller(name)
    config = found.config()
    assert config.kind == name
    assert found.init(config, 1.5) is not None


def test_an_unknown_controller_is_refused_with_those_there_are():
    with pytest.raises(ControlError, match="no controller foo; choose one of joint_trajectory, base_velocity, gripper"):
        controller("foo")


def test_settings_are_chosen_by_their_kind_and_survive_yaml(tmp_path):
    values = {
        "arm": {"kind": "joint_trajectory", "goal_tolerance": [0.002], "gains": {"p": [3.0], "output_limit": [0.5]}},
        "base": {"kind": "base_velocity", "acceleration": [1.0, 1.0, 0.5]},
    }
    settings = validated(Settings, {"controllers": values}, "here")
    assert settings.controllers["arm"].gains.p == (3.0,)
    assert settings.controllers["base"].acceleration == (1.0, 1.0, 0.5)
    (tmp_path / "control.yaml").write_text(to_yaml(settings))
    assert read_config(tmp_path / "control.yaml", Settings) == settings


def test_the_gates_settings_survive_yaml(tmp_path, capabilities):
    config = limits_of(capabilities, SafetyConfig(force_limit=50.0))
    (tmp_path / "safety.yaml").write_text(to_yaml(config))
    assert read_config(tmp_path / "safety.yaml", SafetyConfig) == config


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"lower": (0.0,)}, "lower has 1 numbers for 2 joints"),
        ({"lower": (0.0, 5.0)}, "every lower limit must be below its upper one"),
        ({"velocity": (1.0, np.inf)}, "finite number"),
        ({"acceleration": (1.0, 0.0)}, "greater than 0"),
    ],
)
def test_limits_that_are_none_are_refused(capabilities, values, message):
    arm = limits_of(capabilities).arm.model_dump()
    with pytest.raises(ValidationError, match=message):
        SafetyConfig.model_validate({"arm": {**arm, **values}})


def test_a_robot_that_does_not_say_how_hard_it_accelerates_is_refused(capabilities):
    limits = replace(capabilities.arm_limits, acceleration=np.array([1.0, np.inf]))
    with pytest.raises(ControlError, match=r"elbow may move at 3 rad/s and inf rad/s²; give the robot's description"):
        limits_of(replace(capabilities, arm_limits=limits))


def test_limits_of_ones_own_are_kept(capabilities):
    own = limits_of(capabilities).model_copy(update={"base": None})
    assert limits_of(capabilities, own).arm is own.arm
    assert limits_of(capabilities, own).base.velocity == (1.1, 1.1, 2.0)


def test_a_double_of_a_robot_is_driven_from_reading_to_writing(capabilities):
    robot: Hardware = RecordedHardware(capabilities, [readings(k * PERIOD) for k in range(1, 40)])
    gate = safety.init(limits_of(robot.capabilities, SafetyConfig(stale_after={"joints": 0.1})), 0.0)
    goal = timed_points(np.array([0.0, 0.3]), np.array([[0.0, 0.0], [0.05, 0.02]]), joint_names=NAMES)
    state = joint_trajectory.follow(joint_trajectory.init(JointTrajectoryConfig(), 0.0), goal)
    for _ in range(39):
        came = robot.read()
        state, out = joint_trajectory.step(state, JointInput(came.joints[-1].position, np.zeros(2)), came.stamp)
        gate, safe = safety.step(gate, Command(came.stamp, out.arm, out.mode), came, Health(), came.stamp)
        robot.write(safe)
    assert len(robot.written) == 39
    assert robot.written[10].arm[0] > 0.0
    robot.stop("the test is over")
    robot.write(safe)
    assert len(robot.written) == 39
    assert robot.stopped == "the test is over"


def test_commands_and_wrenches_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        Command(0.0, np.zeros(2)).arm[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        Wrench(0.0, np.zeros(3), np.zeros(3)).force[0] = 1.0
    assert Readings(0.0).emergency_stop is False
