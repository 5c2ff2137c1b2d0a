"""Features of a scan: its points, and the directions of the surfaces there."""

from dataclasses import replace

import numpy as np
import pytest
from room_scans import features_of, scan_at, sweeps_along

from longreach.geometry import se2, se3, so3
from longreach.measurement import LaserScan
from longreach.sim.room import polygon

BOX = polygon([(-3.0, -2.0), (4.0, -2.0), (4.0, 3.0), (-3.0, 3.0)])
HERE = (0.2, 0.1, 0.3)
KINDS = [(360, 2 * np.pi), (361, 2 * np.pi * 361 / 360), (181, np.pi), (1081, 1.5 * np.pi), (90, 2 * np.pi)]


def columns(features):
    return features.values[:, : features.count]


def with_normals(features):
    return columns(features)[:, np.isfinite(columns(features)[7])]


@pytest.mark.parametrize(("beams", "fov"), KINDS)
def test_normals_have_length_one_and_point_to_the_laser(beams, fov, rng):
    found = with_normals(features_of(scan_at(HERE, beams=beams, fov=fov, rng=rng)))
    assert found.shape[1] > 0.6 * beams
    np.testing.assert_allclose(np.hypot(*found[5:7]), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.hypot(*found[2:4]), 1.0, atol=1e-12)
    assert (found[2] * found[5] + found[3] * found[6] < 0.0).all()


def test_normals_are_those_of_the_walls_away_from_corners():
    values = columns(features_of(scan_at((0.0, 0.0, 0.0), walls=BOX)))
    x, y = values[:2]
    inner = np.sort([abs(x + 3), abs(x - 4), abs(y + 2), abs(y - 3)], axis=0)[1] > 0.5
    assert inner.sum() > 200
    expected = np.where(abs(x + 3) < 1e-6, 1.0, np.where(abs(x - 4) < 1e-6, -1.0, 0.0))
    np.testing.assert_allclose(values[5, inner], expected[inner], atol=1e-6)


def test_points_lie_where_the_beams_of_the_mounted_laser_end():
    T = se3.from_rotation_translation(so3.from_roll_pitch_yaw(0.0, 0.0, 0.4), np.array([0.3, -0.1, 0.5]))
    here = np.array(HERE)
    values = columns(features_of(scan_at(se2.compose(here, np.array([0.3, -0.1, 0.4])), walls=BOX), T))
    c, s = np.cos(here[2]), np.sin(here[2])
    x, y = here[0] + c * values[0] - s * values[1], here[1] + s * values[0] + c * values[1]
    off = np.minimum.reduce([abs(x + 3), abs(x - 4), abs(y + 2), abs(y - 3)])
    np.testing.assert_allclose(off, 0.0, atol=1e-9)


def test_a_scan_with_its_beams_reversed_has_the_same_features(rng):
    scan = scan_at(HERE, rng=rng)
    last = scan.angle_min + (len(scan.ranges) - 1) * scan.angle_increment
    other = replace(scan, ranges=scan.ranges[::-1].copy(), angle_min=last, angle_increment=-scan.angle_increment)
    a, b = features_of(scan), features_of(other)
    np.testing.assert_allclose(columns(a), columns(b), rtol=1e-9, atol=1e-9)
    assert (a.count, a.noise, a.reach) == pytest.approx((b.count, b.noise, b.reach), rel=1e-9)


def test_a_laser_upside_down_has_the_same_features(rng):
    scan = scan_at(HERE, rng=rng)
    over = replace(scan, angle_min=-scan.angle_min, angle_increment=-scan.angle_increment)
    T = se3.from_rotation_translation(so3.from_roll_pitch_yaw(np.pi, 0.0, 0.0), np.zeros(3))
    np.testing.assert_allclose(columns(features_of(scan)), columns(features_of(over, T)), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("nothing", [0.0, -1.0, np.inf, np.nan, 0.05, 40.0])
def test_beams_without_a_range_within_the_limits_are_no_points(nothing, rng):
    scan = scan_at(HERE, rng=rng)
    ranges = np.where(np.arange(360) % 7 == 0, nothing, scan.ranges)
    found = features_of(replace(scan, ranges=ranges, range_min=0.1, range_max=30.0))
    assert found.count == np.count_nonzero(np.arange(360) % 7)
    assert np.isfinite(columns(found)[[0, 1, 2, 3, 4, 5, 6, 8]]).all()
    assert not np.isnan(columns(found)[7]).any()
    kept = features_of(scan).values[:2, np.arange(360) % 7 != 0]
    np.testing.assert_allclose(columns(found)[:2], kept, atol=1e-12)


@pytest.mark.parametrize("nothing", [0.0, np.inf, np.nan])
def test_a_scan_without_returns_has_no_features(nothing):
    found = features_of(LaserScan(0.0, np.full(360, nothing), -np.pi, np.pi / 180))
    assert found.count == 0
    assert np.isfinite([found.noise, found.reach]).all()


@pytest.mark.parametrize("step", [0.01, 0.05, 0.5])
def test_rounded_ranges_have_finite_features_and_some_noise(step):
    scan = scan_at(HERE)
    found = features_of(replace(scan, ranges=step * np.round(scan.ranges / step)))
    assert found.count == 360
    assert not np.isnan(columns(found)).any()
    assert found.noise >= 1e-3


def test_equal_ranges_all_about_have_normals_to_the_laser():
    found = features_of(LaserScan(0.0, np.full(360, 2.0), -np.pi, np.pi / 180))
    np.testing.assert_allclose(found.values[5:7], -found.values[2:4], atol=0.2)
    assert found.noise >= 1e-3


@pytest.mark.parametrize("sigma", [0.003, 0.01, 0.03])
def test_the_noise_of_the_ranges_is_found(sigma, rng):
    scan = scan_at(HERE, beams=720)
    found = [features_of(replace(scan, ranges=scan.ranges + sigma * rng.standard_normal(720))).noise for _ in range(10)]
    assert 0.75 * sigma < np.mean(found) < 1.3 * sigma


def test_the_noise_is_found_where_half_of_the_returns_are_clutter(rng):
    scan = scan_at(HERE, beams=720)
    ranges = scan.ranges + 0.01 * rng.standard_normal(720)
    ranges[100:460] *= rng.uniform(0.3, 0.9, 360)
    found = features_of(replace(scan, ranges=ranges))
    assert 0.006 < found.noise < 0.03
    clutter = with_normals(features_of(replace(scan, ranges=ranges[100:460], angle_min=scan.angle_min)))
    assert clutter.shape[1] < 0.5 * 360


def test_the_direction_of_a_surface_is_off_by_as_much_as_its_variance_says(rng):
    wall = np.array([[2.0, -30.0, 2.0, 30.0]])
    z = []
    for _ in range(40):
        found = features_of(scan_at((0.0, 0.0, 0.0), walls=wall, fov=2.0, beams=181, rng=rng))
        values = columns(found)[:, 20:160:20]
        angle = np.arctan2(values[6], -values[5])
        z.append(angle / np.sqrt(values[7] * found.noise**2))
    assert 0.4 < np.mean(np.square(z)) < 2.0


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_the_points_of_a_sweep_are_carried_to_where_it_began(sense):
    wall, twist, n = np.array([[2.0, -300.0, 2.3, 300.0]]), np.array([0.1, 0.05, 0.2]), 360
    (ranges,) = sweeps_along([np.zeros(3)], [twist * sense], n, wall)
    if sense < 0:  # the sweep runs from π down, over the wall mirrored
        (ranges,) = sweeps_along([np.zeros(3)], [twist * [1, -1, -1]], n, wall * [1, -1, 1, -1])
    scan = LaserScan(0.0, ranges, -sense * np.pi, sense * 2 * np.pi / n)
    found = columns(features_of(scan, motion=twist, share=1.0 / n))
    np.testing.assert_allclose(found[0], 2.15 + found[1] * 0.3 / 600, atol=1e-9)
    still = columns(features_of(scan))
    assert np.abs(still[0] - 2.15 - still[1] * 0.3 / 600).max() > 0.02
