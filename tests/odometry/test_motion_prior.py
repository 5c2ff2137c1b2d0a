"""The prior of a scan's match by the wheels: where the base is expected, from what they had measured by then."""

from itertools import pairwise

import numpy as np
import pytest

from longreach.geometry import se2
from longreach.measurement import RelativePoseMeasurement
from longreach.odometry import motion_prior

TWIST = np.array([0.4, 0.05, 0.6])  # [m/s, m/s, rad/s]


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
    found = motion_prior.from_wheels(steps_at(np.arange(6) * 0.1), before, now)
    np.testing.assert_allclose(found, se2.exp((now - before) * TWIST), atol=1e-12)


def test_the_prior_from_record_to_record_is_the_steps_between(rng):
    steps = wandering(rng)
    expected = np.zeros(3)
    for step in steps[5:12]:
        expected = se2.compose(expected, step.pose)
    found = motion_prior.from_wheels(steps, steps[5].stamp_reference, steps[11].stamp)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_priors_over_two_periods_compose_to_that_over_both(rng):
    steps = wandering(rng)
    a, b, c = steps[3].stamp + 0.01, steps[14].stamp, steps[30].stamp
    one, other, both = (motion_prior.from_wheels(steps, *span) for span in ((a, b), (b, c), (a, c)))
    np.testing.assert_allclose(se2.compose(one, other), both, atol=1e-12)


def test_a_prior_knows_nothing_of_what_comes_after_it(rng):
    steps = wandering(rng)
    before, now = steps[10].stamp + 0.003, steps[20].stamp + 0.005
    known = [step for step in steps if step.stamp <= now]
    assert len(known) < len(steps)
    np.testing.assert_array_equal(
        motion_prior.from_wheels(steps, before, now), motion_prior.from_wheels(known, before, now)
    )


def test_no_motion_in_no_time():
    np.testing.assert_allclose(motion_prior.from_wheels(steps_at([0.0, 0.1, 0.2]), 0.15, 0.15), 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("before", "now"),
    [(-0.05, 0.2), (0.1, 0.85), (0.6, 0.85), (-0.2, -0.1), (0.0, 0.05)],
    ids=["begins before the first", "too long after the last", "both after", "both before", "no step has ended"],
)
def test_there_is_no_prior_where_the_wheels_do_not_reach(before, now):
    assert motion_prior.from_wheels(steps_at(np.arange(6) * 0.1), before, now) is None


def test_there_is_no_prior_without_wheels():
    assert motion_prior.from_wheels([], 0.0, 0.1) is None


def test_a_missing_step_within_the_period_leaves_no_prior_and_one_outside_does_not_matter():
    steps = steps_at(np.arange(10) * 0.1)
    del steps[4]  # from 0.4 to 0.5
    assert motion_prior.from_wheels(steps, 0.35, 0.65) is None
    for before, now in ((0.1, 0.35), (0.55, 0.75)):
        found = motion_prior.from_wheels(steps, before, now)
        np.testing.assert_allclose(found, se2.exp((now - before) * TWIST), atol=1e-12)


def test_each_scan_has_the_prior_since_the_scan_before_and_the_first_has_none():
    steps, stamps = steps_at(np.arange(20) * 0.1), [0.05, 0.25, 0.5, 0.51, 3.0]
    found = motion_prior.between_scans(steps, stamps)
    assert [prior is None for prior in found] == [True, False, False, False, True]
    for prior, (before, now) in zip(found[1:4], pairwise(stamps[:4]), strict=True):
        np.testing.assert_array_equal(prior, motion_prior.from_wheels(steps, before, now))
    assert motion_prior.between_scans(steps, []) == []
    assert motion_prior.between_scans([], stamps) == [None] * 5
