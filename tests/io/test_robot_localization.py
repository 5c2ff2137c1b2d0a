"""Parameter files of robot_localization: both layouts, every kind of key, and what is said of the rest."""

import numpy as np
import pytest
import yaml

from longreach.errors import ConfigError
from longreach.io.robot_localization import is_parameter_file, read_parameters
from longreach.spatial_settings import INITIAL_VARIANCE, PROCESS_NOISE

MASK = "[false, false, false, false, false, true, true, true, false, false, false, true, false, false, false]"
ALL = str([True] * 15).lower()
TINY = str([1e-9] * 15)
FLAT = f"frequency: 50\nodom0: /odom\nodom0_config: {MASK}\n"


@pytest.fixture
def read(tmp_path):
    def parameters(text, *arguments, name="params.yaml", **options):
        (tmp_path / name).write_text(text)
        return read_parameters(tmp_path / name, *arguments, **options)

    return parameters


def below(text, *names):
    for name in reversed(names):
        text = f"{name}:\n" + "".join(f"  {line}\n" for line in text.splitlines())
    return text


@pytest.mark.parametrize(
    ("names", "node"),
    [
        ((), "params"),
        (("ekf_node",), "ekf_node"),
        (("ekf_node", "ros__parameters"), "ekf_node"),
        (("robot", "ekf_node", "ros__parameters"), "ekf_node"),
        (("/**", "ros__parameters"), "any node"),
    ],
)
def test_every_layout_says_the_same(read, names, node):
    found = read(below(FLAT, *names))
    assert found.node == node
    s = found.settings
    assert (s.frequency, s.sensor_timeout, s.filter) == (50.0, 0.02, "ekf")
    (odom,) = s.sensors
    assert (odom.name, odom.kind, odom.topic) == ("odom0", "odom", "/odom")
    assert np.flatnonzero(odom.mask).tolist() == [5, 6, 7, 11]


def test_defaults_are_those_of_robot_localization(read):
    s = read(FLAT.replace("frequency: 50\n", "")).settings
    assert s.frequency == 30.0
    assert s.sensor_timeout == pytest.approx(1 / 30)
    assert (s.map_frame, s.odom_frame, s.base_frame, s.world_frame) == ("map", "odom", "base_link", "odom")
    np.testing.assert_array_equal(s.process_noise, np.diag(PROCESS_NOISE))
    np.testing.assert_array_equal(s.initial_covariance, INITIAL_VARIANCE * np.eye(15))
    assert (s.alpha, s.kappa, s.gravity, s.control) == (1e-3, 0.0, 9.80665, None)


def test_every_key_of_a_sensor_is_read(read):
    text = FLAT + (
        "odom0_differential: true\nodom0_pose_rejection_threshold: 5\nodom0_twist_rejection_threshold: 2.5\n"
        f"imu0: imu\nimu0_config: {ALL}\nimu0_relative: true\n"
        "imu0_angular_velocity_rejection_threshold: 3.0\nimu0_linear_acceleration_rejection_threshold: 0.8\n"
        "imu0_remove_gravitational_acceleration: true\n"
        f"pose0: pose\npose0_config: {MASK}\npose0_rejection_threshold: 2.0\n"
        f"twist0: twist\ntwist0_config: {MASK}\ntwist0_rejection_threshold: 4.0\n"
    )
    odom, imu, pose, twist = read(text).settings.sensors
    assert (odom.differential, odom.pose_gate, odom.twist_gate) == (True, 5.0, 2.5)
    assert (imu.relative, imu.twist_gate, imu.acceleration_gate, imu.remove_gravity) == (True, 3.0, 0.8, True)
    assert np.flatnonzero(imu.mask).tolist() == [3, 4, 5, 9, 10, 11, 12, 13, 14]
    assert (pose.pose_gate, twist.twist_gate) == (2.0, 4.0)
    assert np.flatnonzero(pose.mask).tolist() == [5]
    assert np.flatnonzero(twist.mask).tolist() == [6, 7, 11]


def test_covariances_come_in_225_or_15_numbers_and_as_yaml_writes_them(read):
    full = np.diag(np.arange(1.0, 16.0))
    full[0, 1] = full[1, 0] = 0.5
    text = f"process_noise_covariance: {full.ravel().tolist()}\ninitial_estimate_covariance: {TINY}\n"
    s = read(FLAT + text).settings
    np.testing.assert_array_equal(s.process_noise, full)
    np.testing.assert_array_equal(s.initial_covariance, 1e-9 * np.eye(15))


def test_history_and_control_are_read(read):
    text = FLAT + (
        "smooth_lagged_data: true\nhistory_length: 2.5\nuse_control: true\ncontrol_timeout: 0.3\n"
        "control_config: [true, false, false, false, false, true]\nacceleration_limits: [1.3, 0, 0, 0, 0, 3.4]\n"
    )
    s = read(text).settings
    assert s.history == 2.5
    assert s.control.mask == (True, False, False, False, False, True)
    assert s.control.limits == s.control.braking_limits == (1.3, 0, 0, 0, 0, 3.4)
    assert s.control.timeout == 0.3


def test_a_measured_acceleration_goes_before_the_control(read):
    text = f"imu0: imu\nimu0_config: {ALL}\nuse_control: true\ncontrol_config: {str([True] * 6).lower()}\n"
    assert read(text).settings.control.mask == (False, False, False, True, True, True)


@pytest.mark.parametrize(
    ("text", "name", "changes", "kind"),
    [
        (FLAT, "ekf.yaml", {}, "ekf"),
        (FLAT, "my_ukf.yaml", {}, "ukf"),
        (below(FLAT, "ukf_filter_node", "ros__parameters"), "p.yaml", {}, "ukf"),
        (FLAT + "filter: ukf\n", "ekf.yaml", {}, "ukf"),
        (FLAT, "my_ukf.yaml", {"filter": "ekf"}, "ekf"),
    ],
)
def test_the_filter_is_as_the_node_or_the_file_is_named_or_as_told(read, text, name, changes, kind):
    assert read(text, name=name, changes=changes).settings.filter == kind


def test_one_node_of_several_is_named(read):
    text = below(FLAT, "ekf_odom", "ros__parameters") + below(FLAT, "ekf_map", "ros__parameters")
    text += below("magnetic_declination: 0.1\n", "navsat_transform", "ros__parameters")
    with pytest.raises(ConfigError, match="several nodes; name one by --node: ekf_odom, ekf_map"):
        read(text)
    assert read(text, "ekf_map").node == "ekf_map"
    with pytest.raises(ConfigError, match="no node ekf_moon with sensors; there are: ekf_odom, ekf_map"):
        read(text, "ekf_moon")


def test_unknown_keys_are_named_and_idle_ones_said_to_be(read):
    text = (
        FLAT
        + "odom0_diferential: true\nfrequncy: 3\nodom7_config: [true]\nodom0_queue_size: 10\n"
        + "publish_tf: true\nalpha: 1\n"
    )
    said = " ".join(read(text).remarks)
    assert (
        "odom0_diferential is no key of robot_localization and was left out; did you mean odom0_differential?" in said
    )
    assert "frequncy is no key of robot_localization and was left out; did you mean frequency?" in said
    assert "odom7_config is no key" in said
    assert "Without effect here: odom0_queue_size, publish_tf, alpha." in said


def test_what_messages_do_not_hold_is_said(read):
    text = f"imu0: imu\nimu0_config: {ALL}\nodom0: o\nimu0_differential: true\nimu0_relative: true\n"
    said = read(text).remarks
    assert "imu0_config asks for x, y, z, vx, vy, vz, which messages of imu do not hold." in said
    assert "odom0 is not fused: odom0_config has no entry that is true." in said
    assert "imu0 is both differential and relative; it is taken differentially." in said


def test_as_robot_localization_a_documented_threshold_has_no_effect(read):
    text = f"imu0: imu\nimu0_config: {ALL}\nimu0_angular_velocity_rejection_threshold: 3.0\n"
    found = read(text, changes={"as_robot_localization": True})
    assert found.settings.sensors[0].twist_gate == np.inf
    assert "Without effect here: imu0_angular_velocity_rejection_threshold." in found.remarks


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("frequency: fast", "frequency is 'fast'; it takes a finite number above 0."),
        ("frequency: 0", "frequency is 0; it takes a finite number above 0."),
        ("two_d_mode: 2", "two_d_mode is 2; it takes true or false."),
        ("odom0_config: [true, false]", "odom0_config is [True, False]; it takes 15 entries, each true or false."),
        ("odom0_config: 5", "odom0_config is 5; it takes 15 entries, each true or false."),
        ("initial_state: [1, 2]", "initial_state is [1, 2]; it takes 15 finite numbers, not 2."),
        ("process_noise_covariance: [1, x]", "process_noise_covariance is [1, 'x']; it takes 225 or 15 finite numbers"),
        ("odom0_pose_rejection_threshold: -1", "odom0_pose_rejection_threshold is -1; it takes a number above 0."),
        ("filter: particle", "filter is 'particle'; it takes ekf or ukf."),
        ("odom0: 5", "odom0 is 5; it takes a name."),
        ("use_control: true", "control_config is missing; give 6 entries, true or false."),
        ("kappa: -15", "kappa is -15; it takes a finite number above -15."),
    ],
)
def test_a_wrong_value_is_named_with_what_the_key_takes(read, line, sentence):
    key = line.split(":")[0]
    text = "".join(f"{kept}\n" for kept in FLAT.splitlines() if not kept.startswith(f"{key}:"))
    with pytest.raises(ConfigError) as caught:
        read(f"{text}{line}\n")
    assert sentence in str(caught.value)
    assert "params.yaml" in str(caught.value)


@pytest.mark.parametrize("values", [[-1.0] + [1.0] * 14, np.tri(15).ravel().tolist()])
def test_a_matrix_that_is_no_covariance_is_refused(read, values):
    with pytest.raises(ConfigError, match="process_noise_covariance is no covariance; it must be symmetric"):
        read(FLAT + f"process_noise_covariance: {values}\n")


def test_a_file_without_anything_to_fuse_is_refused(read):
    with pytest.raises(ConfigError, match="no sensor has anything to fuse; set entries of odom0_config to true"):
        read("odom0: /odom\n")
    with pytest.raises(ConfigError, match="names no sensor"):
        read("frequency: 30\n")


@pytest.mark.parametrize(
    ("text", "is_one"),
    [(FLAT, True), (below(FLAT, "a", "ros__parameters"), True), ("wheels: {}\n", False), ("", False)],
)
def test_parameter_files_are_told_from_our_own(tmp_path, text, is_one):
    (tmp_path / "c.yaml").write_text(text)
    assert is_parameter_file(tmp_path / "c.yaml") is is_one


def test_values_that_ran_can_be_read_again(read):
    found = read(FLAT + "process_noise_covariance: [" + ", ".join(["0.1"] * 15) + "]\n", changes={"filter": "ukf"})
    again = read(yaml.safe_dump({"any": {"ros__parameters": dict(found.values)}}))
    assert again.settings.filter == "ukf"
    np.testing.assert_array_equal(again.settings.process_noise, found.settings.process_noise)
    assert again.settings.sensors == found.settings.sensors
