"""Looking back: the smoother is the batch solution where that is known, and never less sure than the filter."""

from itertools import pairwise

import numpy as np
import pytest
from keyframe_events import CONFIG, events_of, unchecked
from scipy.stats import chi2

from longreach.errors import EstimationError
from longreach.estimation.planar import _ekf_kernels as kernels
from longreach.estimation.planar.config import FilterConfig
from longreach.estimation.planar.filter import in_order, init, step
from longreach.estimation.planar.smoother import smooth
from longreach.estimation.planar.state import Keyframe
from longreach.geometry import se2
from longreach.measurement import PoseMeasurement, RelativePoseMeasurement, TwistMeasurement
from longreach.trajectory import PoseTrajectory

STILL = 1e-9


def batch(stamps, rows, values, variances):
    """Least squares over (p, v, a) of x at each stamp: prior, motion, and measurements as rows over all of them."""
    n = 3 * len(stamps)
    H, z, W = [np.eye(3, n)], [np.zeros(3)], [np.diag([1 / 0.04, 1.0, 1.0])]
    for i, (before, now) in enumerate(pairwise(stamps)):
        f, g, e, q = kernels.singer(now - before, 0.5)
        Phi = np.array([[1.0, now - before, f], [0.0, 1.0, g], [0.0, 0.0, e]])
        Q = np.array([[q[0], q[1], q[2]], [q[1], q[3], q[4]], [q[2], q[4], q[5]]])
        J = np.zeros((3, n))
        J[:, 3 * i : 3 * i + 3], J[:, 3 * i + 3 : 3 * i + 6] = -Phi, np.eye(3)
        H, z, W = [*H, J], [*z, np.zeros(3)], [*W, np.linalg.inv(Q)]
    for row, value, variance in zip(rows, values, variances, strict=True):
        H, z, W = [*H, row[None]], [*z, np.array([value])], [*W, np.array([[1 / variance]])]
    information = sum(h.T @ w @ h for h, w in zip(H, W, strict=True))
    x = np.linalg.solve(information, sum(h.T @ w @ y for h, w, y in zip(H, W, z, strict=True)))
    return x[::3], np.diag(np.linalg.inv(information))[::3]


def test_without_rotation_it_is_batch_least_squares(rng):
    config = FilterConfig(
        acceleration_deviation=(1.0, 1.0, STILL),
        initial_twist_deviation=(1.0, 1.0, STILL),
        gate_mode="none",
        history=0.0,
    )
    stamps = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 0.4, 9))]).tolist()
    events, rows, values, variances = [Keyframe(stamps[2], "lidar")], [], [], []
    for i, stamp in enumerate(stamps):
        z, row = rng.normal(), np.zeros(3 * len(stamps))
        if i in (0, 4, 8):
            row[3 * i], R = 1.0, 0.01
            events.append(PoseMeasurement(stamp, np.array([z, 0.0, 0.0]), np.diag([R, 0.01, np.inf])))
        elif i in (3, 5, 7):
            row[3 * i], row[6], R = 1.0, -1.0, 0.004
            events.append(RelativePoseMeasurement(stamps[2], stamp, np.array([z, 0.0, 0.0]), R * np.eye(3), "lidar"))
        else:
            row[3 * i + 1], R = 1.0, 0.02
            events.append(TwistMeasurement(stamp, np.array([z, 0.0, 0.0]), R * np.eye(3)))
        rows, values, variances = [*rows, row], [*values, z], [*variances, R]
    state = init(0.0, np.zeros(3), np.diag([0.04, 0.04, STILL**2]), config)
    smoothed = smooth(state, in_order(events))
    x, variance = batch(stamps, rows, values, variances)
    np.testing.assert_allclose(smoothed.stamps, stamps)
    np.testing.assert_allclose(smoothed.poses[:, 0], x, atol=1e-7)
    np.testing.assert_allclose(smoothed.covariance[:, 0, 0], variance, rtol=1e-6)


def filtered(state, events):
    """The filter's path: the pose after the last event of each stamp."""
    rows = {}
    for event in in_order(events):
        state, _ = step(state, event)
        rows[state.stamp] = state.newest.pose
    return PoseTrajectory(np.array(list(rows)), *(np.array(column) for column in zip(*rows.values(), strict=True)))


def middle_error(rng, config):
    events, x, _ = events_of(rng)
    events.append(PoseMeasurement(events[-1].stamp, x[:3], 1e-8 * np.eye(3)))  # all is known in the end
    state = init(0.0, np.zeros(3), None, config)
    return filtered(state, events), smooth(state, in_order(events))


def test_it_is_never_less_sure_than_the_filter_and_ends_near_it(rng):
    path, smoothed = middle_error(rng, CONFIG)
    np.testing.assert_array_equal(smoothed.stamps, path.stamps)
    xi = se2.difference(smoothed.poses[-1], path.poses[-1])  # each leaves another part of what is measured unused
    assert xi @ np.linalg.solve(path.covariance[-1], xi) < chi2.ppf(0.9, 3)
    assert np.all(np.trace(smoothed.covariance, axis1=1, axis2=2) <= np.trace(path.covariance, axis1=1, axis2=2))
    assert np.linalg.eigvalsh(smoothed.covariance).min() > -1e-12


def errors_of(rng, runs, row):
    """Errors (runs, 3) of the filter and of the smoother in a row, and the smoother's NEES."""
    direct, smoothed, nees = [], [], []
    for _ in range(runs):
        events, _, truth = events_of(rng)
        state = init(0.0, np.zeros(3), None, CONFIG)
        path, back = filtered(state, events), smooth(state, in_order(events))
        direct.append(se2.difference(path.poses[row], truth[row]))
        smoothed.append(se2.difference(back.poses[row], truth[row]))
        nees.append(smoothed[-1] @ np.linalg.solve(back.covariance[row], smoothed[-1]))
    return np.array(direct), np.array(smoothed), np.array(nees)


def test_over_many_runs_it_is_closer_than_the_filter_and_as_wrong_as_it_says(rng):
    runs = 20
    filtered, smoothed, nees = unchecked(errors_of, rng, runs, 11)
    low, high = chi2.ppf([0.005, 0.995], 3 * runs) / runs
    assert low < nees.mean() < high
    assert np.mean(smoothed**2) < 1.1 * np.mean(filtered**2)  # of so few runs the means are 10 % uncertain


def test_nothing_to_take_is_said():
    with pytest.raises(EstimationError, match="No measurement could be taken"):
        smooth(init(0.0, np.zeros(3), None, CONFIG), [])
