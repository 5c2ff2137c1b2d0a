"""Dead reckoning: composition, the covariance's growth, rows that nothing ends at, and the prior of a scan's match."""

from itertools import pairwise

import numpy as np
import pytest

from longreach.errors import EstimationError
from longreach.geometry import se2
from longreach.measurement import RelativePoseMeasurement
from longreach.odometry.dead_reckoning import from_wheels, integrate

Q = np.diag([0.01, 0.02, 0.015]) ** 2
TWIST = np.array([0.4, 0.05, 0.6])  # [m/s, m/s, rad/s]


def steps(rng, stamps):
    return [RelativePoseMeasurement(a, b, rng.normal(0.0, 0.3, 3), Q) for a, b in pairwise(stamps)]


def test_a_chain_composes_and_carries_the_covariance_along(rng):
    stamps = [0.0, 0.5, 1.0, 1.7]
    measurements = steps(rng, stamps)
    start = np.array([3.0, -2.0, 1.0])
    path = integrate(measurements, stamps, start)
    pose, P = start, np.zeros((3, 3))
    for i, m in enumerate(measurements, 1):
        pose, A = se2.compose(pose, m.pose), se2.adjoint(se2.inverse(m.pose))
        P = A @ P @ A.T + Q
        np.testing.assert_allclose(path.poses[i], pose, atol=1e-14)
        np.testing.assert_allclose(path.covariance[i], P, atol=1e-16)
    np.testing.assert_array_equal(path.poses[0], start)
    np.testing.assert_array_equal(path.covariance[0], 0.0)
    np.testing.assert_array_equal(path.clock, stamps)


def test_the_covariance_of_a_chain_is_that_of_many_noisy_ones(rng):
    stamps = np.arange(21) * 0.1
    twist = np.array([0.1, 0.02, 0.1])
    L = np.linalg.cholesky(Q)
    path = integrate([RelativePoseMeasurement(a, b, se2.exp(twist), Q) for a, b in pairwise(stamps.tolist())], stamps)
    ends = np.zeros((20000, 3))
    for _ in stamps[1:]:
        ends = se2.compose(ends, se2.compose(se2.exp(twist), se2.exp(rng.normal(size=ends.shape) @ L.T)))
    errors = se2.difference(path.poses[-1], ends)
    whitened = np.linalg.solve(np.linalg.cholesky(path.covariance[-1]), errors.T)
    np.testing.assert_allclose(whitened @ whitened.T / len(ends), np.eye(3), atol=0.05)


def test_a_match_to_a_keyframe_starts_from_the_keyframes_row(rng):
    key, near = rng.normal(size=3), rng.normal(size=3)
    measurements = [RelativePoseMeasurement(0.0, 1.0, near, Q), RelativePoseMeasurement(0.0, 2.0, key, Q)]
    path = integrate(measurements, [0.0, 1.0, 2.0])
    np.testing.assert_allclose(path.poses[2], se2.exp(se2.log(key)), atol=1e-12)
    np.testing.assert_allclose(path.covariance[2], Q)


def test_a_row_that_nothing_ends_at_keeps_the_row_before(rng):
    measurements = steps(rng, [0.0, 1.0, 2.0, 3.0])
    path = integrate([measurements[0], measurements[2]], [0.0, 1.0, 1.0, 1.5, 2.0, 3.0])
    for row in (2, 3, 4):
        np.testing.assert_array_equal(path.poses[row], path.poses[1])
        np.testing.assert_array_equal(path.covariance[row], path.covariance[1])
    np.testing.assert_allclose(path.poses[5], se2.compose(path.poses[1], measurements[2].pose), atol=1e-14)


def test_no_rows_and_no_measurements_are_fine():
    assert len(integrate([], [])) == 0
    np.testing.assert_array_equal(integrate([], [1.0, 2.0]).poses, 0.0)


def test_rows_that_cannot_be_are_refused(rng):
    measurements = steps(rng, [0.0, 1.0, 2.0])
    with pytest.raises(EstimationError, match="run backwards"):
        integrate(measurements, [0.0, 2.0, 1.0])
    for stamps in ([0.0, 1.0], [0.0, 0.9, 2.0]):
        with pytest.raises(EstimationError, match="is not one of the path's"):
            integrate(measurements, stamps)
    with pytest.raises(EstimationError, match="earlier stamp"):
        integrate([RelativePoseMeasurement(1.0, 1.0, np.zeros(3), Q)], [0.0, 1.0])


def steps_at(stamps, twist=TWIST):
    return [
        RelativePoseMeasurement(a, b, se2.exp((b - a) * twist), 1e-6 * np.eye(3), "wheels") for a, b in pairwise(stamps)
    ]


def wandering(rng, count=40):
    """Steps of any length and motion."""
    stamps = np.cumsum(rng.uniform(0.02, 0.08, count))
    return [
        RelativePoseMeasurement(a, b, se2.exp((b - a) * rng.standard_normal(3)), np.eye(3), "wheels")
        for a, b in pairwise(stamps)
    ]


@pytest.mark.parametrize(
    ("before", "now"), [(0.1, 0.3), (0.13, 0.31), (0.02, 0.11), (0.0, 0.5), (0.5, 0.62), (0.45, 0.75), (0.6, 0.7)]
)
def test_a_constant_twist_is_carried_on_between_the_records_and_after_them(before, now):
    found = from_wheels(steps_at(np.arange(6) * 0.1), before, now)
    np.testing.assert_allclose(found, se2.exp((now - before) * TWIST), atol=1e-12)


def test_the_prior_from_record_to_record_is_the_steps_between(rng):
    steps = wandering(rng)
    expected = np.zeros(3)
    for step in steps[5:12]:
        expected = se2.compose(expected, step.pose)
    found = from_wheels(steps, steps[5].stamp_reference, steps[11].stamp)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_priors_over_two_periods_compose_to_that_over_both(rng):
    steps = wandering(rng)
    a, b, c = steps[3].stamp + 0.01, steps[14].stamp, steps[30].stamp
    one, other, both = (from_wheels(steps, *span) for span in ((a, b), (b, c), (a, c)))
    np.testing.assert_allclose(se2.compose(one, other), both, atol=1e-12)


def test_a_prior_knows_nothing_of_what_comes_after_it(rng):
    steps = wandering(rng)
    before, now = steps[10].stamp + 0.003, steps[20].stamp + 0.005
    known = [step for step in steps if step.stamp <= now]
    assert len(known) < len(steps)
    np.testing.assert_array_equal(from_wheels(steps, before, now), from_wheels(known, before, now))


def test_no_motion_in_no_time():
    np.testing.assert_allclose(from_wheels(steps_at([0.0, 0.1, 0.2]), 0.15, 0.15), 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("before", "now"),
    [(-0.05, 0.2), (0.1, 0.85), (0.6, 0.85), (-0.2, -0.1), (0.0, 0.05)],
    ids=["begins before the first", "too long after the last", "both after", "both before", "no step has ended"],
)
def test_there_is_no_prior_where_the_wheels_do_not_reach(before, now):
    assert from_wheels(steps_at(np.arange(6) * 0.1), before, now) is None


def test_there_is_no_prior_without_wheels():
    assert from_wheels([], 0.0, 0.1) is None


def test_a_missing_step_within_the_period_leaves_no_prior_and_one_outside_does_not_matter():
    steps = steps_at(np.arange(10) * 0.1)
    del steps[4]  # from 0.4 to 0.5
    assert from_wheels(steps, 0.35, 0.65) is None
    for before, now in ((0.1, 0.35), (0.55, 0.75)):
        found = from_wheels(steps, before, now)
        np.testing.assert_allclose(found, se2.exp((now - before) * TWIST), atol=1e-12)
