"""Other ways of matching behind the one face: symmetric flow to a keyscan, also to the last scan; range flow."""

from dataclasses import replace

import numpy as np
import pytest
from room_scans import CORRIDOR, NOWHERE, STEP, along, error_of, scan_at, scans_along

from longreach.geometry import se2, se3, so3
from longreach.measurement import LaserScan
from longreach.odometry import range_flow, symmetric_flow
from longreach.odometry._symmetric_flow_kernels import warp_segments
from longreach.odometry.lidar import LidarConfig, lidar_odometry
from longreach.odometry.scan_geometry import scan_geometry

SYMMETRIC = [LidarConfig(method="keyscan-flow"), LidarConfig(method="three-scan-flow")]
symmetric = pytest.mark.parametrize("config", SYMMETRIC, ids=lambda config: config.method)


@symmetric
def test_motion_without_noise_is_found_to_millimetres(config):
    poses = along(STEP, 15)
    matches = lidar_odometry(scans_along(poses, beams=720), NOWHERE, config)
    for match in matches:
        assert np.abs(error_of(match, poses)).max() < 3e-3
    assert 1 < sum(match.keyframe for match in matches) < 12


def test_range_flow_behind_the_face_is_range_flow(rng):
    scans = scans_along(along(STEP, 5), rng=rng)
    found = lidar_odometry(scans, NOWHERE, LidarConfig(method="range-flow"))
    for match, same in zip(found, range_flow.lidar_odometry(scans, NOWHERE), strict=True):
        np.testing.assert_array_equal(match.measurement.pose, same.measurement.pose)
        np.testing.assert_array_equal(match.motion, same.measurement.pose)
        assert match.keyframe


@symmetric
def test_the_covariance_is_that_of_many_noisy_matches(config, rng):
    poses, values = along((0.05, 0.01, 0.03), 4), []
    for _ in range(30):
        for match in lidar_odometry(scans_along(poses, rng=rng), NOWHERE, config):
            e, P, shared = error_of(match, poses), match.measurement.covariance, match.measurement.shared_covariance
            values.append(e @ np.linalg.solve(P, e))
            assert np.linalg.eigvalsh(P - shared).min() > 0
    assert 1.5 < np.mean(values) < 5.0


@symmetric
def test_along_a_corridor_nothing_is_told_and_across_it_much(config, rng):
    poses = along((0.05, 0.0, 0.0), 6, (0.0, 0.0, 0.0))
    scans = [replace(scan, range_max=15.0) for scan in scans_along(poses, walls=CORRIDOR, rng=rng)]
    for match in lidar_odometry(scans, NOWHERE, config, guides=[np.array([0.05, 0.0, 0.0])] * 7):
        assert len(match.degenerate) == 1
        assert abs(match.degenerate[0, 0]) > 0.99
        P = match.measurement.covariance
        assert np.sqrt(P[0, 0]) > 0.05
        assert np.sqrt(P[1, 1]) < 0.01
        assert abs(error_of(match, poses)[1]) < 0.01


@symmetric
@pytest.mark.parametrize("nothing", [0.0, np.inf, np.nan])
def test_a_scan_that_sees_nothing_is_no_match_and_holes_take_no_part(config, nothing, rng):
    poses = along(STEP, 6)
    scans = scans_along(poses)
    for i in (2, 3, 4):
        scans[i] = replace(scans[i], ranges=np.full(360, nothing))
    scans[5] = replace(scans[5], ranges=np.where(rng.random(360) < 0.1, nothing, scans[5].ranges))
    matches = lidar_odometry(scans, NOWHERE, config)
    assert all(m.measurement is None and "0 beams" in m.reason for m in matches[1:4])
    assert np.abs(error_of(matches[5], poses)).max() < 2e-2


@symmetric
@pytest.mark.parametrize("roll", [0.0, np.pi])
def test_a_laser_upside_down_and_off_the_middle_gives_the_motion_of_the_base(config, roll):
    T = se3.from_rotation_translation(so3.from_roll_pitch_yaw(roll, 0.0, 0.3), np.array([0.2, 0.1, 0.3]))
    poses, scans = along(STEP, 3), []
    for i, pose in enumerate(poses):
        upright = -1.0 if roll else 1.0
        seen = scan_at(se2.compose(pose, np.array([0.2, 0.1, 0.3])), 0.1 * i, sense=upright)
        scans.append(LaserScan(seen.stamp, seen.ranges, upright * seen.angle_min, upright * seen.angle_increment))
    for match in lidar_odometry(scans, T, config):
        assert np.abs(error_of(match, poses)).max() < 5e-3


@symmetric
def test_identical_scans_are_no_motion_with_a_definite_covariance(config):
    for match in lidar_odometry(scans_along(along(np.zeros(3), 3)), NOWHERE, config):
        np.testing.assert_allclose(match.measurement.pose, 0.0, atol=1e-4)
        assert np.linalg.eigvalsh(match.measurement.covariance).min() > 0


@pytest.mark.parametrize("three", [False, True])
def test_what_is_not_known_of_the_last_scan_goes_on_where_it_has_a_say(three, rng):
    scans = scans_along(along(STEP, 2), rng=rng)
    geometry = scan_geometry(scans[0], NOWHERE, 5)
    key, last, new = (symmetric_flow.keyscan_of(s.ranges, (0.0, 100.0), geometry, np.zeros(3), 0.0) for s in scans)
    pose, guess, doubt = se2.exp(se2.log(STEP)), se2.compose(STEP, STEP), np.full(3, 0.1)

    def variance(P):
        found = symmetric_flow.fit(new, key, last, (pose, P), three, geometry, guess, doubt, np.ones(3))
        return np.trace(found.covariance)

    known, vague = variance(np.zeros((3, 3))), variance(0.01 * np.eye(3))
    if three:
        assert known + 0.1 * 0.03 < vague < known + 0.6 * 0.03 + 0.01  # about half of a deviation is a fourth of it
    else:
        assert vague == known


@pytest.mark.parametrize("farthest", [False, True])
def test_of_two_surfaces_in_one_direction_the_nearer_is_seen_or_the_farther(farthest):
    n = 90
    angles = -0.45 + 0.01 * np.arange(n)
    r, warped = np.where(np.arange(n) < 45, 2.0, 4.0), np.empty(n)
    warp_segments(r, np.cos(angles), np.sin(angles), 0.01, 0.0, 0.5, 0.0, farthest, warped, np.empty((2, n)))
    both = warped[60:67]  # 0.5 m sideways move the near one by 14 degrees, and the far one, behind it now, by 7
    np.testing.assert_allclose(both, 4.1 if farthest else 2.0, atol=0.1)
