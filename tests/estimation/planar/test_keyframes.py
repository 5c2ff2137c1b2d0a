"""Poses relative to keyframes: one pose clone for all matches to one, and the noise of its own scan counted once."""

from dataclasses import replace

import numpy as np
import pytest
from keyframe_events import CONFIG, SAME, SCAN, events_of, unchecked
from scipy.stats import chi2

from longreach.errors import EstimationError
from longreach.estimation.planar.filter import in_order, init, step
from longreach.estimation.planar.state import Keyframe
from longreach.geometry import se2
from longreach.measurement import RelativePoseMeasurement


def last_error(events, x, config=CONFIG):
    state = init(0.0, np.zeros(3), None, config)
    for event in in_order(events):
        state, correction = step(state, event)
        assert correction.status == "used"
    return se2.difference(state.belief.pose, x[:3]), state.belief.pose_covariance


def mean_nees(rng, runs, shares):
    values = []
    for _ in range(runs):
        e, P = last_error(*events_of(rng, shares)[:2])
        values.append(e @ np.linalg.solve(P, e))
    return np.mean(values), chi2.ppf([0.005, 0.995], 3 * runs) / runs


def test_with_what_matches_share_the_filter_is_as_wrong_as_it_says(rng):
    nees, (low, high) = unchecked(mean_nees, rng, 25, shares=True)
    assert low < nees < high


def test_matches_taken_for_independent_make_it_too_sure(rng):
    nees, (_, high) = unchecked(mean_nees, rng, 60, shares=False)
    assert nees > high


def test_the_noise_of_a_keyframe_cancels_where_one_match_leads_to_it_and_the_next_from_it():
    """In a chain of n keyframes only what differs in each between match and keyframe adds up, not all of 2n errors."""
    loose = CONFIG.model_copy(update={"acceleration_deviation": (1e3,) * 3, "initial_twist_deviation": (1e3,) * 3})
    n, R, at = 12, 1e-4 * np.eye(3), 0.0
    state, _ = step(init(0.0, np.zeros(3), None, loose), Keyframe(0.0, "lidar"))
    for i in range(n):
        match = RelativePoseMeasurement(at, i + 1.0, np.zeros(3), 2 * R, "lidar", None, R)
        state, _ = step(state, Keyframe(i + 1.0, "lidar", match))
        at = i + 1.0
    expected = 1e-4 * (2 + 2 * (1 - SAME) * (n - 1))
    assert np.diag(state.belief.pose_covariance)[2] == pytest.approx(expected, rel=1e-2)


def test_a_keyframe_that_no_match_leads_to_takes_its_noise_from_the_first_match(rng):
    state, _ = step(init(0.0, np.zeros(3), None, CONFIG), Keyframe(0.0, "lidar"))
    z = np.array([0.1, 0.0, 0.02])
    A = se2.adjoint(se2.inverse(z))
    match = RelativePoseMeasurement(0.0, 0.1, z, SCAN + A @ SCAN @ A.T, "lidar", None, A @ SCAN @ A.T)
    state, _ = step(state, match)
    np.testing.assert_allclose(state.newest.clones["lidar"].own, SCAN, atol=1e-12)
    before = np.diag(state.newest.P)[16:19]
    assert np.all(before > 0.5 * np.diag(SCAN))
    state, _ = step(state, replace(match, stamp=0.2))
    assert np.all(np.diag(state.newest.P)[16:19] <= before)  # counted once


def test_what_is_shared_may_be_all_there_is(rng):
    """The rest of the covariance stays positive definite, and along a corridor both are huge."""
    huge = np.diag([25.0, 1e-5, 1e-6])
    state, _ = step(init(0.0, np.zeros(3), None, CONFIG), Keyframe(0.0, "lidar"))
    for i in range(1, 5):
        event = RelativePoseMeasurement(0.0, 0.1 * i, np.array([0.1, 0.0, 0.0]), huge, "lidar", None, huge)
        state, correction = step(state, event)
        assert correction.status == "used"
    assert np.linalg.eigvalsh(state.newest.P)[0] > -1e-12


def test_a_keyframe_whose_match_says_nothing_finite_is_a_keyframe_all_the_same():
    state, _ = step(init(0.0, np.zeros(3), None, CONFIG), Keyframe(0.0, "lidar"))
    bad = RelativePoseMeasurement(0.0, 0.1, np.array([np.nan, 0.0, 0.0]), 2 * SCAN, "lidar", None, SCAN)
    state, correction = step(state, Keyframe(0.1, "lidar", bad))
    assert correction.status == "refused"
    assert state.newest.clones["lidar"].stamp == 0.1
    assert np.all(np.isfinite(state.newest.mean))
    assert len(state.newest.mean) == 19


def test_a_match_of_another_stamp_makes_no_keyframe():
    with pytest.raises(EstimationError, match="of the same stamp and source"):
        Keyframe(0.2, "lidar", RelativePoseMeasurement(0.0, 0.1, np.zeros(3), SCAN, "lidar"))


def test_late_keyframes_give_what_they_give_in_order(rng):
    events, _, _ = events_of(rng)
    config = CONFIG.model_copy(update={"history": 5.0, "noise_memory": 100.0})
    sorted_, late = (init(0.0, np.zeros(3), None, config) for _ in range(2))
    for event in in_order(events):
        sorted_, _ = step(sorted_, event)
    wheels = [e for e in events if e.source == "wheels"]
    for event in [*wheels, *in_order(e for e in events if e.source == "lidar")]:
        late, _ = step(late, event)
    np.testing.assert_array_equal(late.belief.pose, sorted_.belief.pose)
    np.testing.assert_array_equal(late.belief.covariance, sorted_.belief.covariance)
    np.testing.assert_array_equal(late.newest.noise["lidar"].log, sorted_.newest.noise["lidar"].log)
