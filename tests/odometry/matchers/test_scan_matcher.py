"""What holds of every way of matching, behind the one face of LIDAR odometry."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from room_scans import NOWHERE, STEP, along, error_of, normalized, scan_at, scans_along

from longreach.geometry import se2, se3, so3
from longreach.measurement import LaserScan
from longreach.odometry.lidar import LidarConfig, init, lidar_odometry, matcher_of, step
from longreach.odometry.matchers.scan_matcher import ScanMatcher

TO_A_KEYFRAME = ("point-to-line", "keyscan-flow", "three-scan-flow")
METHODS = (*TO_A_KEYFRAME, "range-flow")
every_method = pytest.mark.parametrize("method", METHODS)


def arrays_of(value):
    """All arrays within dataclasses and tuples, in order."""
    if isinstance(value, np.ndarray):
        return [value]
    if is_dataclass(value):
        return [a for f in fields(value) for a in arrays_of(getattr(value, f.name))]
    return [a for part in value for a in arrays_of(part)] if isinstance(value, tuple) else []


def assert_equal(one, other):
    """Of two states or matches: all numbers are the same."""
    a, b = arrays_of(one), arrays_of(other)
    assert len(a) == len(b)
    for x, y in zip(a, b, strict=True):
        np.testing.assert_array_equal(x, y)


def run(method, scans, **kind):
    return lidar_odometry(scans, NOWHERE, LidarConfig(method=method), **kind)


@every_method
def test_every_method_names_a_matcher_of_the_contract(method):
    assert isinstance(matcher_of(LidarConfig(method=method)), ScanMatcher)


@every_method
def test_motion_without_noise_is_found(method):
    poses = along(STEP, 15)
    for match in run(method, scans_along(poses, beams=720)):
        assert np.abs(error_of(match, poses)).max() < 5e-3
        np.testing.assert_allclose(match.motion, STEP, atol=5e-3)
        assert match.measurement.source == "lidar"
        assert match.rows > 100


@every_method
def test_scans_refer_to_the_newest_keyframe(method, rng):
    newest = 0.0
    for match in run(method, scans_along(along(STEP, 15), rng=rng)):
        assert match.measurement.stamp_reference == newest
        newest = match.stamp if match.keyframe else newest
    assert newest > 0.0


@every_method
def test_a_step_is_a_function_of_the_state_and_leaves_it_as_it_was(method, rng):
    scans = scans_along(along(STEP, 10), rng=rng)
    state, reached = init(LidarConfig(method=method), NOWHERE), []
    for i, scan in enumerate(scans):
        before = [array.copy() for array in arrays_of(state)]
        (once, a), (twice, b) = step(state, scan, STEP), step(state, scan, STEP)
        assert_equal(once, twice)
        assert_equal(a, b)
        assert (a.stamp, a.reason, a.rows, a.keyframe) == (b.stamp, b.reason, b.rows, b.keyframe)
        for x, y in zip(before, arrays_of(state), strict=True):
            np.testing.assert_array_equal(x, y)
        reached.append((state, [array.copy() for array in arrays_of(state)]))
        state = once
        assert i == 0 or a.measurement is not None
    for old, copies in reached:  # nor does anything that comes later change it
        for x, y in zip(copies, arrays_of(old), strict=True):
            np.testing.assert_array_equal(x, y)


@every_method
def test_scans_are_left_as_they_were(method, rng):
    scans = scans_along(along(STEP, 5), rng=rng)
    scans = [replace(s, ranges=np.where(rng.random(360) < 0.1, np.nan, s.ranges)) for s in scans]
    before = [scan.ranges.copy() for scan in scans]
    run(method, scans)
    for scan, ranges in zip(scans, before, strict=True):
        np.testing.assert_array_equal(scan.ranges, ranges)


@every_method
def test_of_every_match_of_a_drive_its_own_part_of_the_covariance_is_positive_definite(method, rng):
    matches = run(method, scans_along(along((0.08, 0.02, 0.06), 25), rng=rng))
    assert sum(match.keyframe for match in matches) > 3
    for match in matches:
        P, shared = match.measurement.covariance, match.measurement.shared_covariance
        for part in (P, shared):
            np.testing.assert_allclose(part, part.T, atol=1e-15)
        assert np.linalg.eigvalsh(P - shared).min() > 0.0
        assert np.linalg.eigvalsh(shared).min() > -1e-15


@pytest.mark.parametrize("method", TO_A_KEYFRAME)
def test_the_covariance_is_that_of_many_noisy_matches(method, unchecked):
    poses, values = along((0.05, 0.01, 0.03), 4), []
    for seed in range(30):
        for match in run(method, scans_along(poses, rng=np.random.default_rng(seed))):
            values.append(normalized(error_of(match, poses), match.measurement.covariance))
    assert 1.2 < np.mean(values) < 5.0


@every_method
@pytest.mark.parametrize("nothing", [0.0, np.inf, np.nan])
def test_a_scan_that_sees_nothing_is_no_match_and_the_next_ones_are(method, nothing, rng):
    poses = along(STEP, 12)
    scans = scans_along(poses, rng=rng)
    for i in (4, 5, 6):
        scans[i] = replace(scans[i], ranges=np.full(360, nothing))
    matches = run(method, scans, priors=[None, *[STEP] * 12])
    assert [match.measurement is None for match in matches[:6]] == [False] * 3 + [True] * 3
    assert all("beams see something" in match.reason for match in matches[3:6])
    for match in matches[8:]:
        assert match.measurement is not None
        if match.measurement.stamp_reference > 0.65:
            assert np.abs(error_of(match, poses)).max() < 3e-2


@every_method
@pytest.mark.parametrize("hole", [0.0, np.inf, np.nan])
def test_beams_without_return_leave_everything_finite(method, hole, rng):
    poses = along(STEP, 5)
    scans = [replace(s, ranges=np.where(rng.random(360) < 0.1, hole, s.ranges)) for s in scans_along(poses, rng=rng)]
    for match in run(method, scans):
        assert np.isfinite(match.measurement.covariance).all()
        assert np.linalg.eigvalsh(match.measurement.covariance).min() > 0.0
        assert np.abs(error_of(match, poses)).max() < 3e-2


@every_method
@pytest.mark.parametrize("roll", [0.0, np.pi])
def test_a_laser_upside_down_and_off_the_middle_gives_the_motion_of_the_base(method, roll):
    T = se3.from_rotation_translation(so3.from_roll_pitch_yaw(roll, 0.0, 0.3), np.array([0.2, 0.1, 0.3]))
    poses, scans = along(STEP, 3), []
    for i, pose in enumerate(poses):
        upright = -1.0 if roll else 1.0
        seen = scan_at(se2.compose(pose, np.array([0.2, 0.1, 0.3])), 0.1 * i, sense=upright)
        scans.append(LaserScan(seen.stamp, seen.ranges, upright * seen.angle_min, upright * seen.angle_increment))
    for match in lidar_odometry(scans, T, LidarConfig(method=method)):
        assert np.abs(error_of(match, poses)).max() < 1e-2


@every_method
@pytest.mark.parametrize(("beams", "fov"), [(361, 2 * np.pi), (181, np.pi), (1081, 1.5 * np.pi)])
def test_any_number_of_beams_over_any_field_of_view_is_matched(method, beams, fov, rng):
    poses = along((0.04, 0.01, 0.02), 4, (-1.0, -0.5, 0.9))
    for match in run(method, scans_along(poses, beams=beams, fov=fov, rng=rng)):
        assert np.abs(error_of(match, poses)).max() < 2e-2


@every_method
def test_identical_scans_are_no_motion_with_a_definite_covariance(method):
    for match in run(method, scans_along(along(np.zeros(3), 3))):
        np.testing.assert_allclose(match.measurement.pose, 0.0, atol=2e-4)
        assert np.linalg.eigvalsh(match.measurement.covariance).min() > 0


@every_method
def test_rounded_ranges_without_noise_give_finite_matches(method):
    poses = along((0.05, 0.0, 0.04), 6)
    scans = [replace(s, ranges=0.05 * np.round(20 * s.ranges)) for s in scans_along(poses)]
    for match in run(method, scans):
        assert np.isfinite(match.measurement.covariance).all()
        assert np.abs(error_of(match, poses)).max() < 0.1


@every_method
def test_scans_at_other_angles_are_not_taken_for_those_of_the_same_kind(method, rng):
    poses = along(STEP, 8)
    scans = scans_along(poses, fov=1.5 * np.pi, beams=271, rng=rng)
    for i in range(4, 9):  # a second laser of as many beams, that looks to the left
        seen = scan_at(se2.compose(poses[i], np.array([0.0, 0.0, 1.0])), 0.1 * i, fov=1.5 * np.pi, beams=271, rng=rng)
        scans[i] = replace(seen, angle_min=float(seen.angle_min + 1.0))
    for match in run(method, scans):
        if match.measurement is not None:
            assert np.abs(error_of(match, poses)).max() < 3e-2
    assert match.measurement is not None


@every_method
def test_a_scan_of_seven_beams_is_passed_over(method):
    state, _ = step(init(LidarConfig(method=method), NOWHERE), scan_at(np.zeros(3)))
    after, match = step(state, scan_at(np.zeros(3), 0.1, beams=7))
    assert after is state
    assert match.measurement is None
    assert "7 beams" in match.reason
