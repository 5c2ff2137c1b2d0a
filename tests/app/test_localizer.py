"""The estimate while the robot drives is that of a replay, in whatever portions and however late the readings come."""

import numpy as np
import pytest

from longreach.app import localizer
from longreach.app.configuration import EstimateConfig, EvaluationConfig
from longreach.app.estimate import estimate
from longreach.app.start import start_pose
from longreach.control.hardware import Readings
from longreach.geometry import se2
from longreach.io.config import load_description
from longreach.measurement import PoseMeasurement
from longreach.sim.kinematic import make_recording

_LATENCY = {"wheels": 0.002, "scans": 0.03, "imu": 0.004}


@pytest.fixture(scope="module")
def thing():
    return load_description("thing")


@pytest.fixture(scope="module")
def recording(thing):
    return make_recording(thing, seed=1, duration=4.0, lidar_rate=20.0, beams=180)


def _readings(recording, tick=0.008):
    """What a robot would have handed out tick by tick."""
    left = {kind: list(getattr(recording, kind)) for kind in _LATENCY}
    now = 0.0
    while any(left.values()):
        new = {}
        for kind, records in left.items():
            count = sum(record.stamp + _LATENCY[kind] <= now for record in records)
            new[kind], left[kind] = tuple(records[:count]), records[count:]
        yield Readings(now, **new)
        now += tick


def _online(thing, recording, config):
    whole = Readings(0.0, wheels=recording.wheels, scans=recording.scans, imu=recording.imu)
    first = localizer.oldest(whole, config)
    state, rows = localizer.init(thing, first, np.zeros(3), config), []
    for readings in _readings(recording):
        before = state
        state, _ = localizer.step(state, readings)
        rows += localizer.settled(before, state)
    return state, [*rows, *localizer.settled(state, None)]


@pytest.mark.parametrize("sources", [("wheels", "imu"), ("wheels", "lidar", "imu")])
def test_online_is_offline(thing, recording, sources):
    config = EstimateConfig(sources=sources, evaluation=EvaluationConfig(align="none"))
    _, rows = _online(thing, recording, config)
    replayed = estimate(recording, thing, config).trajectories["fused"]
    online = {row.stamp: row for row in rows}
    both = [i for i, stamp in enumerate(replayed.stamps.tolist()) if stamp in online]
    assert len(both) > 0.95 * len(replayed)
    for i in both:
        row = online[float(replayed.stamps[i])]
        np.testing.assert_allclose(row.pose, replayed.poses[i], atol=1e-6)
        np.testing.assert_allclose(row.covariance, replayed.covariance[i], atol=1e-9)


def test_online_is_offline_on_the_map_and_fixes_leave_odom_alone(thing, recording):
    clock, poses = recording.truth.clock[::25].tolist(), recording.truth.poses[::25]
    P = np.diag([0.01, 0.01, 0.02]) ** 2
    moved = [se2.compose(np.array([5.0, -2.0, 1.0]), pose) for pose in poses]
    fixes = [PoseMeasurement(stamp, pose, P, "fixes") for stamp, pose in zip(clock, moved, strict=True)]
    config = EstimateConfig(sources=("wheels", "imu", "fixes"), evaluation=EvaluationConfig(align="none"))
    replayed = estimate(recording.replace(fixes=tuple(fixes)), thing, config).trajectories
    first = min(recording.wheels[0].stamp, recording.imu[0].stamp, clock[0])
    state, rows, waiting = localizer.init(thing, first, np.zeros(3), config, start_pose(fixes, (), first)), [], fixes
    for readings in _readings(recording):
        before, new = state, [fix for fix in waiting if fix.stamp + 0.02 <= readings.stamp]
        waiting = waiting[len(new) :]
        state, _ = localizer.step(state, readings, new)
        rows += localizer.settled_on_map(before, state)
    online = {row.stamp: row for row in [*rows, *localizer.settled_on_map(state, None)]}
    path = replayed["localized"]
    for stamp, pose, covariance in list(zip(path.stamps.tolist(), path.poses, path.covariance, strict=True))[5:-5]:
        np.testing.assert_allclose(online[stamp].pose, pose, atol=1e-6)
        np.testing.assert_allclose(online[stamp].covariance, covariance, atol=1e-9)
    now = state.filter.stamp
    np.testing.assert_allclose(state.belief(now).pose, replayed["fused"].poses[-1], atol=0.01)
    np.testing.assert_allclose(state.belief_on_map(now).pose, moved[-1], atol=0.1)


def test_the_belief_goes_ahead_of_the_newest_measurement_and_grows_less_sure(thing, recording):
    state, _ = _online(thing, recording, EstimateConfig(sources=("wheels",)))
    now = state.filter.stamp
    near, far = state.belief(now + 0.01), state.belief(now + 0.1)
    assert far.stamp == pytest.approx(now + 0.1)
    assert np.all(np.diag(far.covariance)[:3] > np.diag(near.covariance)[:3])


def test_readings_from_before_the_start_are_nothing(thing, recording):
    late = recording.wheels[20].stamp
    state = localizer.init(thing, late, np.zeros(3), EstimateConfig(sources=("wheels",)))
    for readings in _readings(recording):
        state, corrections = localizer.step(state, readings)
        assert all(c.status == "used" for c in corrections)
    assert state.filter.stamp > late


def test_readings_that_say_nothing_change_nothing(thing):
    state = localizer.init(thing, 0.0, np.zeros(3))
    after, corrections = localizer.step(state, Readings(1.0))
    assert corrections == []
    assert after.filter is state.filter


def test_a_wheel_record_that_comes_late_changes_nothing(thing, recording):
    config, wheels = EstimateConfig(sources=("wheels",)), recording.wheels
    state = localizer.init(thing, wheels[0].stamp, np.zeros(3), config)
    state, _ = localizer.step(state, Readings(1.0, wheels=wheels[:50]))
    after, corrections = localizer.step(state, Readings(1.1, wheels=(wheels[30], *wheels[50:60])))
    plain, expected = localizer.step(state, Readings(1.1, wheels=wheels[50:60]))
    assert (after.wheels.late, len(corrections)) == (1, len(expected))
    np.testing.assert_array_equal(after.belief(2.0).pose, plain.belief(2.0).pose)
    np.testing.assert_array_equal(after.belief(2.0).covariance, plain.belief(2.0).covariance)
