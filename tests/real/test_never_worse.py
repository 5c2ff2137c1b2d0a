"""The law on real logs: what is fused is never worse than the best of its inputs, by their own scores."""

import numpy as np
import pytest

from longreach.evaluation.relations import summary

RELATIONS = ("intel", "aces", "fr079", "csail")
TRUTH = {"brenner": "brenner", "polimi/bag1.bag": "polimi", "polimi/bag3.bag": "polimi"}


@pytest.fixture(params=RELATIONS)
def log(request, estimated):
    return estimated(f"{request.param}/{request.param}.clf.bz2", request.param)


def scores(result, name):
    """Mean errors over the relations that span up to 5 s [m, deg]."""
    found = summary(result.evaluation.relation_errors[name], 5.0)
    return np.array([found.translation.mean, np.degrees(found.rotation.mean)])


def test_the_fused_path_is_never_worse_than_the_best_input(log):
    best = np.minimum(scores(log, "wheels"), scores(log, "lidar"))
    assert np.all(scores(log, "fused") <= 1.02 * best + np.array([0.001, 0.02]))


def test_no_relation_of_a_few_seconds_is_far_off(log):
    errors = log.evaluation.relation_errors["fused"]
    short = errors.span <= 5.0
    assert errors.translation[short].max() <= 0.6
    assert np.degrees(errors.rotation[short].max()) <= 12.0


def test_lidar_alone_turns_much_less_wrong_than_the_wheels(log):
    assert scores(log, "lidar")[1] < 0.5 * scores(log, "wheels")[1]


def test_every_path_has_every_scan_as_recorded(log):
    recorded = log.recording.as_recorded(np.array([scan.stamp for scan in log.recording.scans]))
    for name in ("fused", "wheels", "lidar"):
        path = log.trajectories[name]
        np.testing.assert_array_equal(path.stamps, recorded)
        assert np.all(np.diff(path.clock) > 0)


def test_every_scan_is_matched(log):
    assert len(log.lidar_measurements) >= 0.999 * (len(log.recording.scans) - 1)
    assert not [c for c in log.corrections if c.status == "refused"]


@pytest.mark.parametrize("name", TRUTH)
def test_the_fused_path_is_never_worse_than_the_best_input_by_its_truth(estimated, name):
    result = estimated(name, TRUTH[name])
    errors = {path: metrics["ate_rmse"]["value"] for path, metrics in result.metrics.items()}
    assert errors.pop("fused") <= 1.02 * min(errors.values()) + 0.001
