"""Keyframed LIDAR odometry on scans cast in a room, a corridor, and nowhere."""

from dataclasses import replace

import numpy as np
import pytest
from room_scans import CORRIDOR, NOWHERE, ROOM, STEP, along, error_of, scan_at, scans_along

from longreach.geometry import se2, se3, so3
from longreach.measurement import LaserScan
from longreach.odometry.dead_reckoning import integrate
from longreach.odometry.lidar import LidarConfig, init, lidar_odometry, step
from longreach.sim.room import cast


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


@pytest.mark.parametrize("guided", [False, True])
def test_scan_by_scan_is_the_same_as_all_at_once(guided, rng):
    poses = along(STEP, 14)
    scans = scans_along(poses, rng=rng)
    guides = [None, *(STEP + 0.01 * rng.standard_normal(3) for _ in poses[1:])] if guided else None
    state, matches = init(LidarConfig(), NOWHERE), []
    for i, scan in enumerate(scans):
        state, match = step(state, scan, guides[i] if guides else None)
        matches.append(match)
    assert matches[0].measurement is None
    assert matches[0].keyframe
    assert_same(matches[1:], lidar_odometry(scans, NOWHERE, guides=guides))


def test_a_keyframe_stays_until_the_base_is_far_from_it(rng):
    poses = along((0.1, 0.0, 0.0), 20, (-1.5, 0.0, 0.0))
    reference, keyframes = 0.0, 0
    for match in lidar_odometry(scans_along(poses, rng=rng), NOWHERE):
        assert match.measurement.stamp_reference == reference
        far = np.hypot(*match.measurement.pose[:2])
        assert match.keyframe == (far > LidarConfig().distance)
        if match.keyframe:
            reference, keyframes = match.stamp, keyframes + 1
    assert keyframes == 2


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


def test_along_a_corridor_nothing_is_told_and_across_it_much(rng):
    poses = along((0.05, 0.0, 0.0), 6, (0.0, 0.0, 0.0))
    scans = [replace(scan, range_max=15.0) for scan in scans_along(poses, walls=CORRIDOR, rng=rng)]
    for match in lidar_odometry(scans, NOWHERE, guides=[np.array([0.05, 0.0, 0.0])] * 7):
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


def test_one_wall_tells_the_distance_to_it_alone(rng):
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
        np.testing.assert_allclose(match.measurement.pose, 0.0, atol=2e-5)
        assert np.linalg.eigvalsh(match.measurement.covariance).min() > 0


@pytest.mark.parametrize("noisy", [False, True])
def test_two_kinds_of_scans_in_turn_both_give_matches(noisy, rng):
    poses = along(STEP, 9)
    scans = [
        scan_at(pose, 0.1 * i, beams=(360, 500)[i % 2], rng=rng if noisy else None) for i, pose in enumerate(poses)
    ]
    matches = lidar_odometry(scans, NOWHERE)
    assert matches[0].measurement is None
    assert "first of its kind" in matches[0].reason
    for i, match in enumerate(matches[1:], 2):
        assert np.abs(error_of(match, poses)).max() < 2e-2
        assert match.measurement.stamp_reference == pytest.approx(0.1 * (i % 2))


def test_a_guide_that_is_wrong_by_a_third_ends_at_the_same_pose(rng):
    scans = scans_along(along((0.2, 0.0, 0.1), 1), rng=rng)
    ends = [
        lidar_odometry(scans, NOWHERE, guides=[None, f * np.array([0.2, 0.0, 0.1])])[0].measurement.pose
        for f in (0.7, 1.0, 1.3)
    ]
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-4)  # a tenth of what the noise does to it
    np.testing.assert_allclose(ends[2], ends[1], atol=1e-4)


def test_a_guide_that_is_not_finite_is_as_good_as_none():
    scans = scans_along(along(STEP, 3))
    assert_same(lidar_odometry(scans, NOWHERE, guides=[np.full(3, np.nan)] * 4), lidar_odometry(scans, NOWHERE))


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


def sweeps_along(poses, twists, n=360):
    """Ranges of sweeps that begin at poses and move on by a twist each; and the angles of their beams."""
    angles = -np.pi + 2 * np.pi / n * np.arange(n)
    starts = [
        [se2.compose(pose, se2.exp(twist * k / n))[None] for k in range(n)]
        for pose, twist in zip(poses, twists, strict=True)
    ]
    return [np.array([cast(ROOM, at, angles[k : k + 1])[0, 0] for k, at in enumerate(swept)]) for swept in starts]


def test_a_sweep_on_a_turning_base_is_carried_to_where_it_began(rng):
    twist, period, n = np.array([0.03, 0.0, 0.12]), 0.1, 360
    start = np.array([-1.0, 0.0, 0.0])
    poses = [start, *(se2.compose(start, se2.exp(i * twist)) for i in range(5))]  # at rest in the first scan
    sweeps = sweeps_along(poses, [np.zeros(3), *[twist] * 5])
    sweeps = [ranges + 0.01 * rng.standard_normal(n) for ranges in sweeps]
    guides = [None, np.zeros(3), *[se2.exp(twist)] * 4]

    def worst(increment):
        scans = [LaserScan(0.1 * i, r, -np.pi, 2 * np.pi / n, time_increment=increment) for i, r in enumerate(sweeps)]
        found = [m for m in lidar_odometry(scans, NOWHERE, guides=guides)[1:] if m.measurement is not None]
        assert len(found) == 4
        return max(np.abs(error_of(m, poses)).max() for m in found)

    assert worst(period / n) < 0.65 * worst(0.0)  # the mean needs a few scans after so sudden a start


def test_a_sweep_after_a_blind_spell_is_carried_as_the_guide_says():
    before, after = np.array([0.02, 0.01, 0.03]), np.array([-0.03, 0.0, -0.05])  # while nothing is seen it turns back
    twists, blind = [np.zeros(3)] * 2 + [before] * 10 + [after] * 8, range(10, 18)
    poses = [np.array([-1.0, 0.0, 0.0])]
    for twist in twists:
        poses.append(se2.compose(poses[-1], se2.exp(twist)))
    sweeps = [0.0 * r if i in blind else r for i, r in enumerate(sweeps_along(poses[:-1], twists))]
    scans = [LaserScan(0.1 * i, r, -np.pi, 2 * np.pi / 360, time_increment=0.1 / 360) for i, r in enumerate(sweeps)]
    found = lidar_odometry(scans, NOWHERE, guides=[None, *(se2.exp(twist) for twist in twists[:-1])])
    assert [match.measurement is None for match in found[9:17]] == [True] * 8
    usual, first = (np.abs(error_of(found[i], poses)).max() for i in (8, 17))
    assert first < 2.0 * usual < 0.002
