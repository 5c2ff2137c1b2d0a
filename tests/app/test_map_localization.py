"""A recording localised in a map, from Python: what is given, how good it is, and what does not go together."""

from dataclasses import replace

import numpy as np
import pytest

import longreach as lr
from longreach.app.map import build_map
from longreach.app.map_localization import Start, opened_file, parsed_start
from longreach.errors import MappingError
from longreach.geometry import se2
from longreach.mapping.map_file import load_map, save_map
from longreach.mapping.occupancy import render, write_map_server
from longreach.measurement import PoseMeasurement

SIGMAS = np.array([0.2, 0.2, 0.1])


@pytest.fixture(scope="module")
def mapped(made, thing):
    return build_map(made, thing)


@pytest.fixture(scope="module")
def start(mapped, made):
    """Where the base truly starts on the map."""
    assert mapped.T_truth_map is not None
    return Start(se2.compose(se2.inverse(mapped.T_truth_map), made.truth.poses[0]), SIGMAS)


@pytest.fixture(scope="module")
def on_map(made, thing, mapped, start):
    return lr.estimate(made, thing, map=mapped, start=start)


def test_localized_is_in_the_frame_of_the_map_with_a_row_a_scan(on_map, made, mapped):
    localized, truth = on_map.trajectories["localized"], made.truth
    assert len(localized) == len(made.scans)
    carried = se2.compose(np.broadcast_to(mapped.T_truth_map, localized.poses.shape), localized.poses)
    expected, known = truth.at(localized.clock)
    off = se2.difference(carried[known], expected[known])
    assert np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1))) < 0.008
    found = on_map.metrics["localized"]
    assert found["ate_rmse"]["value"] == pytest.approx(np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1))), rel=0.1)
    assert found["heading_rms"]["value"] < 0.2
    assert 0.0 < found["nees_mean"]["value"] < 4.5
    assert found["nis_map_mean"]["value"] > 0.0


def test_the_smooth_frame_does_not_know_of_the_map(on_map, estimated):
    np.testing.assert_array_equal(on_map.trajectories["fused"].poses, estimated.trajectories["fused"].poses)


def test_without_its_own_truth_a_map_leaves_the_run_to_its_best_motion_and_says_so(made, thing, mapped, start):
    found = lr.estimate(made, thing, map=replace(mapped, T_truth_map=None), start=start)
    assert found.metrics["localized"]["ate_rmse"]["value"] < 0.008
    assert any("its own best motion" in remark for remark in found.remarks)


def test_fixes_are_left_out_where_there_is_a_map(made, thing, mapped, start, on_map):
    fix = PoseMeasurement(2.0, np.array([50.0, 0.0, 0.0]), 1e-4 * np.eye(3), source="fixes")
    found = lr.estimate(made.replace(fixes=(fix,)), thing, map=mapped, start=start)
    np.testing.assert_array_equal(found.trajectories["localized"].poses, on_map.trajectories["localized"].poses)
    assert any("fixes" in remark for remark in found.remarks)


def test_the_motion_to_the_truth_is_kept_in_the_file(mapped, tmp_path):
    save_map(tmp_path / "map.lrmap", mapped)
    np.testing.assert_array_equal(load_map(tmp_path / "map.lrmap").T_truth_map, mapped.T_truth_map)


def test_a_start_that_is_far_off_says_where_the_map_is(made, thing, mapped):
    with pytest.raises(MappingError, match="which goes from"):
        lr.estimate(made, thing, map=mapped, start=Start(np.array([400.0, 0.0, 0.0]), SIGMAS))


def test_a_map_of_another_robot_or_scanner_is_refused_by_name(made, thing, mapped, start):
    with pytest.raises(MappingError, match="The map is of thing, and the recording of other"):
        lr.estimate(made, thing.model_copy(update={"name": "other"}), map=mapped, start=start)
    scans = tuple(replace(scan, ranges=scan.ranges[:90]) for scan in made.scans)
    with pytest.raises(MappingError, match="a scanner of 181 beams"):
        lr.estimate(made.replace(scans=scans), thing, map=mapped, start=start)
    with pytest.raises(MappingError, match="has no scans"):
        lr.estimate(made.replace(scans=()), thing, map=mapped, start=start)


@pytest.mark.parametrize("text", ["", "1,2", "1,2,x", "1,2,nan", "1,2,3,0,1,1", "1,2,3,4,5", "1,2,3,-1,1,1", "here"])
def test_a_start_that_is_none_is_refused(text):
    with pytest.raises(MappingError, match="x,y,theta"):
        parsed_start(text)


def test_deviations_of_a_start_lie_along_the_axes_of_the_map():
    start = parsed_start("1,2,1.5707963267948966,0.3,0.1,0.2")
    assert start is not None
    np.testing.assert_allclose(start.covariance, np.diag([0.01, 0.09, 0.04]), atol=1e-12)
    assert parsed_start("global") is None
    np.testing.assert_array_equal(parsed_start("1,2,3").sigmas, [0.5, 0.5, 0.26])


def test_a_map_file_a_start_and_fixes_must_go_together(mapped, tmp_path):
    save_map(tmp_path / "map.lrmap", mapped)
    assert opened_file(None, None) == {}
    with pytest.raises(MappingError, match="give --map as well"):
        opened_file(None, "0,0,0")
    with pytest.raises(MappingError, match="give --map or --fixes"):
        opened_file(tmp_path / "map.lrmap", None, tmp_path)
    with pytest.raises(MappingError, match="is not there"):
        opened_file(tmp_path / "nothing.lrmap", None)


def test_without_a_start_the_base_is_searched_for_on_the_whole_map(made, thing, mapped, on_map):
    found = lr.estimate(made, thing, map=mapped)
    assert len(found.trajectories["localized"]) == len(made.scans)
    assert found.metrics["localized"]["ate_rmse"]["value"] < 0.008


def test_scans_of_another_room_are_not_localised_and_it_is_said(made, thing, mapped, rng):
    ranges = 1.0 + 4.0 * np.cos(7.0 * made.scans[0].angles) ** 2
    scans = tuple(replace(scan, ranges=ranges + 0.01 * rng.standard_normal(len(ranges))) for scan in made.scans)
    found = lr.estimate(made.replace(scans=scans), thing, map=mapped)
    assert "localized" not in found.trajectories
    assert any("nothing is localized" in remark for remark in found.remarks)


def test_a_map_server_s_map_serves_to_localise_in_by_its_yaml(made, thing, mapped, start, tmp_path):
    write_map_server(tmp_path / "room.pgm", render(mapped))
    given = opened_file(tmp_path / "room.yaml", f"{start.pose[0]},{start.pose[1]},{start.pose[2]},0.2,0.2,0.1")
    found = lr.estimate(made, thing, **given)
    assert found.metrics["localized"]["ate_rmse"]["value"] < 0.02
    assert found.metrics["localized"]["lost"]["value"] == 0.0
    with pytest.raises(MappingError, match="is not there"):
        opened_file(tmp_path / "nothing.yaml", None)


def test_a_base_that_is_lost_is_said_to_be_with_its_times(made, thing, mapped, start):
    wrong = Start(start.pose + np.array([1.0, 0.8, 2.0]), np.array([0.05, 0.05, 0.02]))
    found = lr.estimate(made, thing, map=mapped, start=wrong)
    said = [remark for remark in found.remarks if "the base is lost" in remark or "found again" in remark]
    assert len(said) == 2
    assert found.metrics["localized"]["lost"]["value"] < 5.0
