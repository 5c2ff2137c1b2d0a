"""Two roads, one answer: our errors and those of evo, on the same pairs."""

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.core.metrics import PoseRelation
from evo.core.trajectory import PoseTrajectory3D
from evo.core.units import Unit

from longreach.evaluation.alignment import associate
from longreach.evaluation.metrics import ate, rpe_over_distance, rpe_over_time
from longreach.evaluation.statistics import statistics

PARTS = {"translation": PoseRelation.translation_part, "rotation": PoseRelation.rotation_angle_rad}


def as_evo(clock, poses):
    n = len(clock)
    half = poses[:, 2] / 2
    xyz = np.column_stack((poses[:, :2], np.zeros(n)))
    wxyz = np.column_stack((np.cos(half), np.zeros(n), np.zeros(n), np.sin(half)))
    return PoseTrajectory3D(xyz, wxyz, timestamps=clock)


@pytest.fixture
def pairs(drive, disturb):
    return associate(disturb(drive), drive)


@pytest.fixture
def theirs(pairs):
    return sync.associate_trajectories(as_evo(pairs.clock, pairs.truth), as_evo(pairs.clock, pairs.estimate))


def errors_of(metric, theirs):
    metric.process_data(theirs)
    return metric, np.asarray(metric.error)


def assert_same_statistics(errors, metric):
    ours = statistics(errors)
    for name, value in metric.get_all_statistics().items():
        name = {"max": "maximum"}.get(name, name)
        if hasattr(ours, name):
            assert getattr(ours, name) == pytest.approx(value, abs=1e-9)


@pytest.mark.parametrize("align", ["rigid", "none"])
def test_absolute_errors_are_evos(pairs, theirs, align):
    truth, estimate = theirs
    if align == "rigid":
        estimate.align(truth, correct_scale=False)
    ours = ate(pairs, align)
    assert ours.heading is not None
    for errors, relation in ((ours.position, PARTS["translation"]), (np.abs(ours.heading), PARTS["rotation"])):
        metric, values = errors_of(metrics.APE(relation), (truth, estimate))
        np.testing.assert_allclose(errors, values, atol=1e-9)
        assert_same_statistics(errors, metric)


@pytest.mark.parametrize("all_pairs", [True, False])
@pytest.mark.parametrize("length", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("part", PARTS)
def test_relative_errors_over_distance_are_evos(pairs, theirs, all_pairs, length, part):
    rpe = metrics.RPE(PARTS[part], length, Unit.meters, 0.1, all_pairs, pairs_from_reference=True)
    metric, values = errors_of(rpe, theirs)
    ours = getattr(rpe_over_distance(pairs, [length], 0.1, all_pairs)[length], part)
    np.testing.assert_allclose(ours, values, atol=1e-9)
    assert_same_statistics(ours, metric)


@pytest.mark.parametrize("all_pairs", [True, False])
@pytest.mark.parametrize("frames", [1, 7, 50])
@pytest.mark.parametrize("part", PARTS)
def test_relative_errors_over_time_are_evos_over_frames(pairs, theirs, all_pairs, frames, part):
    metric, values = errors_of(metrics.RPE(PARTS[part], frames, Unit.frames, 0.1, all_pairs), theirs)
    span = 0.1 * frames
    ours = getattr(rpe_over_time(pairs, [span], 1e-6, all_pairs)[span], part)
    np.testing.assert_allclose(ours, values, atol=1e-9)
    assert_same_statistics(ours, metric)
