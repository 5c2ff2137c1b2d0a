"""How good trajectories are said to be."""

import numpy as np
import pytest

from longreach.app.configuration import EvaluationConfig
from longreach.app.evaluate import Relations, evaluate, evaluate_files, innovations, match_consistency
from longreach.errors import LongreachError
from longreach.estimation.planar.state import Correction
from longreach.geometry import se2
from longreach.io.tum import write_tum
from longreach.measurement import RelativePoseMeasurement
from longreach.trajectory import PoseTrajectory


@pytest.fixture
def truth():
    stamps = np.linspace(0.0, 20.0, 401)
    return PoseTrajectory(stamps, se2.exp(np.outer(stamps, [0.5, 0.1, 0.2])))


def shifted(trajectory, motion):
    return PoseTrajectory(trajectory.stamps, se2.compose(np.array(motion), trajectory.poses))


def values(evaluation, name):
    return {metric: one["value"] for metric, one in evaluation.metrics[name].items()}


def silent(stage, fraction):
    pass


def test_without_a_reference_only_the_length_is_known(truth):
    found = evaluate({"fused": truth})
    assert list(found.metrics["fused"]) == ["path_length"]
    assert found.metrics["fused"]["path_length"]["value"] == pytest.approx(20 * np.hypot(0.5, 0.1), rel=1e-4)
    assert set(found.trajectories) == {"fused"}


def test_a_rigidly_moved_path_has_no_error_when_aligned_and_its_offset_when_not(truth):
    moved = {"fused": shifted(truth, [3.0, 4.0, 0.0])}
    for align, wanted in (("rigid", 0.0), ("first", 0.0), ("none", 5.0)):
        found = values(evaluate(moved, truth, config=EvaluationConfig(align=align)), "fused")
        assert found["ate_rmse"] == pytest.approx(wanted, abs=1e-9)
        assert found["final_position_error"] == pytest.approx(wanted, abs=1e-6)
    assert found["rpe_1s_translation_mean"] == pytest.approx(0.0, abs=1e-9)


def test_a_trajectory_of_one_row_is_not_judged(truth):
    one = PoseTrajectory(truth.stamps[:1], truth.poses[:1])
    assert set(evaluate({"fused": truth, "wheels": one}, truth).metrics) == {"fused"}


def test_jumps_of_the_reference_are_left_out_and_said(truth):
    poses = truth.poses.copy()
    poses[200, 0] += 5.0
    found = evaluate({"fused": truth}, PoseTrajectory(truth.stamps, poses))
    assert values(found, "fused")["ate_rmse"] < 1e-6
    assert found.remarks == (
        "1 of 401 rows of the reference jump faster than 3 m/s; they were left out of the comparison.",
    )


def test_relations_of_another_recording_are_refused(truth):
    relations = Relations(np.array([1e6]), np.array([1e6 + 1]), np.zeros((1, 3)))
    with pytest.raises(LongreachError, match="No relation has both stamps within the trajectories"):
        evaluate({"fused": truth}, relations=relations)


def test_a_truth_of_another_time_is_refused(truth):
    other = PoseTrajectory(truth.stamps + 1e6, truth.poses)
    with pytest.raises(LongreachError, match="have no time in common; give both on one clock"):
        evaluate({"fused": truth}, other)


def test_there_must_be_something_to_compare_with(tmp_path, truth):
    write_tum(tmp_path / "mine.tum", truth)
    with pytest.raises(LongreachError, match=r"nothing to compare .*mine.tum with; give --truth or --relations"):
        evaluate_files(tmp_path / "mine.tum", None, None, silent)


@pytest.mark.parametrize("names", [(), ("truth",), ("tool",)])
def test_a_folder_without_trajectories_is_refused(tmp_path, truth, names):
    for name in names:
        write_tum(tmp_path / f"{name}.tum", truth)
    with pytest.raises(LongreachError, match=r"holds no trajectories \(\*\.tum\)"):
        evaluate_files(tmp_path, None, None, silent)


def test_covariances_of_another_length_are_not_taken(tmp_path, truth):
    write_tum(tmp_path / "fused.tum", truth)
    write_tum(tmp_path / "truth.tum", truth)
    np.savez(tmp_path / "covariance.npz", fused_covariance=np.tile(np.eye(3), (7, 1, 1)))
    assert "nees_mean" not in values(evaluate_files(tmp_path, None, None, silent), "fused")
    np.savez(tmp_path / "covariance.npz", fused_covariance=np.tile(np.eye(3), (401, 1, 1)))
    assert "nees_mean" in values(evaluate_files(tmp_path, None, None, silent), "fused")


def test_innovations_are_sorted_by_source():
    corrections = [Correction(float(t), "ab"[t % 2], "used", nis=float(t), dof=3) for t in range(6)]
    corrections.append(Correction(6.0, "a", "used"))  # an anchor
    found = innovations(corrections)
    np.testing.assert_array_equal(found["a"].values, [0.0, 2.0, 4.0])
    np.testing.assert_array_equal(found["b"].values, [1.0, 3.0, 5.0])


def test_matches_outside_the_truth_are_skipped(truth):
    def match(a, b):
        return RelativePoseMeasurement(a, b, se2.exp(np.array([0.5, 0.1, 0.2]) * (b - a)), 1e-4 * np.eye(3))

    found = match_consistency([match(0.0, 1.0), match(5.0, 6.0), match(19.5, 20.5)], truth)
    assert (len(found.values), found.skipped) == (2, 1)
    np.testing.assert_allclose(found.values, 0.0, atol=1e-9)
