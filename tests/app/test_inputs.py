"""What a command line names, read and checked."""

import numpy as np
import pytest

from longreach.app.inputs import open_run
from longreach.errors import ConfigError, LongreachError, RecordingError
from longreach.io.bag_writer import write_bag
from longreach.io.tum import write_tum
from longreach.trajectory import PoseTrajectory


@pytest.fixture(scope="module")
def bag(short, thing, tmp_path_factory):
    path = tmp_path_factory.mktemp("bags") / "run.mcap"
    write_bag(path, short, thing)
    return path


@pytest.fixture
def positions(tmp_path):
    """A metre forward in 2 s, ten times a second."""
    path = tmp_path / "positions.tum"
    stamps = np.linspace(0.0, 2.0, 21)
    write_tum(path, PoseTrajectory(stamps, np.column_stack([0.5 * stamps, np.zeros(21), np.full(21, 0.3)])))
    return path


def test_a_recording_and_a_robot_are_enough(bag):
    run = open_run(bag, "thing")
    assert (len(run.recording.wheels), len(run.recording.scans)) == (101, 21)
    assert (run.truth, run.relations) == (None, None)
    assert run.recording.truth is not None
    assert run.robot.name == "thing"


def test_settings_come_from_a_file_and_sources_from_the_line(bag, tmp_path):
    config = tmp_path / "c.yaml"
    config.write_text("{sources: [imu], lidar: {distance: 0.5}, filter: {gate_mode: none}}")
    run = open_run(bag, "thing", config=config, sources="wheels, lidar")
    assert run.config.sources == ("wheels", "lidar")
    assert run.config.lidar.distance == 0.5
    assert run.config.filter.gate_mode == "none"
    assert run.config.filter.model_fields_set == {"gate_mode"}  # the rest still comes from robot and recording


@pytest.mark.parametrize(
    ("sources", "sentence"),
    [
        ("wheels,sonar", "--sources: sources.1 is 'sonar': input should be 'wheels', 'lidar', 'imu' or 'fixes'"),
        ("", "--sources: sources is .*: .*at least 1 item"),
    ],
)
def test_sources_nobody_knows_are_refused_with_the_known_ones(bag, sources, sentence):
    with pytest.raises(ConfigError, match=sentence):
        open_run(bag, "thing", sources=sources)


def test_the_truth_is_a_file_or_else_a_topic(bag, positions):
    run = open_run(bag, "thing", truth=str(positions))
    assert len(run.truth) == 21
    assert open_run(bag, "thing", truth="/truth").recording.truth is not None
    with pytest.raises(RecordingError, match=r"has no topic /nowhere for truth; it has .*/front/scan"):
        open_run(bag, "thing", truth="/nowhere")
    with pytest.raises(ConfigError, match=r"nowhere\.tum is not there; the truth is a file or a topic"):
        open_run(bag, "thing", truth="nowhere.tum")


def test_fixes_are_thinned_and_know_no_heading(bag, positions):
    fixes = open_run(bag, "thing", fixes=positions, fix_sigma=0.1, fix_period=0.45).recording.fixes
    np.testing.assert_allclose([f.stamp for f in fixes], [0.0, 0.5, 1.0, 1.5, 2.0])
    np.testing.assert_allclose([f.pose[0] for f in fixes], [0.0, 0.25, 0.5, 0.75, 1.0])
    np.testing.assert_array_equal(fixes[0].covariance, np.diag([0.1**2, 0.1**2, np.inf]))
    assert len(open_run(bag, "thing", fixes=positions).recording.fixes) == 21


@pytest.mark.parametrize("sigma", [0.0, -1.0, float("nan"), float("inf")])
def test_a_deviation_that_is_none_is_refused(bag, positions, sigma):
    with pytest.raises(ConfigError, match=r"--fix-sigma is .*; a standard deviation is finite and larger than 0 m"):
        open_run(bag, "thing", fixes=positions, fix_sigma=sigma)


@pytest.mark.parametrize("period", [-1.0, float("nan"), float("inf")])
def test_a_period_that_is_none_is_refused(bag, positions, period):
    with pytest.raises(ConfigError, match=r"--fix-period is .*; a period is finite and not less than 0 s"):
        open_run(bag, "thing", fixes=positions, fix_period=period)


@pytest.mark.parametrize("name", ["config", "relations", "fixes"])
def test_files_that_are_not_there_are_said(bag, tmp_path, name):
    with pytest.raises(LongreachError, match=r"nowhere is not there"):
        open_run(bag, "thing", **{name: tmp_path / "nowhere"})


def test_what_is_wrong_with_the_small_files_is_said_before_the_recording_is_read(tmp_path):
    config = tmp_path / "c.yaml"
    config.write_text("filter: {histories: 1}")
    with pytest.raises(ConfigError, match=r"filter\.histories is not a key here"):
        open_run(tmp_path / "no.bag", "thing", config=config)
    with pytest.raises(ConfigError, match="neither a robot that longreach knows"):
        open_run(tmp_path / "no.bag", "wall-e")
    with pytest.raises(RecordingError, match=r"There is no recording at .*no\.bag"):
        open_run(tmp_path / "no.bag", "thing")
