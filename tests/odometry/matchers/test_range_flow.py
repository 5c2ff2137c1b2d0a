"""Range flow on scans cast exactly in a small room of walls; as a matcher nothing is added to it or taken off."""

from dataclasses import replace

import numpy as np
import pytest
from room_scans import NOWHERE, STEP, along, scans_along

from longreach.errors import EstimationError
from longreach.geometry import _eigen_kernels, se2, se3, so3
from longreach.measurement import LaserScan
from longreach.odometry import lidar
from longreach.odometry.lidar import LidarConfig
from longreach.odometry.matchers import _flow_kernels, _range_flow_kernels
from longreach.odometry.matchers.range_flow import RangeFlowConfig, lidar_odometry

# an irregular closed room of 5 walls and two pillars
CORNERS = np.array([[-4.0, -3.0], [5.0, -3.5], [6.0, 2.0], [1.0, 4.0], [-4.5, 3.0]])
WALLS = np.concatenate(
    [
        np.stack([CORNERS, np.roll(CORNERS, -1, axis=0)], axis=1),
        [[[2.0, -1.0], [2.5, -1.2]], [[2.5, -1.2], [2.6, -0.4]], [[-2.0, 1.5], [-1.5, 1.4]], [[-1.5, 1.4], [-1.6, 2]]],
    ]
)


def ranges_at(pose, angles):
    """Distance to the nearest wall along each beam, by Cramer's rule."""
    directions = np.stack([np.cos(angles + pose[2]), np.sin(angles + pose[2])], axis=-1)[:, None]
    start = WALLS[None, :, 0] - pose[:2]
    along = (WALLS[:, 1] - WALLS[:, 0])[None]
    cross = lambda a, b: a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]  # noqa: E731
    with np.errstate(divide="ignore", invalid="ignore"):
        t = cross(start, along) / cross(directions, along)
        u = cross(start, directions) / cross(directions, along)
    return np.where((u >= 0) & (u <= 1) & (t > 0), t, np.inf).min(axis=1)


def scan_at(pose, stamp=0.0, beams=541, fov=1.5 * np.pi, angle_min=None, **changes):
    first = -fov / 2 if angle_min is None else angle_min
    increment = fov / (beams - 1)
    ranges = ranges_at(pose, first + increment * np.arange(beams))
    return LaserScan(stamp, **({"ranges": ranges, "angle_min": first, "angle_increment": increment} | changes))


def match_between(a, b, T=None, **kind):
    T = np.eye(4) if T is None else T
    laser = se2.from_se3(T)
    scans = [scan_at(se2.compose(pose, laser), stamp, **kind) for pose, stamp in ((a, 0.0), (b, 0.1))]
    (match,) = lidar_odometry(scans, T, RangeFlowConfig(blend_constant=0.0))
    return match


def assert_finds(a, b, T=None, tolerance=4e-3, **kind):
    match = match_between(np.array(a), np.array(b), T, **kind)
    error = se2.difference(match.measurement.pose, se2.between(np.array(a), np.array(b)))
    assert np.abs(error).max() < tolerance, error


@pytest.mark.parametrize("motion", [(0.08, 0.0, 0.0), (0.0, 0.06, 0.0), (0.0, 0.0, 0.05), (0.05, -0.04, -0.08)])
def test_a_known_motion_is_found(motion):
    assert_finds((0.3, 0.2, 0.4), se2.compose(np.array([0.3, 0.2, 0.4]), np.array(motion)))


def test_a_rotation_far_below_one_beam_is_found():
    match = match_between(np.zeros(3), np.array([0.0, 0.0, 0.001]))  # a beam is 8.7 mrad
    assert match.measurement.pose[2] == pytest.approx(0.001, abs=1e-4)


def test_a_field_of_view_that_is_not_symmetric_does_not_matter():
    assert_finds((0, 0, 0), (0.05, 0.03, 0.03), angle_min=-0.5, fov=3.5)


def test_a_mounting_off_the_centre_gives_the_motion_of_the_base():
    T = se3.from_rotation_translation(so3.from_roll_pitch_yaw(0.0, 0.0, 2.0), np.array([0.4, -0.2, 0.3]))
    assert_finds((0, 0, 0), (0.03, 0.04, 0.06), T)


def test_a_laser_upside_down_gives_the_same_motion():
    pose, moved = np.zeros(3), np.array([0.05, 0.02, 0.04])
    T = se3.from_rotation_translation(so3.from_roll_pitch_yaw(np.pi, 0.0, 0.3), np.array([0.2, 0.1, 0.3]))
    laser = np.array([0.2, 0.1, 0.3])
    # what it calls angle α lies at -α in the plane
    scans = []
    for stamp, base in ((0.0, pose), (0.1, moved)):
        upright = scan_at(se2.compose(base, laser), stamp)
        scans.append(LaserScan(stamp, upright.ranges[::-1], upright.angle_min, upright.angle_increment))
    (match,) = lidar_odometry(scans, T)
    np.testing.assert_allclose(match.measurement.pose, moved, atol=4e-3)


def test_beams_counted_clockwise_give_the_same_motion():
    scans = []
    for stamp, base in ((0.0, np.zeros(3)), (0.1, np.array([0.05, 0.02, 0.04]))):
        scan = scan_at(base, stamp)
        scans.append(LaserScan(stamp, scan.ranges[::-1], -scan.angle_min, -scan.angle_increment))
    (match,) = lidar_odometry(scans, np.eye(4))
    np.testing.assert_allclose(match.measurement.pose, [0.05, 0.02, 0.04], atol=4e-3)


def test_identical_scans_are_no_motion_with_a_finite_covariance():
    match = match_between(np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(match.measurement.pose, 0.0, atol=1e-12)
    assert np.all(np.linalg.eigvalsh(match.measurement.covariance) > 0)


@pytest.mark.parametrize("hole", [np.nan, np.inf, -np.inf, 0.0])
def test_beams_without_return_take_no_part(hole):
    scans = []
    for stamp, base in ((0.0, np.zeros(3)), (0.1, np.array([0.05, 0.02, 0.04]))):
        ranges = scan_at(base).ranges.copy()
        ranges[100:160] = hole
        ranges[::17] = hole
        scans.append(scan_at(base, stamp, ranges=ranges))
    (match,) = lidar_odometry(scans, np.eye(4))
    np.testing.assert_allclose(match.measurement.pose, [0.05, 0.02, 0.04], atol=6e-3)


def test_a_scan_that_sees_nothing_is_no_match_and_the_next_one_starts_anew():
    seen = scan_at(np.zeros(3), 0.0)
    blind = scan_at(np.zeros(3), 0.1, ranges=np.zeros(541))
    matches = lidar_odometry([seen, blind, seen, seen], np.eye(4))
    assert [m.measurement is None for m in matches] == [True, True, False]
    assert "see something in both scans" in matches[0].reason


def test_a_change_of_the_number_of_beams_starts_anew():
    matches = lidar_odometry([scan_at(np.zeros(3)), scan_at(np.zeros(3), 0.1, beams=361)], np.eye(4))
    assert matches[0].measurement is None
    assert "beams" in matches[0].reason


def test_a_tilted_laser_is_refused_with_its_angle():
    T = se3.from_rotation_translation(so3.from_roll_pitch_yaw(0.0, 0.6, 0.0), np.zeros(3))
    with pytest.raises(EstimationError, match="tilted by 34°"):
        lidar_odometry([scan_at(np.zeros(3))], T)


def test_two_beams_are_too_few():
    with pytest.raises(EstimationError, match="2 beams"):
        lidar_odometry([scan_at(np.zeros(3), beams=2)], np.eye(4))


def test_the_covariance_is_of_the_right_size(rng):
    """The mean NEES of single matches under 10 mm of range noise lies within a factor 2 of its ideal 3."""
    nees = []
    for seed in range(60):
        a = np.array([0.3, 0.2, 0.1 * seed])
        b = se2.compose(a, np.array([0.02, 0.01, 0.01]))
        scans = [scan_at(pose, stamp, beams=1081) for pose, stamp in ((a, 0.0), (b, 0.1))]
        noisy = [
            scan_at(p, s.stamp, ranges=s.ranges + rng.normal(0, 0.01, 1081), beams=1081)
            for s, p in zip(scans, (a, b), strict=True)
        ]
        (match,) = lidar_odometry(noisy, np.eye(4), RangeFlowConfig(blend_constant=0.0))
        xi = se2.difference(match.measurement.pose, se2.between(a, b))
        nees.append(xi @ np.linalg.solve(match.measurement.covariance, xi))
    assert 1.5 < np.mean(nees) < 6.0


def test_the_rows_are_the_corrected_residual():
    """On exact data, to first order in the motion, ρ = b + aᵀ ξ vanishes at the true ξ: (3.24) as corrected."""
    n, increment = 721, np.radians(270) / 720
    angles = -np.radians(135) + increment * np.arange(n)
    cos, sin = np.cos(angles), np.sin(angles)
    xi = np.array([2e-4, -1e-4, 1e-4])
    radius = 3.0 + 0.5 * np.sin(3 * angles)  # a smooth room, seen from the origin
    points = np.stack([radius * cos, radius * sin], axis=-1)
    moved = se2.transform(se2.inverse(se2.exp(xi)), points)
    order = np.argsort(np.arctan2(moved[:, 1], moved[:, 0]))
    new = np.interp(angles, np.arctan2(moved[:, 1], moved[:, 0])[order], np.hypot(*moved.T)[order])
    A = np.empty((8, n))
    m = _flow_kernels.flow_rows(radius, new, cos, sin, increment, 1.0, 0.03, False, np.empty((3, n)), 0, A)
    inner = slice(5, m - 5)
    assert np.abs(A[3, inner] + xi @ A[:3, inner]).max() < 0.02 * np.abs(A[3, inner]).max()


def test_the_eigenvectors_are_those_of_linear_algebra(rng):
    for _ in range(50):
        B = rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-4, 4, size=3)
        S = B @ B.T
        D, V = S.copy(), np.empty((3, 3))
        _eigen_kernels.symmetric_eigen(D, V)
        np.testing.assert_allclose(V @ np.diag(np.diag(D)) @ V.T, S, atol=1e-12 * np.abs(S).max())
        np.testing.assert_allclose(V.T @ V, np.eye(3), atol=1e-12)


RANGES = np.array([2.0, 4.0, 0.0, 6.0])  # 4 m on average, one beam without a return


@pytest.mark.parametrize(
    ("motion", "moved"),
    [
        ((0.0, 0.0, 0.0), 0.0),  # the same points are seen again
        ((0.003, 0.004, 0.0), 0.005),
        ((0.0, 0.0, -0.002), 4.0 * 0.002),
        ((0.003, -0.004, 0.001), 0.005 + 4.0 * 0.001),
        ((1.0, 0.0, 0.0), 4.0 * 0.01),  # other points, but no further away than the next beam
        ((0.0, 0.0, 1.0), 4.0 * 0.01),
    ],
)
def test_points_sampled_elsewhere_are_a_share_of_what_they_moved_or_of_their_distance(motion, moved):
    assert _range_flow_kernels.sampling_error(RANGES, 0.01, *motion, 0.06) == pytest.approx(0.06 * moved)
    assert _range_flow_kernels.sampling_error(RANGES, 0.01, *motion, 0.0) == 0.0


def test_a_scan_without_returns_has_no_sampling_error():
    assert _range_flow_kernels.sampling_error(np.zeros(4), 0.01, 1.0, 0.0, 0.5, 0.06) == 0.0


def test_the_sampling_error_is_in_the_covariance_of_a_match():
    scans = [scan_at(np.array([0.05 * i, 0.0, 0.0]), 0.1 * i) for i in range(2)]
    with_it, without = (
        lidar_odometry(scans, np.eye(4), RangeFlowConfig(share=share))[0].measurement for share in (0.06, 0.0)
    )
    np.testing.assert_array_equal(with_it.pose, without.pose)
    added = with_it.covariance - without.covariance
    distance = scans[1].returns[scans[1].returns > 0].mean()
    expected = 0.06 * min(distance * scans[1].angle_increment, 0.05)
    np.testing.assert_allclose(added, expected**2 * np.diag([1.0, 1.0, 0.0]), rtol=1e-6, atol=1e-12)


def swept(start, twist, stamp, period, beams=541, clockwise=False):
    """A scan whose beams are cast one after the other while the laser moves."""
    fov = 1.5 * np.pi
    first, increment = (fov / 2, -fov / (beams - 1)) if clockwise else (-fov / 2, fov / (beams - 1))
    time_increment = 0.75 * period / beams
    ranges = [
        ranges_at(se2.retract(start, (stamp + i * time_increment) * twist), np.array([first + increment * i]))[0]
        for i in range(beams)
    ]
    return LaserScan(stamp, np.array(ranges), first, increment, time_increment=time_increment)


@pytest.mark.parametrize("clockwise", [False, True])
def test_a_sweep_is_carried_to_where_it_began(clockwise):
    twist, start = np.array([0.8, 0.4, 1.5]), np.array([0.3, 0.2, 0.4])
    scan, still = swept(start, twist, 0.0, 0.025, clockwise=clockwise), scan_at(start)
    angles = -0.75 * np.pi + 1.5 * np.pi / 540 * np.arange(541)
    r = scan.ranges[::-1].copy() if clockwise else scan.ranges
    out = np.empty(541)
    share = scan.time_increment / 0.025
    _flow_kernels.deskew(r, np.cos(angles), np.sin(angles), angles[1] - angles[0], 0.025 * twist, share, clockwise, out)
    seen = (out > 0) & (still.ranges > 0)
    before, after = (np.abs(np.where(seen, x, still.ranges) - still.ranges) for x in (r, out))
    assert np.quantile(after, 0.9) < 2e-4
    assert np.quantile(before, 0.9) > 20 * np.quantile(after, 0.9)


@pytest.mark.parametrize("clockwise", [False, True])
def test_motion_while_sweeping_does_not_grow_into_the_estimate(clockwise):
    """Turning this way and that at a rate: with sweeps taken for instants the heading is several times as wrong."""
    start, twist, period = np.array([0.3, 0.2, 0.4]), np.array([0.3, 0.2, 1.0]), 0.025
    scans = [swept(start, twist, period * i, period, clockwise=clockwise) for i in range(30)]
    path = np.zeros(3)
    for match in lidar_odometry(scans, np.eye(4)):
        path = se2.compose(path, match.measurement.pose)
    error = se2.difference(path, se2.exp(29 * period * twist))
    assert np.abs(error).max() < 0.02


def test_a_time_increment_longer_than_the_time_between_scans_is_not_believed():
    scans = [scan_at(np.zeros(3), 0.1 * i, time_increment=1.0) for i in range(3)]
    for match in lidar_odometry(scans, np.eye(4)):
        np.testing.assert_allclose(match.measurement.pose, 0.0, atol=1e-9)


def test_range_flow_behind_the_face_is_range_flow(rng):
    scans = scans_along(along(STEP, 5), rng=rng)
    found = lidar.lidar_odometry(scans, NOWHERE, LidarConfig(method="range-flow"))
    for match, same in zip(found, lidar_odometry(scans, NOWHERE), strict=True):
        np.testing.assert_array_equal(match.measurement.pose, same.measurement.pose)
        np.testing.assert_array_equal(match.measurement.covariance, same.measurement.covariance)
        np.testing.assert_array_equal(match.measurement.shared_covariance, np.zeros((3, 3)))
        np.testing.assert_array_equal(match.motion, same.measurement.pose)
        assert match.keyframe


def test_a_prior_makes_no_difference_to_it(rng):
    scans = scans_along(along(STEP, 5), rng=rng)
    config = LidarConfig(method="range-flow")
    with_it = lidar.lidar_odometry(scans, NOWHERE, config, priors=[None, *[2.0 * STEP] * 5])
    for match, same in zip(with_it, lidar.lidar_odometry(scans, NOWHERE, config), strict=True):
        np.testing.assert_array_equal(match.measurement.pose, same.measurement.pose)


def test_after_scans_that_see_nothing_it_starts_anew_with_the_first_that_does(rng):
    scans = scans_along(along(STEP, 9), rng=rng)
    for i in (3, 4):
        scans[i] = replace(scans[i], ranges=np.zeros(360))
    matches = lidar.lidar_odometry(scans, NOWHERE, LidarConfig(method="range-flow"))
    for match in matches[7:]:
        np.testing.assert_allclose(match.measurement.pose, STEP, atol=2e-2)
