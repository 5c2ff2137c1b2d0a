"""Who is wrong: wheels that slip, a source that errs for a while, a base that was moved, a gyro that jumped, NaN."""

import numpy as np
import pytest
from keyframe_events import unchecked

from longreach.estimation.planar.config import FilterConfig
from longreach.estimation.planar.fault_detection import bias_jumps_found
from longreach.estimation.planar.filter import in_order, init, step, steps
from longreach.estimation.planar.measurement_models import PlanarImu
from longreach.estimation.planar.state import Keyframe, PoseClone
from longreach.geometry import se2
from longreach.measurement import RelativePoseMeasurement

CONFIG = FilterConfig(gate_mode="inflate", history=0.0, noise_memory=300.0, scale_deviation=(0.02,) * 3)
SCAN = np.diag([5e-4, 5e-4, 1e-4]) ** 2
STEP, READING = np.diag([1e-3, 1e-3, 2e-3]) ** 2, np.diag([1e-4, 1e-4, 1e-4]) ** 2
SPEED = np.array([0.5, 0.0, 0.2])
LAST = 200  # steps of 0.05 s, a scan at every second one, a keyframe every 20


def drive(rng, wheels=lambda i, z: z, scans=lambda i, z: z, gyro=None, moved=None, reading=READING):
    """Events of a drive on a circle, the true poses; wheels, scans change what they say, moved (i, pose) the base."""
    truth = [np.zeros(3)]
    events, key = [PoseClone(0.0, "wheels"), Keyframe(0.0, "lidar")], 0
    for i in range(1, LAST + 1):
        before, now, z = 0.05 * (i - 1), 0.05 * i, se2.exp(0.05 * SPEED)
        x = se2.compose(truth[-1], z)
        if moved is not None and i == moved[0]:
            x = se2.compose(x, moved[1])
        truth.append(x)
        counted = wheels(i, se2.retract(z, np.sqrt(np.diag(STEP)) * rng.normal(size=3)))
        events.append(RelativePoseMeasurement(before, now, counted, STEP, "wheels", reading))
        if gyro is not None:
            events.append(PlanarImu(now, 0.2 + gyro(i) + 0.01 * rng.normal(), None, np.zeros(2), 1e-4))
        if i % 2 == 0:
            seen = se2.retract(se2.between(truth[key], x), np.sqrt(np.diag(SCAN)) * rng.normal(size=3))
            match = RelativePoseMeasurement(0.05 * key, now, scans(i, seen), 2 * SCAN, "lidar", None, SCAN)
            if i % 20 == 0:
                events.append(Keyframe(now, "lidar", match))
                key = i
            else:
                events.append(match)
    return in_order(events), truth


def errors_of(events, truth, config=CONFIG):
    """Distance [m] and turn [rad] from the truth after each event, by step, and the last state."""
    state, errors = init(0.0, np.zeros(3), None, config), np.zeros((LAST + 1, 2))
    for event in events:
        state, _ = step(state, event)
        xi = se2.difference(state.belief.pose, truth[round(event.stamp / 0.05)])
        errors[round(event.stamp / 0.05)] = np.hypot(*xi[:2]), abs(xi[2])
    return errors, state


def test_wheels_that_slip_do_not_carry_the_estimate_off(rng):
    def spinning(i, z):
        return se2.exp(3.0 * se2.log(z)) if 60 <= i < 100 else z

    errors, state = unchecked(errors_of, *drive(rng, wheels=spinning))
    assert errors[:, 0].max() < 0.1
    assert errors[110:, 0].max() < 0.02
    assert np.all(np.isfinite(state.newest.P))


@pytest.mark.parametrize("leads", [True, False])
def test_steps_after_a_slip_are_as_noisy_as_those_that_slipped(leads):
    config = FilterConfig(**(CONFIG.model_dump() | {"coupled_to_wheels": (True, True, leads)}))
    state, _ = steps(init(0.0, np.zeros(3), None, config), [PoseClone(0.0, "wheels"), Keyframe(0.0, "lidar")])
    for i in range(2):
        state, _ = step(state, RelativePoseMeasurement(0.05 * i, 0.05 * i + 0.05, np.zeros(3), STEP, "wheels", READING))
        assert "wheels, steps" not in state.newest.noise
    off = np.array([0.0, 9e-3, 0.0])  # six deviations of two steps
    state, _ = step(state, RelativePoseMeasurement(0.0, 0.1, off, SCAN, "lidar", None, SCAN))
    log = state.newest.noise["wheels, steps"].log
    assert log[0] > 0.5
    assert (log[1] > 0.3) == leads


def test_a_reading_that_hangs_is_passed_over_and_the_next_has_the_whole_way(rng):
    hung = [np.zeros(3)]

    def hanging(i, z):
        if 60 <= i < 76:
            hung[0] = se2.compose(hung[0], z)
            return np.zeros(3)
        return se2.compose(hung[0], z) if i == 76 else z

    events, truth = drive(rng, wheels=hanging)
    errors, state = unchecked(errors_of, events, truth)
    assert errors[:, 0].max() < 0.02
    assert errors[:, 1].max() < 0.02
    assert state.tallies["wheels"].gated == 16
    assert state.tallies["lidar"].inflated == 0


def test_a_base_that_stops_has_stopped(rng):
    def stopping(i, z):
        return se2.exp(se2.log(z) * np.clip(1.0 - 0.1 * (i - 60), 0.0, 1.0))

    events, _ = drive(rng, wheels=stopping)
    state = init(0.0, np.zeros(3), None, CONFIG)
    for event in events:
        if event.source == "wheels" or event.stamp < 0.1:
            state, correction = step(state, event)
            assert correction.status == "used"


def test_wheels_alone_are_believed_whatever_they_say(rng):
    def jerking(i, z):
        return se2.exp(5.0 * se2.log(z)) if i in (60, 61, 90) else z

    events = [event for event in drive(rng, wheels=jerking)[0] if event.source == "wheels"]
    state, _ = unchecked(steps, init(0.0, np.zeros(3), None, CONFIG), events)
    counted = np.zeros(3)
    for event in events[1:]:
        counted = se2.compose(counted, event.pose)
    np.testing.assert_allclose(state.belief.pose, counted, atol=0.002)


def test_a_burst_of_wrong_matches_does_not_carry_the_estimate_off(rng):
    def wild(i, z):
        return z + rng.normal(size=3) * [1.0, 1.0, 0.5] if 60 <= i < 72 else z

    errors, _ = unchecked(errors_of, *drive(rng, scans=wild))
    assert errors[:, 0].max() < 0.3  # where the matches are off by metres
    assert errors[110:, 0].max() < 0.1


def test_a_base_that_was_moved_is_found_again_within_a_second(rng):
    errors, _ = unchecked(errors_of, *drive(rng, moved=(90, np.array([0.8, -0.5, 0.6]))))
    assert errors[89, 0] < 0.02
    assert errors[110:, 0].max() < 0.03
    assert errors[110:, 1].max() < 0.02


def test_a_gyro_whose_bias_jumps_does_not_turn_the_estimate(rng):
    config = FilterConfig(**(CONFIG.model_dump() | {"coupled_to_wheels": (True, True, False)}))
    errors, state = unchecked(
        errors_of, *drive(rng, gyro=lambda i: 0.05 * (i >= 60), reading=np.diag([1e-4, 1e-4, 0.05]) ** 2), config
    )
    assert errors[:, 1].max() < 0.02
    assert state.belief.gyro_bias > 0.0


@pytest.mark.parametrize("felt", [True, False])
def test_a_bump_that_the_accelerometer_feels_turns_the_base_and_a_gyro_that_errs_does_not(felt):
    state = init(0.0, np.zeros(3), None, CONFIG)
    for i in range(100):
        bumped = i >= 80
        push = np.array([15.0, -10.0]) * (felt and 80 <= i < 84)
        imu = PlanarImu(0.01 * i, 2.0 * bumped, push, np.zeros(2), 1e-4, 0.25 * np.eye(2))
        state, _ = step(state, imu)
        if i == 83:
            turns = state.belief.twist[2]
    assert turns > 1.8 if felt else turns < 1.0


@pytest.mark.parametrize("source", ["wheels", "scans"])
def test_nan_is_refused_and_the_estimate_goes_on(rng, source):
    def broken(i, z):
        return z * np.nan if i == 60 else z

    errors, state = unchecked(errors_of, *drive(rng, **{source: broken}))
    assert np.all(np.isfinite(errors))
    assert errors[:, 0].max() < 0.05
    assert state.tallies["wheels" if source == "wheels" else "lidar"].refused >= 1


def test_without_a_gate_nobody_is_blamed(rng):
    config = FilterConfig(**(CONFIG.model_dump() | {"gate_mode": "none"}))
    errors, state = unchecked(errors_of, *drive(rng, moved=(90, np.array([0.8, -0.5, 0.6]))), config)
    assert state.newest.streaks == {}
    assert state.newest.drift == 0.0
    assert np.all(np.isfinite(errors))


def test_a_jump_of_the_gyros_bias_is_found_in_four_headings_and_none_in_white_noise(rng):
    start = init(0.0, np.zeros(3), None, CONFIG).newest

    def first_jump(headings):
        now = start
        for i, innovation in enumerate(headings, 1):
            after = bias_jumps_found(CONFIG, now, innovation, 1e-6)
            if after.P[9, 9] > start.P[9, 9]:
                return i
            now = after
        return None

    assert first_jump(3e-3 * np.ones(20)) == 4
    assert first_jump(-3e-3 * np.ones(20)) == 4
    assert first_jump(1e-3 * rng.standard_normal(20_000)) is None
