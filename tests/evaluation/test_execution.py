"""What an executed motion is worth, on motions whose worth is known."""

from dataclasses import replace

import numpy as np
import pytest

from longreach.evaluation.execution import Traces, correlation, straightness, tool_metrics
from longreach.evaluation.execution_figures import tool_and_base, tool_errors


@pytest.fixture
def traces():
    n = 50
    t = np.linspace(0.0, 5.0, n)
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, 0, 3] = 0.4 * t
    base = np.column_stack([0.4 * t, np.zeros(n), np.zeros(n)])
    small = np.tile(1e-6 * np.eye(6), (n, 1, 1))
    return Traces(t, T, T, T, base, base, base, small, small[:, :3, :3])


def _moved(T, dx=0.0, dy=0.0, dz=0.0):
    T = T.copy()
    T[:, :3, 3] += [dx, dy, dz]
    return T


def test_a_perfect_run_has_no_errors(traces):
    found = tool_metrics(traces)
    assert found["tool_error"]["value"] == 0.0
    assert found["tool_straightness"]["value"] < 1e-12


def test_each_error_is_told_apart(traces):
    truth = _moved(traces.tool_truth, dy=0.03, dz=0.004)
    found = tool_metrics(replace(traces, tool_truth=truth, tool_estimate=_moved(traces.tool_estimate, dy=0.01)))
    assert found["tool_error"]["value"] == pytest.approx(np.hypot(0.03, 0.004))
    assert found["tool_tracking_error"]["value"] == pytest.approx(0.01)
    assert found["tool_estimate_error"]["value"] == pytest.approx(np.hypot(0.02, 0.004))
    assert found["tool_height_error_max"]["value"] == pytest.approx(0.004)
    assert found["tool_straightness"]["value"] < 1e-12  # a straight line beside the right one is straight


def test_straightness_is_the_distance_from_the_best_line(rng):
    along = np.linspace(-1.0, 1.0, 2000)
    points = np.outer(along, [0.6, 0.8, 0.0]) + 0.002 * rng.normal(size=(2000, 3))
    assert straightness(points) == pytest.approx(0.002 * np.sqrt(2), rel=0.05)


def test_errors_that_are_the_same_correlate_and_others_do_not(rng):
    a, b = rng.normal(size=(5000, 2)), rng.normal(size=(5000, 2))
    assert correlation(a, 3.0 * a) == pytest.approx(1.0)
    assert correlation(a, -a) == pytest.approx(-1.0)
    assert abs(correlation(a, b)) < 0.05
    assert correlation(np.zeros((3, 2)), np.zeros((3, 2))) == 0.0


def test_the_figures_can_be_drawn(traces):
    assert len(tool_and_base(traces).axes) == 4
    assert len(tool_errors({"closed loop": traces, "open loop": traces}).axes) == 4
