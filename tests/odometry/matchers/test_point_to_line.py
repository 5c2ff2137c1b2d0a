"""Point-to-line matching to a local map: rows, fit, covariance, directions that are open, priors that are wrong."""

from dataclasses import replace

import numpy as np
import pytest
from jacobians import assert_is_jacobian
from room_scans import (
    CORRIDOR,
    NOWHERE,
    POINT_TO_LINE,
    ROOM,
    STEP,
    along,
    features_of,
    map_of,
    normalized,
    scan_at,
)

from longreach.geometry import se2
from longreach.measurement import LaserScan
from longreach.odometry import local_map
from longreach.odometry._local_map_kernels import surface_rows
from longreach.odometry.matchers import _point_to_line_kernels
from longreach.odometry.matchers.scan_matcher import Prior
from longreach.odometry.scan_geometry import scan_geometry
from longreach.sim.room import box

HERE = np.array([-1.0, -0.5, 0.2])
GEOMETRY = scan_geometry(scan_at(HERE), NOWHERE, 5)
WIDE = np.array([0.1, 0.1, 0.05])
FREE = np.array([1.0, 1.0, 1.0])


def match(scan, to, pose, sigma=WIDE):
    return POINT_TO_LINE.match(features_of(scan), to, GEOMETRY, Prior(np.array(pose), np.array(sigma), FREE, FREE))


def rows_at(features, to, pose, radius=0.4):
    rows = np.empty((_point_to_line_kernels.ROWS, features.count))
    n = surface_rows(features.values, features.count, 1, pose, to.surfaces, radius, 0.2, rows)
    return rows[:, :n]


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.5])
def test_rows_hold_the_derivative_of_the_distances_by_the_pose(turn):
    wall = np.array([[2.0, -300.0, 2.3, 300.0]])  # one line, so that it does not matter which of its elements are near
    to = map_of([np.zeros(3)], walls=wall, fov=2.0, beams=720)
    pose = np.array([0.1, -0.05, turn])
    features = features_of(scan_at(pose, walls=wall, beams=720))
    off = se2.compose(pose, np.array([0.02, 0.01, 1e-3]))
    rows = rows_at(features, to, off)
    assert rows.shape[1] > 150
    inner = slice(20, -20)  # a point at the map's end may lose its surface

    def distances(at):
        found = rows_at(features, to, at)
        assert found.shape == rows.shape
        return found[3, inner]

    assert_is_jacobian(distances, rows[:3, inner].T, off, se2.retract, atol=1e-6)


def test_moving_the_rows_gives_the_distances_at_the_moved_pose():
    to, features = map_of([HERE], beams=720), features_of(scan_at(HERE, beams=720))
    xi = np.array([2e-4, -1e-4, 1e-4])
    rows = rows_at(features, to, HERE).copy()
    there = rows_at(features, to, se2.retract(HERE, xi))
    _point_to_line_kernels.move_rows(rows, rows.shape[1], *xi)
    assert rows.shape == there.shape
    assert np.median(np.abs(rows[3] - there[3])) < 1e-5


def test_at_the_true_pose_points_lie_on_the_surfaces():
    to, pose = map_of([HERE], beams=720), se2.compose(HERE, STEP)
    rows = rows_at(features_of(scan_at(pose, beams=720)), to, pose)
    assert rows.shape[1] > 600
    assert np.median(np.abs(rows[3])) < 1e-4
    assert np.isfinite(rows).all()


def test_a_point_sees_only_surfaces_that_face_the_laser():
    wall = box(2.0, 0.0, 0.1, 3.0, 0.0)
    to = map_of([(0.0, 0.0, 0.0)], walls=wall)
    front, back = (features_of(scan_at(pose, walls=wall)) for pose in ((0.3, 0.0, 0.0), (4.0, 0.0, np.pi)))
    assert rows_at(front, to, np.array([0.3, 0.0, 0.0])).shape[1] > 50
    assert rows_at(back, to, np.array([4.0, 0.0, np.pi])).shape[1] == 0
    for features, pose, sees in ((front, [0.3, 0.0, 0.0], True), (back, [4.0, 0.0, np.pi], False)):
        values = features.values.copy()
        values[5:7], values[7] = 0.0, np.inf  # nor do points without normals
        assert (rows_at(replace(features, values=values), to, np.array(pose)).shape[1] > 0) is sees


@pytest.mark.parametrize(
    "offset", [(0.05, 0.0, 0.0), (0.0, -0.08, 0.0), (0.0, 0.0, 0.08), (0.06, 0.05, -0.06)], ids=str
)
def test_a_small_offset_of_the_prior_is_recovered_to_less_than_the_noise(offset, rng):
    to, pose = map_of([HERE], rng=rng), se2.compose(HERE, STEP)
    found = match(scan_at(pose, rng=rng), to, se2.compose(pose, np.array(offset)))
    assert np.abs(se2.difference(found.pose, pose)).max() < 0.01 / 3
    assert found.inlier_ratio > 0.8
    assert len(found.directions) == 0


@pytest.mark.parametrize("offset", [(0.3, -0.2, 0.25), (-0.4, 0.3, -0.2)], ids=str)
def test_a_large_offset_of_a_wide_prior_is_recovered(offset, rng):
    to, pose = map_of([HERE], rng=rng), se2.compose(HERE, STEP)
    found = match(scan_at(pose, rng=rng), to, se2.compose(pose, np.array(offset)), (0.3, 0.3, 0.2))
    assert np.abs(se2.difference(found.pose, pose)).max() < 0.01


def test_the_covariance_is_that_of_many_matches_to_one_keyframe():
    values, parts = [], []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        pose = se2.compose(HERE, STEP * rng.uniform(-1, 1, 3))
        found = match(scan_at(pose, rng=rng), map_of([HERE], rng=rng), se2.retract(pose, 0.3 * WIDE))
        values.append(normalized(se2.difference(found.pose, pose), found.covariance))
        parts.append(found.shared[0, 0] / found.covariance[0, 0])
    assert 1.5 < np.mean(values) < 4.5
    assert max(values) < 30.0
    assert 0.2 < np.mean(parts) < 0.8  # two scans of the same noise


def test_the_covariance_shrinks_with_the_noise_and_with_beams():
    def size(beams, noise):
        rng, pose, traces = np.random.default_rng(3), se2.compose(HERE, STEP), []
        for _ in range(10):
            old, new = (scan_at(at, beams=beams) for at in (HERE, pose))
            old, new = (replace(s, ranges=s.ranges + noise * rng.standard_normal(beams)) for s in (old, new))
            to = POINT_TO_LINE.extended(None, features_of(old), None)[0]
            there = Prior(se2.between(HERE, pose), WIDE, FREE, FREE)
            traces.append(np.trace(POINT_TO_LINE.match(features_of(new), to, GEOMETRY, there).covariance))
        return np.median(traces)

    assert size(360, 0.01) < 0.5 * size(360, 0.03)
    assert size(1080, 0.02) < 0.6 * size(180, 0.02)


def test_covariance_and_shared_are_symmetric_and_their_difference_is_definite(rng):
    for pose in along((0.1, 0.05, 0.1), 10, HERE):
        found = match(scan_at(pose, rng=rng), map_of([HERE, pose], rng=rng), pose)
        for P in (found.covariance, found.shared):
            np.testing.assert_array_equal(P, P.T)
        assert np.linalg.eigvalsh(found.covariance - found.shared).min() > 0.0
        assert np.linalg.eigvalsh(found.shared).min() > -1e-15


@pytest.mark.parametrize("heading", [0.0, 0.6])
def test_along_a_corridor_the_pose_stays_at_the_prior_and_across_it_is_right(heading, rng):
    pose, start = np.array([0.3, 0.1, heading]), np.array([0.0, 0.0, heading])
    scans = [replace(scan_at(p, walls=CORRIDOR, rng=rng), range_max=15.0) for p in (start, pose)]
    to = POINT_TO_LINE.extended(None, features_of(scans[0]), None)[0]
    truth = se2.between(start, pose)
    prior = se2.compose(truth, np.array([0.03, -0.04, 0.02]))
    found = POINT_TO_LINE.match(features_of(scans[1]), to, GEOMETRY, Prior(prior, WIDE, FREE, FREE))
    assert found.directions.shape == (1, 3)
    along_it = np.array([np.cos(heading), -np.sin(heading)])  # in the base's frame
    assert abs(found.directions[0, :2] @ along_it) > 0.99
    off = se2.transform(np.array([0.0, 0.0, heading]), (found.pose - prior)[None, :2])[0]
    assert abs(off[0]) < 0.01
    error = se2.transform(np.array([0.0, 0.0, heading]), (found.pose - truth)[None, :2])[0]
    assert abs(error[1]) < 0.005
    assert abs(found.pose[2] - truth[2]) < 0.005
    P = found.covariance
    assert along_it @ P[:2, :2] @ along_it == pytest.approx(FREE[0], rel=0.1)
    across = np.array([np.sin(heading), np.cos(heading)])
    assert across @ P[:2, :2] @ across < 0.01**2


def test_people_in_a_corridor_seldom_seem_to_show_how_far_along_it_the_base_is(rng):
    def crowded(pose):
        scan = scan_at(pose, walls=CORRIDOR, rng=rng)
        ranges = np.where(scan.ranges < 15.0, scan.ranges, np.inf)
        for first in rng.integers(0, 345, 8):
            part = slice(first, first + 12)
            ranges[part] = rng.uniform(0.6, 0.95) * np.minimum(ranges[part], 15.0)
        return features_of(replace(scan, ranges=ranges))

    truth, blind = np.array([0.1, 0.05, 0.02]), 0
    for _ in range(60):
        seen = [(crowded(pose), pose) for pose in along((0.25, 0.0, 0.0), 4, (-0.5, 0.0, 0.0))]
        to = local_map.merged([local_map.keyframe(scan, pose) for scan, pose in seen])
        prior = truth + np.array([0.1 * rng.standard_normal(), 0.0, 0.0])
        fit = POINT_TO_LINE.fit(crowded(truth), to, Prior(prior, np.full(3, 0.1), FREE, FREE), prior)
        blind += len(fit.directions) == 1
    assert blind > 0.78 * 60  # two thirds where chance is not minded


def test_a_wall_across_a_corridor_shows_how_far_along_it_the_base_is(rng):
    walls = np.vstack([CORRIDOR, [[4.0, -1.0, 4.0, 1.2]]])
    to, pose = map_of([(0.0, 0.0, 0.0), (0.5, 0.0, 0.0)], walls=walls, rng=rng), np.array([0.2, 0.05, 0.02])
    found = match(scan_at(pose, walls=walls, rng=rng), to, pose + np.array([0.05, 0.0, 0.0]))
    assert len(found.directions) == 0
    assert abs(found.pose[0] - pose[0]) < 0.01


def test_one_round_wall_shows_the_position_and_not_the_heading(rng):
    angle = np.linspace(0.0, 2 * np.pi, 181)
    x, y = 3.0 * np.cos(angle), 3.0 * np.sin(angle)
    circle = np.stack([x[:-1], y[:-1], x[1:], y[1:]], axis=1)
    to, pose = map_of([(0.0, 0.0, 0.0)], walls=circle, rng=rng), np.array([0.05, -0.02, 0.1])
    found = match(scan_at(pose, walls=circle, rng=rng), to, (0.0, 0.0, 0.05))
    np.testing.assert_allclose(found.pose[:2], pose[:2], atol=0.005)
    assert found.directions.shape == (1, 3)
    assert found.covariance[2, 2] > 0.5
    assert np.linalg.eigvalsh(found.covariance)[1] < 0.01**2


@pytest.mark.parametrize("part", [0.7, 1.3])
def test_a_prior_of_wheels_that_slip_moves_a_match_by_less_than_its_deviation(part, rng):
    motion = np.array([0.25, 0.02, 0.15])
    to, pose = map_of([HERE], rng=rng), se2.compose(HERE, motion)
    scan, sigma = scan_at(pose, rng=rng), 0.01 + 0.2 * np.abs(motion)
    right = match(scan, to, pose, sigma)
    wrong = match(scan, to, se2.compose(HERE, part * motion), sigma)
    assert normalized(se2.difference(right.pose, wrong.pose), right.covariance) < 1.0


def test_a_map_of_both_sides_of_a_thin_wall_matches_each_side_to_its_own(rng):
    walls = np.vstack([ROOM, box(0.0, -1.5, 0.04, 2.0, 0.0)])
    poses = [np.array([-0.8, -1.5, 0.0]), np.array([0.8, -1.5, 0.0])]
    to = map_of(poses, walls=walls, rng=rng)
    for pose in poses:
        found = match(scan_at(pose, walls=walls, rng=rng), to, se2.compose(pose, np.array([0.04, 0.03, 0.02])))
        assert np.abs(se2.difference(found.pose, pose)).max() < 0.01 / 3


@pytest.mark.parametrize("step", [0.01, 0.05])
def test_rounded_ranges_without_noise_give_a_finite_match(step):
    pose = se2.compose(HERE, STEP)
    old, new = (scan_at(at) for at in (HERE, pose))
    old, new = (replace(s, ranges=step * np.round(s.ranges / step)) for s in (old, new))
    to = POINT_TO_LINE.extended(None, features_of(old), None)[0]
    found = POINT_TO_LINE.match(features_of(new), to, GEOMETRY, Prior(STEP, WIDE, FREE, FREE))
    assert np.isfinite(to.surfaces.elements).all()
    assert np.isfinite(found.covariance).all()
    assert np.linalg.eigvalsh(found.covariance).min() > 0.0
    assert np.abs(se2.difference(found.pose, STEP)).max() < step


@pytest.mark.parametrize("beams", [0, 11])
def test_too_few_returns_are_no_match_with_their_number(beams):
    scan = scan_at(HERE)
    few = replace(scan, ranges=np.where(np.arange(360) < beams, scan.ranges, np.nan))
    assert match(few, map_of([HERE]), HERE) == f"only {beams} beams see something"


def test_a_scan_from_elsewhere_is_no_match_with_a_reason():
    assert "that the map has" in match(scan_at(HERE), map_of([HERE]), (40.0, 0.0, 0.0), (0.01, 0.01, 0.01))
    assert "that the map has" in match(scan_at(HERE), map_of([HERE]), (1e4, 0.0, 0.0), (0.01, 0.01, 0.01))


def test_a_map_without_surfaces_gives_no_match_with_a_reason(rng):
    features = features_of(LaserScan(0.0, rng.uniform(0.5, 20.0, 360), -np.pi, np.pi / 180))
    values = features.values.copy()
    values[5:7], values[7] = 0.0, np.inf
    to, _ = POINT_TO_LINE.extended(None, replace(features, values=values), None)
    reason = POINT_TO_LINE.match(features_of(scan_at(HERE)), to, GEOMETRY, Prior(np.zeros(3), WIDE, FREE, FREE))
    assert reason == "only 0 beams see something that the map has"


def test_a_pose_far_from_all_keyframes_or_turned_from_them_is_far(rng):
    to, scan = map_of([HERE, HERE + np.array([1.0, 0.0, 0.0])]), scan_at(HERE)
    features, fit = features_of(scan), match(scan, map_of([HERE]), HERE)

    def is_far(by, **changes):
        return POINT_TO_LINE.is_far(replace(fit, pose=HERE + by, **changes), features, GEOMETRY, to)

    assert not is_far([0.2, 0.0, 0.0])
    assert not is_far([0.8, 0.0, 2 * np.pi])
    assert is_far([0.4, 0.0, 0.0])
    assert is_far([0.0, 0.0, 0.36])
    assert not is_far([0.0, 0.0, 0.34])
    assert is_far([0.0, 0.0, 0.0], rows=200)


def test_a_keyframe_makes_a_new_map_and_a_scan_that_is_none_keeps_it(rng):
    to, scan = map_of([HERE]), scan_at(HERE)
    features, fit = features_of(scan), match(scan, map_of([HERE]), HERE)
    assert POINT_TO_LINE.followed(to, features, fit) is to
    longer, pose = POINT_TO_LINE.extended(to, features, fit)
    assert len(longer.keyframes) == 2
    assert len(to.keyframes) == 1
    np.testing.assert_array_equal(pose, fit.pose)
