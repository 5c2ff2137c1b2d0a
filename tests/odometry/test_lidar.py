"""Keyframed LIDAR odometry on scans cast in a room, a corridor, and nowhere."""

from dataclasses import replace

import numpy as np
import pytest
from room_scans import CORRIDOR, NOWHERE, ROOM, STEP, along, error_of, normalized, scan_at, scans_along

from longreach.geometry import se2, se3, so3
from longreach.measurement import LaserScan
from longreach.odometry.dead_reckoning import integrate
from longreach.odometry.lidar import LidarConfig, init, lidar_odometry, step
from longreach.odometry.matchers.point_to_line import PointToLine
from longreach.sim.room import box, moved


def assert_same(one, other):
    for a, b in zip(one, other, strict=True):
        assert (a.stamp, a.reason, a.rows, a.keyframe) == (b.stamp, b.reason, b.rows, b.keyframe)
        assert (a.measurement is None) == (b.measurement is None)
        if a.measurement is not None:
            np.testing.assert_array_equal(a.measurement.pose, b.measurement.pose)
            np.testing.assert_array_equal(a.measurement.covariance, b.measurement.covariance)
            np.testing.assert_array_equal(a.measurement.shared_covariance, b.measurement.shared_covariance)
            np.testing.assert_array_equal(a.motion, b.motion)


def test_motion_without_noise_is_found_to_a_millimetre():
    poses = along(STEP, 15)
    for match in lidar_odometry(scans_along(poses, beams=720), NOWHERE):
        assert np.abs(error_of(match, poses)).max() < 1e-3
        assert match.measurement.source == "lidar"


@pytest.mark.parametrize("with_priors", [False, True])
def test_scan_by_scan_is_the_same_as_all_at_once(with_priors, rng):
    poses = along(STEP, 14)
    scans = scans_along(poses, rng=rng)
    priors = [None, *(STEP + 0.01 * rng.standard_normal(3) for _ in poses[1:])] if with_priors else None
    state, matches = init(LidarConfig(), NOWHERE), []
    for i, scan in enumerate(scans):
        state, match = step(state, scan, priors[i] if priors else None)
        matches.append(match)
    assert matches[0].measurement is None
    assert matches[0].keyframe
    assert_same(matches[1:], lidar_odometry(scans, NOWHERE, priors=priors))


def test_a_keyframe_stays_until_the_base_is_far_from_all_of_them(rng):
    out = along((0.1, 0.0, 0.0), 15, (-1.5, 0.0, 0.0))
    poses = [*out, *out[-2::-1]]  # there and back
    matches, newest = lidar_odometry(scans_along(poses, rng=rng), NOWHERE), 0.0
    for match in matches:
        assert match.measurement.stamp_reference == newest
        if match.keyframe:
            newest = match.stamp
    there = [match.stamp for match in matches if match.keyframe]
    np.testing.assert_allclose(there, [0.3, 0.6, 0.9, 1.2, 1.5], atol=0.11)
    assert max(there) < 1.55  # on the way back there is a keyframe everywhere


def test_turning_on_the_spot_makes_a_keyframe_every_twenty_degrees(rng):
    poses = along((0.0, 0.0, np.radians(5.0)), 72)
    matches = lidar_odometry(scans_along(poses, rng=rng), NOWHERE)
    assert 11 <= sum(match.keyframe for match in matches) <= 17
    last = matches[-1]
    assert np.abs(error_of(last, poses)).max() < 0.01


def test_the_motion_is_that_since_the_last_scan_whatever_the_keyframe():
    poses = along(STEP, 12)
    for match in lidar_odometry(scans_along(poses), NOWHERE):
        np.testing.assert_allclose(match.motion, STEP, atol=2e-3)


def test_the_covariance_is_that_of_many_noisy_matches(rng):
    poses = along((0.1, 0.02, 0.05), 4)
    values = []
    for _ in range(30):
        for match in lidar_odometry(scans_along(poses, rng=rng), NOWHERE):
            e, P, shared = error_of(match, poses), match.measurement.covariance, match.measurement.shared_covariance
            values.append(e @ np.linalg.solve(P, e))
            assert np.linalg.eigvalsh(P - shared).min() > -1e-12
            assert np.linalg.eigvalsh(shared).min() > -1e-12
    assert 1.5 < np.mean(values) < 5.0


def test_along_a_corridor_nothing_is_known_and_across_it_much(rng):
    poses = along((0.05, 0.0, 0.0), 6, (0.0, 0.0, 0.0))
    scans = [replace(scan, range_max=15.0) for scan in scans_along(poses, walls=CORRIDOR, rng=rng)]
    for match in lidar_odometry(scans, NOWHERE, priors=[np.array([0.05, 0.0, 0.0])] * 7):
        assert len(match.degenerate) == 1
        assert abs(match.degenerate[0, 0]) > 0.99
        P = match.measurement.covariance
        assert np.sqrt(P[0, 0]) > 0.05
        assert np.sqrt(P[1, 1]) < 0.01
        assert np.sqrt(P[2, 2]) < 0.01
        assert abs(error_of(match, poses)[1]) < 0.01


def test_along_a_corridor_the_deviation_of_the_path_grows_with_time_from_keyframe_to_keyframe(rng):
    poses = along(np.array([0.05, 0.0, 0.0]), 60, start=(0.0, 0.0, 0.0))
    scans = [replace(scan, range_max=15.0) for scan in scans_along(poses, walls=CORRIDOR, rng=rng)]
    matches = lidar_odometry(scans, NOWHERE)
    assert sum(match.keyframe for match in matches) > 2
    path = integrate([match.measurement for match in matches], [scan.stamp for scan in scans])
    sigma, time = np.sqrt(path.covariance[:, 0, 0]), path.stamps - path.stamps[0]
    np.testing.assert_allclose(sigma, LidarConfig().speed * time, rtol=0.05, atol=0.02)


def test_one_wall_shows_the_distance_to_it_alone(rng):
    wall = np.array([[-3.0, 2.0, 3.0, 2.0]])
    poses = along((0.0, 0.04, 0.0), 3, (0.0, 0.0, 0.0))
    for match in lidar_odometry(scans_along(poses, walls=wall, rng=rng), NOWHERE):
        if match.measurement is not None:
            P = match.measurement.covariance
            assert np.isfinite(P).all()
            assert P[1, 1] < 0.05**2 < P[0, 0]


@pytest.mark.parametrize("nothing", [0.0, np.inf, np.nan])
def test_a_scan_that_sees_nothing_is_no_match_with_a_reason(nothing):
    scans = scans_along(along(STEP, 6))
    for i in (2, 3, 4):
        scans[i] = LaserScan(0.1 * i, np.full(360, nothing), scans[0].angle_min, scans[0].angle_increment)
    matches = lidar_odometry(scans, NOWHERE)
    assert all(m.measurement is None and "0 beams" in m.reason for m in matches[1:4])
    assert matches[0].measurement is not None
    assert matches[5].measurement is not None
    assert all(m.measurement is None for m in lidar_odometry(scans[2:5], NOWHERE))


@pytest.mark.parametrize("hole", [0.0, np.inf, np.nan])
def test_beams_without_return_take_no_part(hole, rng):
    poses, scans = along(STEP, 4), []
    for scan in scans_along(poses):
        ranges = np.where(rng.random(360) < 0.2, hole, scan.ranges)
        scans.append(LaserScan(scan.stamp, ranges, scan.angle_min, scan.angle_increment))
    for match in lidar_odometry(scans, NOWHERE):
        assert np.abs(error_of(match, poses)).max() < 5e-3
        assert np.isfinite(match.measurement.covariance).all()


def test_identical_scans_are_no_motion_with_a_definite_covariance():
    for match in lidar_odometry(scans_along(along(np.zeros(3), 3)), NOWHERE):
        np.testing.assert_allclose(match.measurement.pose, 0.0, atol=2e-4)
        assert np.linalg.eigvalsh(match.measurement.covariance).min() > 0


@pytest.mark.parametrize("noisy", [False, True])
def test_two_kinds_of_scans_in_turn_keep_one_map(noisy, rng):
    poses = along(STEP, 9)
    scans = [
        scan_at(pose, 0.1 * i, beams=(360, 500)[i % 2], rng=rng if noisy else None) for i, pose in enumerate(poses)
    ]
    matches = lidar_odometry(scans, NOWHERE)
    newest = 0.0
    for match in matches:
        assert np.abs(error_of(match, poses)).max() < 1e-2
        assert match.measurement.stamp_reference == newest
        newest = match.stamp if match.keyframe else newest


def test_two_lasers_that_look_forwards_and_backwards_keep_one_map(rng):
    poses, scans = along(STEP, 12), []
    for i, pose in enumerate(poses):
        seen = scan_at(
            se2.compose(pose, np.array([0.0, 0.0, np.pi * (i % 2)])), 0.1 * i, fov=1.5 * np.pi, beams=271, rng=rng
        )
        scans.append(replace(seen, angle_min=seen.angle_min + np.pi * (i % 2)))
    matches = lidar_odometry(scans, NOWHERE)
    found = [match for match in matches if match.measurement is not None]
    assert len(found) == len(matches)
    for match in found:
        assert np.abs(error_of(match, poses)).max() < 2e-2


@pytest.mark.parametrize("part", [0.7, 1.3])
def test_a_prior_that_is_wrong_by_a_third_ends_within_the_deviation_of_the_match(part, rng):
    motion = np.array([0.2, 0.0, 0.1])
    scans = scans_along(along(motion, 1), rng=rng)
    right, wrong = (lidar_odometry(scans, NOWHERE, priors=[None, f * motion])[0].measurement for f in (1.0, part))
    assert normalized(se2.difference(right.pose, wrong.pose), right.covariance) < 1.0


@pytest.mark.parametrize("turn", [14.0, -14.0])
def test_wheels_that_stand_still_while_the_base_turns_between_sparse_scans_do_not_move_the_match(turn, rng):
    poses = along((0.0, 0.0, np.radians(turn)), 8)
    scans = [replace(scan, stamp=10 * scan.stamp) for scan in scans_along(poses, beams=181, rng=rng)]
    still = lidar_odometry(scans, NOWHERE, priors=[None, *[np.zeros(3)] * 8])
    known = lidar_odometry(scans, NOWHERE, priors=[None, *[np.array([0.0, 0.0, np.radians(turn)])] * 8])
    for i, (a, b) in enumerate(zip(still, known, strict=True), 1):
        reference = round(a.measurement.stamp_reference)
        assert reference == round(b.measurement.stamp_reference)
        error = se2.difference(a.measurement.pose, se2.between(poses[reference], poses[i]))
        assert normalized(error, a.measurement.covariance) < 16.0
        assert normalized(se2.difference(a.measurement.pose, b.measurement.pose), b.measurement.covariance) < 2.0


def test_a_prior_that_is_not_finite_is_as_good_as_none():
    scans = scans_along(along(STEP, 3))
    assert_same(lidar_odometry(scans, NOWHERE, priors=[np.full(3, np.nan)] * 4), lidar_odometry(scans, NOWHERE))


@pytest.mark.parametrize("roll", [0.0, np.pi])
@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_laser_upside_down_or_clockwise_gives_the_motion_of_the_base(roll, sense):
    T = se3.from_rotation_translation(so3.from_roll_pitch_yaw(roll, 0.0, 0.3), np.array([0.2, 0.1, 0.3]))
    poses, scans = along(STEP, 3), []
    for i, pose in enumerate(poses):
        upright = -1.0 if roll else 1.0  # what it calls angle α lies at -α in the plane
        seen = scan_at(se2.compose(pose, np.array([0.2, 0.1, 0.3])), 0.1 * i, sense=sense * upright)
        scans.append(LaserScan(seen.stamp, seen.ranges, upright * seen.angle_min, upright * seen.angle_increment))
    for match in lidar_odometry(scans, T):
        assert np.abs(error_of(match, poses)).max() < 3e-3


def test_a_scan_of_seven_beams_is_no_match_and_leaves_the_state():
    state, _ = step(init(LidarConfig(), NOWHERE), scan_at(np.zeros(3)))
    after, match = step(state, scan_at(np.zeros(3), 0.1, beams=7))
    assert after is state
    assert match.measurement is None
    assert "7 beams" in match.reason


@pytest.mark.parametrize("jump", [(1.5, 0.0, 0.0), (0.0, 0.0, 1.5), (-0.7, 1.0, 0.8)], ids=str)
def test_wheels_that_jump_do_not_take_the_match_along(jump, rng):
    poses = along(STEP, 12)
    priors = [None, *[STEP] * 12]
    priors[7] = se2.compose(STEP, np.array(jump))
    for match in lidar_odometry(scans_along(poses, rng=rng), NOWHERE, priors=priors):
        assert np.abs(error_of(match, poses)).max() < 0.01


def test_a_first_scan_that_sees_nothing_is_no_keyframe_and_the_next_one_is():
    scans = scans_along(along(STEP, 3))
    scans[0] = replace(scans[0], ranges=np.zeros(360))
    state, first = step(init(LidarConfig(), NOWHERE), scans[0])
    assert (first.measurement, first.keyframe, first.reason) == (None, False, "only 0 beams see something")
    assert state.reference is None
    state, second = step(state, scans[1])
    assert (second.measurement, second.keyframe) == (None, True)
    _, third = step(state, scans[2])
    assert third.measurement.stamp_reference == scans[1].stamp


def test_after_a_blind_spell_the_same_map_is_used_without_a_jump(rng):
    poses = along((0.06, 0.0, 0.04), 30, (-1.5, -0.5, 0.2))
    scans = scans_along(poses, rng=rng)
    for i in range(10, 20):
        scans[i] = replace(scans[i], ranges=np.full(360, np.inf))
    priors = [None, *[np.array([0.06, 0.0, 0.04]) * 1.05] * 30]
    matches = lidar_odometry(scans, NOWHERE, priors=priors)
    assert [match.measurement is None for match in matches] == [10 <= i < 20 for i in range(1, 31)]
    assert not any(match.keyframe for match in matches[9:19])
    after = matches[19]
    assert after.measurement.stamp_reference < 1.0
    for match in matches[19:]:
        assert np.abs(error_of(match, poses)).max() < 0.01


def test_a_scan_elsewhere_fails_and_the_second_in_a_row_starts_a_new_map(rng):
    here, there = along(STEP, 3), along(STEP, 4, (40.0, 0.0, 0.0))
    walls = moved(ROOM, 40.0, 0.0)
    scans = [scan_at(p, 0.1 * i, rng=rng) for i, p in enumerate(here)]
    state = init(LidarConfig(), NOWHERE)
    for scan in scans:
        state, match = step(state, scan)
    assert match.measurement is not None
    mapped, odd = state.reference, box(0.0, 0.0, 1.0, 0.7, 0.4)
    state, one = step(state, scan_at(np.zeros(3), 0.4, walls=odd, rng=rng))
    assert (one.measurement, one.keyframe) == (None, False)
    assert one.reason
    assert state.reference is mapped
    state, two = step(state, scan_at(np.zeros(3), 0.5, walls=odd, rng=rng))
    assert (two.measurement, two.keyframe) == (None, True)
    assert len(state.reference.keyframes) == 1
    assert state.lost == 0
    for i, pose in enumerate(there):
        state, match = step(state, scan_at(pose, 0.6 + 0.1 * i, walls=walls, rng=rng))
    assert match.measurement is not None


def test_one_scan_that_fails_is_forgotten_after_the_next_match(rng):
    poses = along(STEP, 9)
    scans = scans_along(poses, rng=rng)
    odd = box(0.0, 0.0, 1.0, 0.7, 0.4)
    for i in (3, 5, 7):
        scans[i] = scan_at(np.zeros(3), 0.1 * i, walls=odd, rng=rng)
    matches = lidar_odometry(scans, NOWHERE)
    assert [match.measurement is None for match in matches] == [i in (3, 5, 7) for i in range(1, 10)]
    for match in matches:
        if match.measurement is not None:
            assert np.abs(error_of(match, poses)).max() < 0.01


def test_a_long_drive_keeps_a_bounded_map_and_drifts_little(unchecked):
    angle = 2 * np.pi * np.arange(240) / 120
    poses = [np.array([1.4 * np.cos(a), 1.2 * np.sin(a) - 0.3, a + np.pi / 2]) for a in angle]
    rng = np.random.default_rng(5)
    state, path, worst = init(LidarConfig(), NOWHERE), [np.zeros(3)], 0.0
    keyframes = {0.0: poses[0]}
    for i, pose in enumerate(poses):
        state, match = step(state, scan_at(pose, 0.1 * i, rng=rng))
        if match.measurement is not None:
            at = se2.compose(keyframes[match.measurement.stamp_reference], match.measurement.pose)
            worst = max(worst, np.abs(se2.difference(at, pose)).max())
            path.append(at)
            if match.keyframe:
                keyframes[match.stamp] = at
        assert len(state.reference.keyframes) <= 40
    assert len(path) == 240
    assert worst < 0.01


@pytest.mark.parametrize("again", [0.0, -0.05])
def test_a_stamp_that_does_not_go_on_gives_finite_numbers(again, rng):
    poses = along(STEP, 4)
    scans = scans_along(poses, rng=rng)
    scans[2] = replace(scans[2], stamp=scans[1].stamp + again)
    for match in lidar_odometry(scans, NOWHERE):
        assert np.isfinite(match.measurement.pose).all()
        assert np.isfinite(match.measurement.covariance).all()


def test_rounded_ranges_without_noise_give_finite_matches_that_are_right():
    poses = along((0.05, 0.0, 0.04), 12)
    scans = [replace(s, ranges=0.01 * np.round(100 * s.ranges)) for s in scans_along(poses)]
    for match in lidar_odometry(scans, NOWHERE):
        assert np.isfinite(match.measurement.covariance).all()
        assert np.linalg.eigvalsh(match.measurement.covariance).min() > 0.0
        assert np.abs(error_of(match, poses)).max() < 0.01


def test_the_error_of_a_keyframe_is_shared_by_the_matches_to_it(rng):
    poses = along((0.1, 0.02, 0.05), 12)
    matches = lidar_odometry(scans_along(poses, rng=rng), NOWHERE)
    first = [m.measurement for m in matches if m.measurement.stamp_reference == 0.0]
    later = [m.measurement for m in matches if m.measurement.stamp_reference > 0.0]
    assert len(first) >= 2 <= len(later)
    for measurement in (*first, *later):
        P, shared = measurement.covariance, measurement.shared_covariance
        assert np.linalg.eigvalsh(P - shared).min() > 0.0
    share = [np.trace(m.shared_covariance) / np.trace(m.covariance) for m in (first[0], later[0])]
    assert share[1] > share[0]


def test_what_a_keyframe_in_a_corridor_does_not_show_is_no_error_of_the_next_matches(rng):
    poses = along((0.05, 0.0, 0.0), 20, (0.0, 0.0, 0.0))
    scans = [replace(scan, range_max=15.0) for scan in scans_along(poses, walls=CORRIDOR, rng=rng)]
    matches = lidar_odometry(scans, NOWHERE)
    keys = [match for match in matches if match.keyframe]
    after = [m for m in matches if m.measurement.stamp_reference == keys[0].stamp]
    assert keys[0].measurement.covariance[0, 0] > 0.1
    assert after[0].measurement.shared_covariance[0, 0] < 1e-3
    np.testing.assert_allclose(
        after[0].measurement.covariance[0, 0], after[0].stamp ** 2 - keys[0].stamp ** 2, rtol=0.05
    )


@pytest.mark.parametrize("moved_by", [(2.0, 0.0, 0.0), (0.0, 0.0, 1.5)], ids=str)
def test_a_match_that_moves_the_base_faster_than_a_base_moves_is_none(moved_by, rng):
    class Jumping(PointToLine):
        def match(self, features, reference, geometry, prior):
            fit = super().match(features, reference, geometry, prior)
            return replace(fit, pose=se2.compose(fit.pose, np.array(moved_by)))

    first, second = scans_along(along(STEP, 1), rng=rng)
    state, _ = step(init(LidarConfig(), NOWHERE), first)
    matcher = state.matcher
    jumping = Jumping(matcher.settings, matcher.distance, matcher.turned, matcher.overlap)
    after, match = step(state._replace(matcher=jumping), second)
    assert match.measurement is None
    assert "faster" in match.reason
    np.testing.assert_allclose(after.pose, 0.0, atol=1e-12)  # the prior: it has not moved so far


def test_after_a_scan_without_a_match_the_base_may_have_moved_in_all_the_time_since(rng):
    turned = np.array([0.0, 0.0, 1.2])
    poses = [*along(np.zeros(3), 4), se2.compose(np.array([-1.0, -0.5, 0.2]), turned)]
    state = init(LidarConfig(), NOWHERE)
    for i, pose in enumerate(poses[:4]):
        state, _ = step(state, scan_at(pose, 0.1 * i, rng=rng))
    odd = box(0.0, 0.0, 1.0, 0.7, 0.4)
    state, match = step(state, scan_at(np.zeros(3), 3.4, walls=odd, rng=rng), np.zeros(3))
    assert match.measurement is None
    state, match = step(state, scan_at(poses[-1], 3.5, rng=rng), 0.9 * turned)
    assert match.measurement is not None
    assert np.abs(se2.difference(se2.compose(poses[0], state.pose), poses[-1])).max() < 0.01


@pytest.mark.parametrize(("share", "wide"), [(0.35, True), (0.2, False)])
def test_where_wheels_and_the_last_motion_give_two_fits_the_better_one_is_as_wrong_as_they_are_apart(share, wide, rng):
    class Ambiguous(PointToLine):
        def match(self, features, reference, geometry, prior):
            fit = super().match(features, reference, geometry, prior._replace(pose=np.zeros(3)))
            by_wheels = abs(prior.pose[2]) > 0.4
            return replace(fit, pose=np.array(prior.pose), inlier_ratio=share if by_wheels else 0.45)

    first, second = scans_along(along(np.zeros(3), 1), rng=rng)
    state, _ = step(init(LidarConfig(), NOWHERE), first)
    matcher = state.matcher
    ambiguous = Ambiguous(matcher.settings, matcher.distance, matcher.turned, matcher.overlap)
    _, match = step(state._replace(matcher=ambiguous), second, np.array([0.0, 0.0, 0.5]))
    np.testing.assert_allclose(match.measurement.pose, 0.0, atol=1e-9)
    deviation = np.sqrt(match.measurement.covariance[2, 2])
    assert deviation == pytest.approx(0.5, abs=0.01) if wide else deviation < 0.01


def test_motions_stay_relative_to_a_keyframe_that_is_better_than_the_next_ones_for_a_second(rng):
    class Bumped(PointToLine):
        def match(self, features, reference, geometry, prior):
            fit = super().match(features, reference, geometry, prior)
            return replace(fit, covariance=fit.covariance + np.diag([1e-4, 1e-4, 1e-4]))

    poses = along((0.06, 0.0, 0.02), 40, (-1.2, -0.5, 0.2))
    state, kept = init(LidarConfig(), NOWHERE), []
    for i, scan in enumerate(scans_along(poses, rng=rng)):
        if i == 12:
            good, matcher = state.keyframe, state.matcher
            bumped = Bumped(matcher.settings, matcher.distance, matcher.turned, matcher.overlap)
            state = state._replace(matcher=bumped)
        state, _ = step(state, scan, np.array([0.06, 0.0, 0.02]))
        kept.append(state.keyframe)
    assert len(state.reference.keyframes) > 5
    held = sum(stamp == good for stamp in kept[12:])
    assert 5 <= held <= 10
    assert kept[-1] > good


def test_with_wheels_along_a_corridor_the_walls_show_more_of_the_heading_and_across(rng):
    """Without them the base may be anywhere along it, and surfaces whose directions are wrong make that an error."""
    poses = along((0.05, 0.0, 0.0), 100, (0.0, 0.0, 0.0))
    scans = [replace(scan, range_max=15.0) for scan in scans_along(poses, walls=CORRIDOR, rng=rng)]
    priors = [np.array([0.05, 0.0, 0.0])] * len(scans)
    alone, wheeled = (
        np.sqrt([np.diag(m.measurement.covariance) for m in lidar_odometry(scans, NOWHERE, priors=some)])
        for some in (None, priors)
    )
    assert np.all(np.median(wheeled[50:, 1:], axis=0) < 0.65 * np.median(alone[50:, 1:], axis=0))
    assert np.median(wheeled[50:, 0]) > 0.1  # which wheels must not be taken for information of the scan's
