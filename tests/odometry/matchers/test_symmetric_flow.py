"""Symmetric range flow: to a keyscan, and to the last scan, too."""

from dataclasses import replace

import numpy as np
import pytest
from room_scans import CORRIDOR, NOWHERE, STEP, along, error_of, scans_along

from longreach.geometry import se2
from longreach.odometry.lidar import LidarConfig, init, lidar_odometry, step
from longreach.odometry.matchers._symmetric_flow_kernels import warp_segments
from longreach.odometry.matchers.scan_matcher import Prior
from longreach.odometry.matchers.symmetric_flow import Scans, SymmetricFlow
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


@symmetric
def test_along_a_corridor_nothing_is_known_and_across_it_much(config, rng):
    poses = along((0.05, 0.0, 0.0), 6, (0.0, 0.0, 0.0))
    scans = [replace(scan, range_max=15.0) for scan in scans_along(poses, walls=CORRIDOR, rng=rng)]
    for match in lidar_odometry(scans, NOWHERE, config, priors=[np.array([0.05, 0.0, 0.0])] * 7):
        assert len(match.degenerate) == 1
        assert abs(match.degenerate[0, 0]) > 0.99
        P = match.measurement.covariance
        assert np.sqrt(P[0, 0]) > 0.05
        assert np.sqrt(P[1, 1]) < 0.01
        assert abs(error_of(match, poses)[1]) < 0.01


@pytest.mark.parametrize("with_last", [False, True])
def test_what_is_not_known_of_the_last_scan_goes_on_where_it_takes_part(with_last, rng):
    scans, matcher = scans_along(along(STEP, 2), rng=rng), SymmetricFlow(with_last)
    geometry = scan_geometry(scans[0], NOWHERE, 5)
    key, last, new = (matcher.features(scan, geometry, np.zeros(3), 0.0) for scan in scans)
    prior = Prior(se2.compose(STEP, STEP), np.full(3, 0.1), np.ones(3), np.ones(3))

    def variance(P):
        return np.trace(matcher.match(new, Scans(key, last, STEP, P), geometry, prior).covariance)

    known, vague = variance(np.zeros((3, 3))), variance(0.01 * np.eye(3))
    if with_last:
        assert known + 0.1 * 0.03 < vague < known + 0.6 * 0.03 + 0.01  # about half of a deviation is a fourth of it
    else:
        assert vague == known


def test_scans_of_as_many_beams_at_other_angles_are_not_matched():
    matcher, scan = SymmetricFlow(with_last=False), scans_along(along(STEP, 0))[0]
    other = replace(scan, angle_min=scan.angle_min + 0.1)
    geometry, turned = scan_geometry(scan, NOWHERE, 5), scan_geometry(other, NOWHERE, 5)
    key, new = matcher.features(scan, geometry, np.zeros(3), 0.0), matcher.features(other, turned, np.zeros(3), 0.0)
    prior = Prior(np.zeros(3), np.full(3, 0.1), np.ones(3), np.ones(3))
    to, _ = matcher.extended(None, key, None)
    assert matcher.match(new, to, turned, prior) == "the scan has other beams than the keyscan"
    assert not isinstance(matcher.match(key, to, scan_geometry(scan, NOWHERE, 5), prior), str)


@symmetric
def test_the_last_scan_is_remembered_beside_the_keyscan_where_it_was_matched(config, rng):
    state, _ = step(init(config, NOWHERE), scans_along(along(STEP, 0))[0])
    key = state.reference.key
    for scan in scans_along(along(0.3 * STEP, 3), rng=rng)[1:]:
        state, match = step(state, scan)
        assert not match.keyframe
        assert state.reference.key is key
        assert state.reference.last is not key
        np.testing.assert_array_equal(state.reference.pose, match.measurement.pose)


@symmetric
def test_a_new_keyscan_begins_without_the_error_of_its_own_match(config, rng):
    matches = lidar_odometry(scans_along(along(STEP, 15), rng=rng), NOWHERE, config)
    assert any(match.keyframe for match in matches[:-2])
    for match in matches:
        np.testing.assert_allclose(match.measurement.shared_covariance, 0.5 * match.measurement.covariance)


@pytest.mark.parametrize("farthest", [False, True])
def test_of_two_surfaces_in_one_direction_the_nearer_is_seen_or_the_farther(farthest):
    n = 90
    angles = -0.45 + 0.01 * np.arange(n)
    r, warped = np.where(np.arange(n) < 45, 2.0, 4.0), np.empty(n)
    warp_segments(r, np.cos(angles), np.sin(angles), 0.01, 0.0, 0.5, 0.0, farthest, warped, np.empty((2, n)))
    both = warped[60:67]  # 0.5 m sideways move the near one by 14 degrees, and the far one, behind it now, by 7
    np.testing.assert_allclose(both, 4.1 if farthest else 2.0, atol=0.1)
