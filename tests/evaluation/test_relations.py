import numpy as np
import pytest

from longreach.evaluation.alignment import moved
from longreach.evaluation.relations import relation_errors, relation_metrics, summary, up_to
from longreach.geometry import se2
from longreach.trajectory import PoseTrajectory


@pytest.fixture
def relations(drive, rng):
    i, j = rng.integers(0, len(drive), size=(2, 100))
    return drive.stamps[i], drive.stamps[j], se2.between(drive.poses[i], drive.poses[j])


def test_a_trajectory_that_agrees_has_no_error_wherever_it_lies(drive, relations):
    for trajectory in (drive, moved(drive, np.array([5.0, 6.0, 1.0]))):
        errors = relation_errors(trajectory, *relations)
        assert (errors.used, errors.skipped) == (100, 0)
        np.testing.assert_allclose(errors.translation, 0, atol=1e-9)
        np.testing.assert_allclose(errors.rotation, 0, atol=1e-9)
        np.testing.assert_allclose(errors.span, np.abs(relations[1] - relations[0]))


def test_a_known_difference_is_found(drive, relations):
    off = np.array([0.3, -0.4, -0.1])
    errors = relation_errors(drive, relations[0], relations[1], se2.compose(relations[2], off))
    np.testing.assert_allclose(errors.translation, 0.5, atol=1e-9)
    np.testing.assert_allclose(errors.rotation, 0.1, atol=1e-9)


def test_relations_outside_or_in_a_long_gap_are_skipped_and_counted():
    stamps = np.array([0.0, 1.0, 2.0, 12.0, 13.0])
    trajectory = PoseTrajectory(stamps, np.zeros((5, 3)))
    first, second = np.array([0.0, 0.5, -1.0, 0.0]), np.array([1.5, 7.0, 1.0, 14.0])
    errors = relation_errors(trajectory, first, second, np.zeros((4, 3)))
    assert (errors.used, errors.skipped) == (1, 3)
    errors = relation_errors(trajectory, first, second, np.zeros((4, 3)), longest_gap=20.0)
    assert (errors.used, errors.skipped) == (2, 2)


def test_stamps_are_taken_as_recorded_where_they_run_backwards():
    recorded = np.array([0.0, 0.1, 0.2, 0.15, 0.25, 0.4, 0.5])
    poses = np.stack((np.arange(7.0), np.zeros(7), np.zeros(7)), axis=1)
    trajectory = PoseTrajectory(recorded, poses)
    errors = relation_errors(trajectory, recorded[[1, 2]], recorded[[3, 5]], poses[[3, 5]] - poses[[1, 2]])
    np.testing.assert_allclose(errors.translation, 0, atol=1e-12)


def test_the_summary_of_short_relations_leaves_out_the_long(drive, relations):
    errors = relation_errors(drive, relations[0], relations[1], np.zeros((100, 3)))
    short = summary(errors, 5.0)
    assert 0 < short.translation.count < 100
    assert short.translation.maximum < summary(errors).translation.maximum
    assert short.rotation.mean == np.mean(errors.rotation[errors.span <= 5.0])
    assert up_to(errors, 5.0).used == short.translation.count


def test_metrics_name_the_span_and_give_degrees(drive, relations):
    errors = relation_errors(drive, relations[0], relations[1], se2.compose(relations[2], np.array([0.1, 0.0, 0.1])))
    metrics = relation_metrics(errors) | relation_metrics(errors, 5.0)
    assert metrics["relations_used"]["value"] == 100
    assert metrics["relations_skipped"]["value"] == 0
    assert metrics["relations_5s_translation_mean"]["value"] == pytest.approx(0.1)
    assert metrics["relations_rotation_median"] == {"value": pytest.approx(np.degrees(0.1)), "unit": "deg"}


def test_an_empty_trajectory_skips_all():
    errors = relation_errors(PoseTrajectory(np.zeros(0), np.zeros((0, 3))), np.zeros(2), np.ones(2), np.zeros((2, 3)))
    assert (errors.used, errors.skipped) == (0, 2)
    assert relation_metrics(errors)["relations_translation_mean"]["value"] is None
