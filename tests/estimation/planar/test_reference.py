"""The local reference: what is relative does not know where it is, and nothing but a fix moves it."""

import numpy as np
import pytest
from correction_bounds import corrections_of
from keyframe_events import CONFIG, events_of, noise, unchecked
from scipy.stats import chi2

from longreach.estimation.planar import ekf
from longreach.estimation.planar.config import FilterConfig
from longreach.estimation.planar.filter import in_order, init, step
from longreach.estimation.planar.measurement_models import PlanarImu
from longreach.estimation.planar.state import Keyframe, PoseClone
from longreach.geometry import se2
from longreach.measurement import PoseMeasurement, RelativePoseMeasurement

MOTION = np.array([300.0, -200.0, 2.0])
ROBUST = FilterConfig(gate_mode="inflate", history=0.0, noise_memory=300.0, scale_deviation=(0.02,) * 3)
STEP, READING, SCAN = (np.diag(d) ** 2 for d in ([1e-3, 1e-3, 2e-3], [3e-4, 3e-4, 3e-4], [5e-4, 5e-4, 1e-4]))
FIX = np.diag([0.02**2, 0.03**2, np.inf])


def drive(rng, faults=True):
    """Wheels, scans and an IMU on a circle; with faults, wheels spin and a scan is matched wrongly for a while."""
    events, truth, key = [PoseClone(0.0, "wheels"), Keyframe(0.0, "lidar")], [np.zeros(3)], 0
    for i in range(1, 161):
        now, z = 0.05 * i, se2.exp(0.05 * np.array([0.6, 0.1, 0.4]))
        truth.append(se2.compose(truth[-1], z))
        spun = se2.exp(3.0 * se2.log(z)) if faults and 40 <= i < 60 else z
        read = se2.retract(spun, noise(rng, STEP))
        events.append(RelativePoseMeasurement(0.05 * (i - 1), now, read, STEP, "wheels", READING))
        events.append(PlanarImu(now, 0.4 + 0.01 * rng.normal(), None, np.zeros(2), 1e-4))
        if i % 2 == 0:
            seen = se2.retract(se2.between(truth[key], truth[-1]), noise(rng, SCAN))
            if faults and 100 <= i < 120:
                seen = se2.compose(seen, np.array([0.3, 0.1, 0.05]))
            match = RelativePoseMeasurement(0.05 * key, now, seen, 2 * SCAN, "lidar", None, SCAN)
            events.append(Keyframe(now, "lidar", match) if i % 20 == 0 else match)
            key = i if i % 20 == 0 else key
    return in_order(events), truth


def states_of(events, pose, covariance=None, config=ROBUST):
    state, states, corrections = init(0.0, pose, covariance, config), [], []
    for event in events:
        state, correction = step(state, event)
        states.append(state)
        corrections.append(correction)
    return states, corrections


def local(state):
    """Mean and covariance of all but the reference's pose."""
    last = state.newest
    rows = np.r_[: ekf.REFERENCE, ekf.CLONES : len(last.mean)]
    return last.mean[rows], last.P[np.ix_(rows, rows)]


@pytest.mark.parametrize("fixes", [False, True])
def test_a_rigid_motion_of_all_that_is_absolute_changes_nothing_that_is_relative(rng, fixes):
    events, truth = drive(rng)
    here = [
        PoseMeasurement(1.0 * i, truth[20 * i] + noise(rng, np.diag([4e-4, 9e-4, 1e-4])), FIX, "fixes")
        for i in range(1, 8)
    ]
    R = np.array([[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]])
    C = np.diag([0.0, 0.0, np.inf])
    C[:2, :2] = R @ FIX[:2, :2] @ R.T
    there = [PoseMeasurement(f.stamp, se2.compose(MOTION, f.pose), C, "fixes") for f in here]
    P = np.diag([0.01, 0.01, 0.01])
    for_all = [in_order([*events, *(some if fixes else ())]) for some in (here, there)]
    first, judged = unchecked(states_of, for_all[0], np.zeros(3), P)
    second, again = unchecked(states_of, for_all[1], MOTION, P)
    for one, other in zip(first, second, strict=True):
        np.testing.assert_allclose(local(one)[0], local(other)[0], atol=1e-9)
        np.testing.assert_allclose(se2.compose(MOTION, one.belief.pose), other.belief.pose, atol=1e-9)
        np.testing.assert_allclose(one.belief.covariance, other.belief.covariance, atol=1e-9)
    np.testing.assert_allclose([c.nis for c in judged], [c.nis for c in again], rtol=1e-6, atol=1e-9)


def test_not_knowing_where_the_start_is_changes_nothing_local(rng):
    events, _ = drive(rng)
    known, judged = unchecked(states_of, events, np.zeros(3))
    lost, again = unchecked(states_of, events, np.zeros(3), np.diag([100.0, 100.0, 1.0]) ** 2)
    for one, other in zip(known, lost, strict=True):
        for a, b in zip(local(one), local(other), strict=True):
            np.testing.assert_array_equal(a, b)
    assert [c.nis for c in judged] == [c.nis for c in again]
    assert np.sqrt(lost[-1].belief.covariance[2, 2]) > 1.0


def test_corrections_are_as_large_as_their_innovations_and_never_move_the_reference(rng, monkeypatch):
    events, _ = drive(rng)
    taken = corrections_of(monkeypatch, lambda: unchecked(states_of, events, np.zeros(3)))
    assert len(taken) > 300
    for correction in taken:
        assert correction.reference_moved == 0.0
        assert correction.squared <= correction.nis * (1.0 + 1e-6) + 1e-12


def test_the_reference_is_a_keyframe_that_was_left(rng):
    events, truth = drive(rng, faults=False)
    state = unchecked(states_of, events, np.zeros(3))[0][-1]
    xi = se2.difference(state.newest.mean[13:16], truth[140])  # the last keyframe is at 160
    assert np.all(np.abs(xi) < 0.01)


def test_without_scans_the_reference_is_renewed_on_the_way_and_the_path_is_that_of_the_wheels(rng):
    events = [event for event in drive(rng, faults=False)[0] if event.source == "wheels"]
    states, _ = unchecked(states_of, events, np.zeros(3))
    counted = np.zeros(3)
    for event in events[1:]:
        counted = se2.compose(counted, event.pose)
    assert max(np.hypot(*state.newest.mean[:2]) for state in states) < 1.1
    np.testing.assert_allclose(states[-1].belief.pose, counted, atol=1e-3)


def nees_of(rng, runs, fixes):
    """NEES of the last compounded pose after a dozen keyframes, on draws from the filter's own model."""
    values = []
    for _ in range(runs):
        events, x, truth = events_of(rng, scans=60, every=5)
        wide = np.diag([0.1, 0.1, 0.05]) ** 2
        if fixes:
            events += [
                PoseMeasurement(0.1 * i - 0.05, _between(truth, i) + noise(rng, 4e-4 * np.eye(3)), _FIX, "fixes")
                for i in range(2, 61, 6)
            ]
        start = se2.retract(np.zeros(3), -noise(rng, wide)) if fixes else np.zeros(3)
        state = states_of(in_order(events), start, wide if fixes else None, CONFIG)[0][-1]
        error, P = se2.difference(state.belief.pose, x[:3]), state.belief.pose_covariance
        values.append(error @ np.linalg.solve(P, error))
    return np.mean(values), chi2.ppf([0.005, 0.995], 3 * runs) / runs


_FIX = np.diag([4e-4, 4e-4, np.inf])


def _between(truth, i):
    return se2.retract(truth[i - 1], 0.5 * se2.difference(truth[i - 1], truth[i]))


@pytest.mark.parametrize("fixes", [False, True])
def test_the_compounded_pose_is_as_wrong_as_it_says(rng, fixes):
    nees, (low, high) = unchecked(nees_of, rng, 30, fixes)
    assert low < nees < high
