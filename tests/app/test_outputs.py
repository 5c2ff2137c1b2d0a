"""What a run leaves behind."""

import json

import numpy as np
import pytest

from longreach.app import results
from longreach.app.configuration import EstimateConfig
from longreach.app.estimate import estimate
from longreach.app.evaluate import Relations, evaluate_files
from longreach.app.outputs import write_estimate, write_evaluation
from longreach.geometry import se2
from longreach.io.config import load_description, read_config
from longreach.io.tum import read_tum, write_tum
from longreach.trajectory import PoseTrajectory


def silent(stage, fraction):
    pass


@pytest.fixture
def quick_pictures(monkeypatch):
    """Figures are made, but not painted."""
    monkeypatch.setattr(results.style, "png", lambda figure: b"picture")


def assert_is_metrics(path):
    """Strict JSON, name → metric → value and unit."""
    metrics = json.loads(path.read_text(encoding="utf-8"), parse_constant=pytest.fail)
    for named in metrics.values():
        for one in named.values():
            assert set(one) == {"value", "unit"}
            assert one["value"] is None or isinstance(one["value"], int | float)
            assert isinstance(one["unit"], str)
    return metrics


def estimate_metrics(evaluation, name):
    return {metric: one["value"] for metric, one in evaluation.metrics[name].items()}


@pytest.fixture(scope="module")
def folder(estimated, tmp_path_factory):
    out = tmp_path_factory.mktemp("outputs") / "run"
    write_estimate(estimated, out)
    return out


def test_every_file_of_a_run_is_there(folder):
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert files >= {
        "fused.tum",
        "wheels.tum",
        "lidar.tum",
        "truth.tum",
        "covariance.npz",
        "lidar_matches.npz",
        "metrics.json",
        "config.yaml",
        "robot.yaml",
        "report.html",
        "figures/paths.png",
        "figures/squared_errors.png",
        "figures/error_bounds.png",
        "figures/innovation.png",
        "figures/scan_map.png",
    }
    assert not [path for path in folder.parent.iterdir() if path != folder]


def test_the_trajectories_and_their_covariances_come_back(folder, estimated):
    with np.load(folder / "covariance.npz") as arrays:
        for name in ("fused", "wheels", "lidar"):
            path = estimated.trajectories[name]
            found = read_tum(folder / f"{name}.tum")
            np.testing.assert_allclose(found.stamps, path.stamps, atol=1e-9)
            np.testing.assert_allclose(se2.difference(path.poses, found.poses), 0.0, atol=2e-9)
            np.testing.assert_array_equal(arrays[f"{name}_covariance"], path.covariance)
            np.testing.assert_array_equal(arrays[f"{name}_stamps"], path.stamps)


def test_the_matches_come_back(folder, estimated):
    with np.load(folder / "lidar_matches.npz") as arrays:
        measured = estimated.lidar_measurements
        np.testing.assert_array_equal(arrays["stamp"], [m.stamp for m in measured])
        np.testing.assert_array_equal(arrays["stamp_keyframe"], [m.stamp_reference for m in measured])
        np.testing.assert_array_equal(arrays["relative"], [m.pose for m in measured])
        assert arrays["covariance"].shape == (len(measured), 3, 3)
        assert not arrays["degenerate"].any()


def test_the_metrics_are_strict_json_with_units(folder, estimated):
    metrics = assert_is_metrics(folder / "metrics.json")
    assert set(metrics) == {"fused", "wheels", "lidar"}
    assert metrics["fused"]["ate_rmse"] == {"value": estimated.metrics["fused"]["ate_rmse"]["value"], "unit": "m"}


def test_the_settings_that_ran_give_the_same_run_again(folder, estimated, made):
    config = read_config(folder / "config.yaml", EstimateConfig)
    robot = load_description(folder / "robot.yaml")
    assert robot == estimated.robot
    assert config == estimated.config
    assert (config.sources, config.evaluation.align) == (None, "none")
    assert config.filter.acceleration_deviation != EstimateConfig().filter.acceleration_deviation  # the robot's own
    again = estimate(made, robot, config)
    np.testing.assert_array_equal(again.trajectories["fused"].poses, estimated.trajectories["fused"].poses)


def test_the_report_is_one_page_that_needs_nothing_else(folder):
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "Estimate of made-1" in page
    assert "data:image/png;base64," in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert 'src="figures' not in page


@pytest.mark.usefixtures("quick_pictures")
def test_writing_again_replaces_the_files_and_keeps_others(folder, estimated):
    (folder / "mine.txt").write_text("mine")
    (folder / "metrics.json").write_text("old")
    write_estimate(estimated, folder)
    assert_is_metrics(folder / "metrics.json")
    assert (folder / "mine.txt").read_text() == "mine"


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_failure_while_writing_leaves_nothing(tmp_path, estimated, monkeypatch, error):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(results.style, "png", fail)
    with pytest.raises(error):
        write_estimate(estimated, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("quick_pictures")
def test_an_estimate_without_truth_scans_and_matches_is_written(tmp_path, short, thing):
    bare = estimate(short.replace(truth=None, scans=(), imu=()), thing)
    write_estimate(bare, tmp_path / "out")
    files = {path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.*")}
    assert {"fused.tum", "wheels.tum", "metrics.json", "report.html", "figures/paths.png"} <= files
    assert not files & {"truth.tum", "lidar.tum", "lidar_matches.npz", "figures/scan_map.png"}
    assert_is_metrics(tmp_path / "out" / "metrics.json")


@pytest.mark.usefixtures("quick_pictures")
def test_an_estimate_with_positions_alone_as_truth_is_written(tmp_path, short, thing):
    poses = short.truth.poses * np.array([1.0, 1.0, 0.0])
    truth = PoseTrajectory(short.truth.stamps, poses, has_heading=False)
    write_estimate(estimate(short, thing, truth=truth), tmp_path / "out")
    metrics = assert_is_metrics(tmp_path / "out" / "metrics.json")
    assert "ate_rmse" in metrics["fused"]
    assert "heading_mse" not in metrics["fused"]
    assert not read_tum(tmp_path / "out" / "truth.tum").has_heading


@pytest.mark.usefixtures("quick_pictures")
def test_relations_are_drawn(tmp_path, short, thing):
    stamps = np.array([0.0, 0.5]), np.array([1.0, 1.5])
    relations = Relations(*stamps, se2.between(short.truth.at(stamps[0])[0], short.truth.at(stamps[1])[0]))
    write_estimate(estimate(short, thing, relations=relations), tmp_path / "out")
    assert (tmp_path / "out" / "figures" / "relations.png").is_file()
    assert assert_is_metrics(tmp_path / "out" / "metrics.json")["fused"]["relations_5s_used"]["value"] == 2


@pytest.mark.usefixtures("quick_pictures")
def test_the_folder_of_an_estimate_is_evaluated_against_its_own_truth(folder, tmp_path, estimated):
    again = evaluate_files(folder, None, None, silent)
    assert list(again.trajectories) == ["fused", "wheels", "lidar", "truth"]
    rigid = estimate_metrics(again, "fused")
    assert rigid["ate_rmse"] <= estimated.metrics["fused"]["ate_rmse"]["value"]
    assert "nees_mean" in rigid  # the covariances were read as well
    write_evaluation(again, tmp_path / "out")
    assert_is_metrics(tmp_path / "out" / "metrics.json")
    assert (tmp_path / "out" / "figures" / "squared_errors.png").is_file()


def test_a_tum_file_alone_is_evaluated(tmp_path, made):
    write_tum(tmp_path / "mine.tum", made.truth)
    found = evaluate_files(tmp_path / "mine.tum", tmp_path / "mine.tum", None, silent)
    assert estimate_metrics(found, "mine")["ate_rmse"] == pytest.approx(0.0, abs=1e-9)
