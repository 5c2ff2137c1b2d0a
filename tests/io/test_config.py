"""YAML is checked against a model, and what is wrong with it is said by key, value and range."""

import pytest
import yaml

from longreach.app.configuration import EstimateConfig
from longreach.errors import ConfigError
from longreach.io.config import (
    description_file,
    load_description,
    read_config,
    shipped_descriptions,
    to_yaml,
    validated,
)
from longreach.robot.description import RobotDescription

SHIPPED = {"thing", "intel", "aces", "fr079", "csail", "polimi", "brenner", "husky"}


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "a.yaml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("lidar: {iterations: 0}", "lidar.iterations is 0: input should be greater than or equal to 1"),
        ("filter: {gate_probability: 2}", "filter.gate_probability is 2: input should be less than 1"),
        ("filter: {history: many}", "filter.history is 'many': input should be a valid number"),
        ("sources: [wheels, sonar]", "sources.1 is 'sonar': input should be 'wheels', 'lidar', 'imu' or 'fixes'"),
        (
            "colour: red",
            "colour is not a key here; there are: sources, wheels, lidar, filter, smooth, compare, evaluation",
        ),
        ("lidar: {level: 3}", "lidar.level is not a key here; there are: method, iterations, gate"),
        ("lidar: {iterations: 0, gate: -1, x: 1}", r"lidar.iterations is 0.*\(2 more keys are wrong.\)"),
        ("wheels: {twist_variance: [1, 2, -3]}", "wheels.twist_variance.2 is -3: input should be greater than 0"),
        ("- a\n- b", "expected keys and values, found list"),
        ("just words", "expected keys and values, found str 'just words'"),
        ("a: [1, 2", "line 1: this is not YAML"),
        ("a: 1\nb: : 2\n", "line 2: this is not YAML"),
        (b"\xff\xfe\x00", "cannot be read as text"),
    ],
)
def test_a_wrong_configuration_is_said_by_key_and_range(written, text, sentence):
    path = written(text)
    with pytest.raises(ConfigError, match=sentence) as caught:
        read_config(path, EstimateConfig)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith((".", ".)"))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("base: {kind: mecanum}", "name is missing"),
        ("{name: r, base: {kind: mecanum, wheel_radius: -1}}", "base.wheel_radius is -1"),
        (
            "{name: r, base: {kind: mecanum, wheel_radius: 1, half_length: 1, half_width: 1, axles: 2}}",
            "base.axles is not a key here; there are: .*half_width",
        ),
        ("{name: r, encoder: {signal: ticks}}", "an encoder whose signal is ticks needs counts_per_revolution"),
        ("{name: r, lidar: {range_max: .inf}}", "lidar.range_max is inf: input should be a finite number"),
    ],
)
def test_a_wrong_robot_is_said_by_key(written, text, sentence):
    with pytest.raises(ConfigError, match=sentence):
        load_description(written(text))


@pytest.mark.parametrize("text", ["", "# only a comment\n", "{}"])
def test_an_empty_file_changes_nothing(written, text):
    assert read_config(written(text), EstimateConfig) == EstimateConfig()


@pytest.mark.parametrize("changes", [{}, {"sources": ["lidar"], "lidar": {"distance": 0.5}, "filter": {"history": 1}}])
def test_a_configuration_written_down_and_read_again_is_the_same(written, changes):
    config = validated(EstimateConfig, changes, "changes")
    text = to_yaml(config)
    assert read_config(written(text), EstimateConfig) == config
    assert set(yaml.safe_load(text)) == set(EstimateConfig.model_fields)


def test_the_shipped_robots_are_read_by_name_and_come_back_from_their_yaml(written):
    assert set(shipped_descriptions()) >= SHIPPED
    for name in SHIPPED:
        robot = load_description(name)
        assert robot.name == name
        assert load_description(written(to_yaml(robot))) == robot


def test_an_unknown_robot_is_answered_with_the_known_ones(tmp_path):
    with pytest.raises(ConfigError, match="neither a robot that longreach knows") as caught:
        description_file("wall-e")
    assert all(name in str(caught.value) for name in SHIPPED)
    with pytest.raises(ConfigError, match="neither a robot"):
        load_description(tmp_path)


def test_a_file_that_is_not_there_is_said(tmp_path):
    with pytest.raises(ConfigError, match=r"a\.yaml is not there"):
        read_config(tmp_path / "a.yaml", RobotDescription)
