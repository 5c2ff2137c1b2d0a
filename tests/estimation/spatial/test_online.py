"""The filter one reading at a time: the same as over a whole recording, in whatever order they come in."""

import numpy as np
import pytest
from estimation.spatial.test_batch import POSE, drive, pose, recording, sensor, twist

from longreach.estimation.spatial.batch import estimate_in_space
from longreach.estimation.spatial.online import init, predict, step
from longreach.spatial_settings import SpatialSettings

SENSORS = (sensor(), sensor("pose", POSE), sensor("odom", POSE, differential=True))


def readings(rng, count=60):
    stamps, u, poses = drive(count)
    found = [twist(t, u + 0.02 * rng.normal(size=6)) for t in stamps]
    found += [pose(t + 0.01, T) for t, T in zip(stamps[::4], poses[::4], strict=True)]
    found += [pose(t + 0.013, T, source="odom0") for t, T in zip(stamps[::4], poses[::4], strict=True)]
    return sorted(found, key=lambda r: r.stamp)


def run(order, **settings):
    state = init(SpatialSettings(SENSORS, **settings), recording([]))
    for reading in order:
        state = step(state, reading)
    return state


@pytest.mark.parametrize("kind", ["ekf", "ukf"])
@pytest.mark.parametrize("as_is", [False, True])
def test_it_is_the_filter_over_the_whole_recording(rng, kind, as_is):
    settings = {"filter": kind, "as_robot_localization": as_is, "sensor_timeout": 1.0}
    state = run(readings(rng), **settings)
    whole = estimate_in_space(
        recording(readings(np.random.default_rng(20260101))), SpatialSettings(SENSORS, **settings)
    )
    np.testing.assert_allclose(state.mean, whole.states[-1], atol=1e-9)
    np.testing.assert_allclose(state.covariance[:6, :6], whole.state_covariance[-1], atol=1e-9)
    assert state.stamp == whole.stamps[-1]


@pytest.mark.parametrize("as_is", [False, True])
def test_late_readings_are_taken_where_they_belong(rng, as_is):
    ordered = readings(rng)
    shuffled = [ordered[0], *sorted(ordered[1:], key=lambda r: r.stamp + rng.uniform(0.0, 0.2))]
    a, b = (run(order, as_robot_localization=as_is) for order in (ordered, shuffled))
    np.testing.assert_array_equal(a.mean, b.mean)
    np.testing.assert_array_equal(a.covariance, b.covariance)
    assert len(b.buffer.entries) < 60


def test_what_is_too_late_or_from_the_future_changes_nothing(rng):
    ordered = readings(rng)
    clean = run(ordered)
    strange = [twist(ordered[0].stamp + 0.1, np.full(6, 9.0)), twist(ordered[-1].stamp + 900.0, np.full(6, 9.0))]
    state = run([*ordered[:60], *strange, *ordered[60:]])
    assert (state.late, state.ahead) == (1, 1)
    np.testing.assert_array_equal(state.mean, clean.mean)


def test_after_a_pause_the_clock_is_believed_again(rng):
    ordered = readings(rng)
    state = run([*ordered, *(twist(ordered[-1].stamp + 600.0 + 0.1 * i, np.zeros(6)) for i in range(20))])
    assert state.ahead == 0  # those that waited are taken with the one that confirms them
    assert state.stamp == ordered[-1].stamp + 601.9


def test_a_prediction_leaves_the_filter_as_it_is(rng):
    state = run(readings(rng))
    x, P = predict(state, state.stamp + 0.5)
    assert np.linalg.norm(x[:3] - state.mean[:3]) == pytest.approx(0.5, abs=0.05)
    assert np.trace(P) > np.trace(state.covariance)
    np.testing.assert_array_equal(predict(state, state.stamp)[0], state.mean)
