"""Slip that lasts is learned as a velocity that wheels do not count; noise and the stamps of a logger are not."""

from itertools import pairwise

import numpy as np
import pytest
from keyframe_events import unchecked

from longreach.estimation.planar.config import FilterConfig
from longreach.estimation.planar.filter import in_order, init, step
from longreach.estimation.planar.noise_adaptation import NO_SLIP, corrected, way
from longreach.estimation.planar.state import Keyframe, PoseClone
from longreach.estimation.planar.update import predicted
from longreach.geometry import se2
from longreach.measurement import RelativePoseMeasurement

PERIOD, NOISE = 0.025, 0.001  # of scans [s], and of what each says [m, rad]
ALL = np.ones(3)


def learned(rng, rate, count=400, coupled=ALL, jitter=0.0):
    """What is learned where all that a scan says is taken: the pose is off by the slip since the last, and by noise."""
    slip, stamp, way_off = NO_SLIP, 0.0, np.zeros(3)
    for _ in range(count):
        dt = PERIOD * (1.0 + jitter * rng.uniform(-1.0, 1.0))
        stamp += dt
        way_off = way_off + (rate - slip.rate) * dt
        r = way_off + NOISE * rng.normal(size=3)
        way_off = way_off - r  # what is left is the noise that was taken
        slip = corrected(slip, r, np.zeros(3), se2.exp(r), stamp, coupled)
    return slip


def test_a_slip_that_lasts_is_found(rng):
    rate = np.array([0.2, -0.1, 0.0])
    slip = learned(rng, rate)
    np.testing.assert_allclose(slip.rate[:2], rate[:2], atol=0.04)
    assert slip.rate[2] == 0.0
    assert np.all(np.sqrt(slip.rows[1, :2]) < 0.05)


def test_noise_is_not_taken_for_slip(rng):
    found = [learned(rng, np.zeros(3), 200).rate for _ in range(100)]
    assert np.mean(np.array(found) != 0.0) < 0.02


def test_an_axis_that_is_not_coupled_to_the_wheels_does_not_slip(rng):
    slip = learned(rng, np.array([0.2, 0.2, 0.2]), coupled=np.array([1.0, 0.0, 1.0]))
    assert slip.rate[1] == 0.0
    assert slip.rate[0] > 0.1


def test_stamps_of_a_logger_show_no_rates(rng):
    slip = learned(rng, np.array([0.2, 0.0, 0.0]), jitter=0.6)
    assert not slip.rate.any()


def test_what_has_not_been_observed_for_long_is_forgotten(rng):
    slip = learned(rng, np.array([0.2, 0.0, 0.0]))
    later = corrected(slip, np.zeros(3), np.zeros(3), np.zeros(3), slip.seen + 3.0, ALL)
    assert 0.0 < later.rate[0] < 0.06 * slip.rate[0]


def test_the_way_slipped_adds_up_and_grows_less_sure(rng):
    slip = learned(rng, np.array([0.2, 0.0, 0.0]))
    t = slip.seen + np.linspace(0.0, 2.0, 41)
    parts = [way(slip, 1.0, a, b) for a, b in pairwise(t)]
    whole = way(slip, 1.0, t[0], t[-1])
    np.testing.assert_allclose(np.sum([xi for xi, _ in parts], axis=0), whole[0], atol=1e-12)
    np.testing.assert_allclose(np.sum([variance for _, variance in parts], axis=0), whole[1], atol=1e-12)
    assert min(variance[0] for _, variance in parts) > 0.0
    np.testing.assert_allclose(parts[0][0], 0.05 * slip.rate, rtol=0.03)
    assert not way(slip, 0.0, t[0], t[1])[0].any()


@pytest.mark.parametrize("slides", [0.0, 0.15])
def test_between_scans_the_pose_goes_where_the_base_slides(rng, slides):
    config = FilterConfig(gate_mode="inflate", history=0.0, noise_memory=300.0, scale_deviation=(0.02,) * 3)
    off, slip = unchecked(_driven, rng, config, slides)
    off_as_stated, none = unchecked(_driven, rng, FilterConfig(**(config.model_dump() | {"noise_memory": 0.0})), slides)
    assert none is NO_SLIP
    if slides:
        assert off < 0.6 * off_as_stated
        np.testing.assert_allclose(slip.rate[:2], [0.0, slides], atol=0.03)
    else:
        assert off < 1.1 * off_as_stated
        assert not slip.rate.any()


@pytest.mark.parametrize("mode", ["reject", "inflate"])
def test_a_match_beyond_the_gate_tells_of_no_slip(mode):
    config = FilterConfig(gate_mode=mode, noise_memory=300.0)
    state, P = init(0.0, np.zeros(3), None, config), 1e-6 * np.eye(3)
    for event in (PoseClone(0.0, "wheels"), Keyframe(0.0, "lidar")):
        state, _ = step(state, event)
    state, _ = step(state, RelativePoseMeasurement(0.0, 0.02, np.zeros(3), P, "wheels", P))
    before = state.newest.slip
    state, said = step(state, RelativePoseMeasurement(0.0, 0.025, np.array([5.0, 0.0, 0.0]), P, "lidar", None, P))
    assert "above the gate" in said.reason
    assert state.newest.slip is before
    state, said = step(state, RelativePoseMeasurement(0.0, 0.05, np.zeros(3), 4 * P, "lidar", None, P))
    assert (state.newest.slip is before) == bool(said.reason)


def _driven(rng, config, slides):
    """How far off scans find the pose, RMS sideways [m], on a drive that slides sideways, and the slip at the end."""
    counted, slipped, scan = np.array([0.8, 0.0, 0.1]), np.array([0.8, slides, 0.1]), np.diag([1e-3, 1e-3, 3e-4]) ** 2
    steps, reading = np.diag([2e-3, 2e-3, 4e-3]) ** 2, np.diag([4e-3, 5e-3, 3e-4]) ** 2
    events = [PoseClone(0.0, "wheels"), Keyframe(0.0, "lidar")]
    for before, now in pairwise(0.02 * np.arange(401)):
        z = se2.retract(se2.exp(0.02 * counted), 2e-4 * rng.normal(size=3))
        events.append(RelativePoseMeasurement(before, now, z, steps, "wheels", reading))
    for i, now in enumerate(PERIOD * np.arange(1, 320)):
        key = PERIOD * (i // 40 * 40)
        seen = se2.retract(se2.exp((now - key) * slipped), rng.multivariate_normal(np.zeros(3), scan))
        match = RelativePoseMeasurement(key, now, seen, 2 * scan, "lidar", None, scan)
        events.append(Keyframe(now, "lidar", match) if i % 40 == 39 else match)
    state, off = init(0.0, np.zeros(3), None, config), []
    for event in in_order(events):
        state, correction = step(state, event)
        if event.source == "lidar" and event.stamp > 4.0:
            off.append(correction.innovation[1])
    if state.newest.slip.rate.any():  # the twist is that of the base, not of its wheels
        np.testing.assert_allclose(state.belief.twist, slipped, atol=0.05)
        way_on = se2.difference(
            state.belief.pose, predicted(config, state.newest, (state.stamp + 0.1, 0, "")).belief.pose
        )
        np.testing.assert_allclose(way_on, 0.1 * state.belief.twist, atol=0.002)
    return float(np.sqrt(np.mean(np.square(off)))), state.newest.slip
