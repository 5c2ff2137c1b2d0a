"""One program for logs and robots: in whatever portions and however late readings come, the same settled rows."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arrivals import late, readings_of, same_rows, settled_rows

import longreach
from longreach.app.configuration import EstimateConfig, EvaluationConfig
from longreach.app.estimate import estimate
from longreach.estimation.planar.config import FilterConfig
from longreach.geometry import se2
from longreach.io.config import load_description
from longreach.localization import localizer
from longreach.localization.config import LocalizerConfig
from longreach.localization.localizer import Localizer
from longreach.measurement import Odometry, PoseMeasurement
from longreach.sim.kinematic import make_recording

pytestmark = pytest.mark.usefixtures("unchecked")
IN_ONE_WORLD = EstimateConfig(evaluation=EvaluationConfig(align="none"))
LATENCY = {"wheels": 0.002, "scans": 0.03, "imu": 0.004, "fixes": 0.1}


@pytest.fixture(scope="module")
def thing():
    return load_description("thing")


@pytest.fixture(scope="module")
def recording(thing):
    """4 s of driving, with fixes in a frame of their own."""
    made = make_recording(thing, seed=1, duration=4.0, lidar_rate=20.0, beams=180)
    P = np.diag([0.01, 0.01, 0.02]) ** 2
    moved = [se2.compose(np.array([5.0, -2.0, 1.0]), pose) for pose in made.truth.poses[::25]]
    stamps = made.truth.clock[::25].tolist()
    return made.replace(fixes=tuple(PoseMeasurement(t, p, P, "fixes") for t, p in zip(stamps, moved, strict=True)))


@pytest.fixture(scope="module")
def rows(thing, recording):
    """What one reading at a time gives, in the order of stamps: rows in odom and on the map."""
    return settled_rows(localizer.init(thing), [[reading] for reading in readings_of(recording)])


@pytest.mark.parametrize("size", [7, 100, 10_000])
def test_blocks_of_any_size_give_the_rows_of_one_reading_at_a_time(thing, recording, rows, size):
    readings = readings_of(recording)
    blocks = [readings[i : i + size] for i in range(0, len(readings), size)]
    assert same_rows(settled_rows(localizer.init(thing), blocks), rows)


@pytest.mark.parametrize("tick", [0.008, 0.1, 1.0])
def test_a_robot_that_reads_tick_by_tick_gets_the_same_rows(thing, recording, rows, tick):
    arriving = sorted((reading.stamp + LATENCY[kind], i) for i, (kind, reading) in enumerate(_by_kind(recording)))
    order = [reading for _, reading in _by_kind(recording)]
    ticks = {}
    for when, i in arriving:
        ticks.setdefault(int(when // tick), []).append(order[i])
    assert same_rows(settled_rows(localizer.init(thing), ticks.values()), rows)


def test_readings_up_to_the_history_late_give_the_same_rows(thing, recording, rows, rng):
    arriving = late(readings_of(recording), rng, 0.49)
    assert [r.stamp for r in arriving] != sorted(r.stamp for r in arriving)
    assert same_rows(settled_rows(localizer.init(thing), [[reading] for reading in arriving]), rows)


def test_an_estimate_of_the_recording_has_the_same_rows(thing, recording, rows):
    made = estimate(recording, thing, IN_ONE_WORLD).trajectories
    for name, expected in zip(("fused", "localized"), rows, strict=True):
        of = {row.stamp: row for row in expected}
        assert len(made[name]) > 100
        for stamp, pose, covariance in zip(
            made[name].clock.tolist(), made[name].poses, made[name].covariance, strict=True
        ):
            np.testing.assert_array_equal(of[stamp].pose, pose)
            np.testing.assert_array_equal(of[stamp].covariance, covariance)


def test_fixes_move_the_map_and_leave_odom_alone(thing, recording, rows):
    without = settled_rows(localizer.init(thing), [readings_of(recording.replace(fixes=()))])
    assert same_rows((without[0], []), (rows[0], []))
    assert without[1] == []
    truth, _ = recording.truth.at(np.array([row.stamp for row in rows[1]]))
    expected = se2.compose(np.array([5.0, -2.0, 1.0]), truth)
    assert max(np.hypot(*(row.pose - pose)[:2]) for row, pose in zip(rows[1], expected, strict=True)) < 0.05


@pytest.mark.parametrize("heading", [True, False])
def test_first_fixes_that_are_not_finite_are_refused_and_the_next_ones_place_the_map(thing, recording, rows, heading):
    P = np.diag([1e-4, 1e-4, 4e-4 if heading else np.inf])
    good = [replace(fix, covariance=P) for fix in recording.fixes]
    nan = np.full(3, np.nan)
    bad = [
        replace(good[0], pose=nan),
        replace(good[0], covariance=np.full((3, 3), np.nan)),
        replace(good[0], covariance=np.diag([np.inf] * 3)),
    ]
    state, output = localizer.step(localizer.init(thing), readings_of(recording.replace(fixes=(*bad, *good))))
    assert sum(c.status == "refused" for c in output.corrections) == 3
    assert np.isfinite(state.belief_on_map().pose).all()
    np.testing.assert_allclose(state.belief_on_map().pose, rows[1][-1].pose, atol=0.05)


def test_a_fix_makes_a_row_on_the_map_and_none_in_odom(thing, recording):
    fixes = [replace(fix, stamp=fix.stamp + 0.0031) for fix in recording.fixes]
    odom, on_map = settled_rows(localizer.init(thing), [readings_of(recording.replace(fixes=tuple(fixes)))])
    stamps = {fix.stamp for fix in fixes if fix.stamp < recording.wheels[-1].stamp}
    assert not stamps & {row.stamp for row in odom}
    assert stamps <= {row.stamp for row in on_map}


def test_a_start_that_is_known_is_where_both_frames_begin(thing, recording):
    start, on_map = np.array([1.0, 2.0, 0.5]), (np.array([3.0, -1.0, 2.0]), np.diag([0.01, 0.02, 0.03]))
    state = localizer.init(thing, None, start, on_map)
    np.testing.assert_array_equal(state.belief(3.0).pose, start)
    state, _ = localizer.step(state, recording.wheels[:1])
    np.testing.assert_array_equal(state.belief().pose, start)
    np.testing.assert_array_equal(state.belief_on_map().pose, on_map[0])
    np.testing.assert_allclose(state.belief_on_map().covariance[:3, :3], on_map[1], atol=1e-15)


def test_the_belief_goes_ahead_of_the_newest_measurement_and_grows_less_sure(thing, recording):
    state, _ = localizer.step(localizer.init(thing), recording.wheels)
    near, far = state.belief(state.stamp + 0.01), state.belief(state.stamp + 0.1)
    assert far.stamp == pytest.approx(state.stamp + 0.1)
    assert np.all(np.diag(far.covariance)[:3] > np.diag(near.covariance)[:3])


def test_nothing_read_changes_nothing(thing):
    state = localizer.init(thing)
    after, output = localizer.step(state, [])
    assert after.buffer.entries == state.buffer.entries
    assert output == ([], [], [], [], [])


def test_what_is_later_than_the_history_is_refused_counted_and_changes_nothing(thing, recording):
    state, _ = localizer.step(localizer.init(thing), recording.wheels[:100])
    after, output = localizer.step(state, recording.imu[:1])
    assert [(c.source, c.status) for c in output.corrections] == [("imu", "refused")]
    assert "too late" in output.corrections[0].reason
    assert after.tallies["imu"].refused == 1
    assert after.buffer.entries == state.buffer.entries


def test_one_stamp_from_another_century_is_refused_and_a_pause_of_an_hour_is_not(thing, recording):
    wheels = recording.wheels
    state, _ = localizer.step(localizer.init(thing), wheels[:50])
    state, output = localizer.step(state, [replace(wheels[50], stamp=4e9), *wheels[51:60]])
    assert [c.status for c in output.corrections].count("refused") == 1
    assert state.stamp == wheels[59].stamp
    resumed = [replace(wheel, stamp=wheel.stamp + 3600.0) for wheel in wheels[60:120]]
    state, output = localizer.step(state, resumed)
    assert state.stamp == resumed[-1].stamp
    assert not [c for c in output.corrections if c.status == "refused"]  # nothing of it is lost


@pytest.mark.parametrize("kind", ["imu", "wheels", "scans"])
def test_a_first_stamp_of_another_clock_is_left_behind_when_the_others_confirm_theirs(thing, recording, rows, kind):
    one = replace(getattr(recording, kind)[0], stamp=-1e9)
    state, output = localizer.step(localizer.init(thing), [one, *readings_of(recording)])
    left = [row for row in [*output.rows, *localizer.settled(state).rows] if row.stamp >= 0.0]
    assert same_rows((left, []), (rows[0], []))


def test_the_rhythm_of_the_scans_shows_how_wrong_stamps_are(thing, rng):
    stamps = np.arange(0.0, 40.0, 0.1) + 0.01 * rng.normal(size=400)
    wheels = [Odometry(float(stamp), pose=np.zeros(3)) for stamp in np.sort(stamps)]
    state, _ = localizer.step(localizer.init(thing), wheels)
    assert state.now.settings.stamp_deviation == pytest.approx(0.01, rel=0.4)
    given = LocalizerConfig(filter=FilterConfig(stamp_deviation=0.0))
    state, _ = localizer.step(localizer.init(thing, given), wheels)
    assert state.now.settings.stamp_deviation == 0.0


@pytest.mark.parametrize("offset", [0.0, 1.7e9])
@pytest.mark.parametrize("period", [0.013, 0.1, 1.0])
def test_stamps_in_an_even_rhythm_are_not_off(offset, period):
    assert localizer.stamp_deviation(offset + period * np.arange(50)) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("sigma", [1e-4, 1e-3, 1e-2])
def test_stamps_off_a_rhythm_are_found_to_be_so_by_as_much(rng, sigma):
    stamps = 0.2 * np.arange(5000) + sigma * rng.normal(size=5000)
    assert localizer.stamp_deviation(stamps) == pytest.approx(sigma, rel=0.1)
    paused = stamps + 100.0 * (np.arange(5000) > 2500)
    assert localizer.stamp_deviation(paused) == pytest.approx(localizer.stamp_deviation(stamps), rel=0.01)


def test_messages_that_are_held_up_and_come_all_at_once_have_bad_stamps():
    held = np.concatenate([i + 0.001 * np.arange(13) for i in range(15)])
    assert 0.01 < localizer.stamp_deviation(held) < 0.3  # their median is 0


@pytest.mark.parametrize("n", range(5))
def test_too_few_stamps_have_no_rhythm(n):
    assert localizer.stamp_deviation(np.array([0.0, 5.0, 6.0, 9.0])[:n]) == 0.0


def test_the_heading_is_coupled_to_the_wheels_while_no_gyro_is_there(thing, recording):
    coupled, seen = [], localizer.init(thing)
    for reading in readings_of(recording.replace(scans=(), fixes=(), imu=recording.imu[100:200])):
        seen, _ = localizer.step(seen, [reading])
        coupled.append((reading.stamp, seen.now.settings.coupled_to_wheels))
    begun, ended = recording.imu[100].stamp, recording.imu[199].stamp
    assert {c for t, c in coupled if 0.1 < t < begun} == {(True, True, True)}
    assert {c for t, c in coupled if begun + 0.1 < t < ended + 0.9} == {(True, True, False)}
    assert {c for t, c in coupled if t > ended + 1.1} == {(True, True, True)}


@pytest.mark.parametrize("seed", [3, 4])
def test_after_a_blind_spell_scans_are_looked_for_where_the_gyro_and_not_where_slipping_wheels_say(thing, seed):
    made = make_recording(thing, seed=seed, duration=6.0, lidar_rate=20.0, beams=180)
    scans = [replace(s, ranges=np.zeros_like(s.ranges)) if 2.0 <= s.stamp < 4.0 else s for s in made.scans]
    spun, wheels = np.zeros(4), []
    for record in made.wheels:
        if 2.0 <= record.stamp < 4.0:
            spun = spun + 0.2 * np.array([-1.0, -1.0, 1.0, 1.0])  # 10 rad/s, as in a turn to the left
        wheels.append(replace(record, ticks=record.ticks + spun))
    rows, _ = settled_rows(localizer.init(thing), [readings_of(made.replace(scans=tuple(scans), wheels=tuple(wheels)))])
    found = se2.between(rows[0].pose, rows[-1].pose)
    true = se2.between(*(made.truth.at(np.array([row.stamp]))[0][0] for row in (rows[0], rows[-1])))
    assert np.abs(se2.difference(true, found)).max() < 0.005


def test_sources_that_are_not_fused_are_not_taken(thing, recording):
    state, output = localizer.step(localizer.init(thing, LocalizerConfig(sources=("wheels",))), readings_of(recording))
    assert set(state.tallies) == {"wheels"}
    assert output.matches == []


def test_an_object_with_a_state_of_its_own_does_the_same(thing, recording, rows):
    one, given = Localizer(thing), []
    for reading in readings_of(recording):
        given += one.step(reading).rows
    assert same_rows((given, []), (rows[0][: len(given)], []))
    np.testing.assert_array_equal(one.belief().pose, rows[0][-1].pose)
    np.testing.assert_array_equal(one.belief_on_map().pose, rows[1][-1].pose)


def test_one_step_enters_at_most_20_files_of_the_package(thing, recording):
    readings = readings_of(recording)
    state, _ = localizer.step(localizer.init(thing), readings[:-40])
    entered, package = set(), str(Path(longreach.__file__).parent)

    def watch(frame, event, _):
        name = frame.f_code.co_filename
        if event == "call" and name.startswith(package) and not name.endswith("kernels.py"):
            entered.add(name)

    sys.setprofile(watch)
    try:
        localizer.step(state, readings[-40:])
    finally:
        sys.setprofile(None)
    assert {type(reading).__name__ for reading in readings[-40:]} >= {"LaserScan", "WheelTicks", "Imu"}
    assert 8 < len(entered) <= 20, sorted(entered)


def _by_kind(recording):
    return [(kind, reading) for kind in LATENCY for reading in getattr(recording, kind)]
