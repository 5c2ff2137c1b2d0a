"""The search for a place: branch and bound, its window, and a second peak."""

from dataclasses import replace

import numpy as np
import pytest
from room_scans import features_of, map_of, scan_at

from longreach.geometry import se2
from longreach.mapping import loop_closure
from longreach.mapping.keyframes import Keyframe, place_of
from longreach.mapping.loop_closure import CHI2, Evidence, Window, gate_of, sampled
from longreach.sim.room import box

PLACES = [(-1.0, -0.5, 0.2), (-0.5, 0.5, 1.0), (1.0, 0.0, 2.5)]
GOOD = Evidence(0.6, 0.0, 0.8, 0.8, 0.02, 0.02, 2.0, 0, 3.0)


def exhaustive(window):
    """The best agreement of all poses of a window's grid."""
    (nx, ny, nt), best = window.sizes, 0.0
    field = window.levels[0].astype(float) / 255.0
    for a in range(2 * nt + 1):
        for i in range(-nx, nx + 1):
            for k in range(-ny, ny + 1):
                x = np.array([i * window.steps[0], k * window.steps[0], (a - nt) * window.steps[1]])
                if x @ window.information @ x > loop_closure.WINDOW**2:
                    continue
                u, v = window.cells[a, 0] + i, window.cells[a, 1] + k
                inside = (u >= 0) & (v >= 0) & (u < field.shape[0]) & (v < field.shape[1])
                best = max(best, float(field[u[inside], v[inside]].sum() / len(u)))
    return best


def test_branch_and_bound_finds_the_best_of_all_poses_in_the_window(rng):
    place = map_of(PLACES)
    points = sampled(features_of(scan_at((0.3, 0.2, 0.4), rng=rng)))[:, ::6]
    window = Window(place, np.ascontiguousarray(points), np.array([0.1, 0.3, 0.45]), np.diag([0.15, 0.1, 0.04]) ** 2)
    peak = window.best(0.0)
    assert peak is not None
    assert peak.agreement == pytest.approx(exhaustive(window), abs=1e-9)


def test_a_scan_is_found_again_metres_from_where_it_was_thought(rng):
    place, truth = map_of(PLACES), np.array([0.3, 0.2, 0.4])
    scan = features_of(scan_at(truth, rng=rng))
    mean = truth + np.array([1.5, -1.0, 0.3])
    peak = Window(place, sampled(scan), mean, np.diag([1.0, 1.0, 0.2]) ** 2).best(0.3)
    assert peak is not None
    fit = loop_closure.fitted(scan, place, peak.pose, np.ones(3))
    np.testing.assert_allclose(fit.pose, truth, atol=0.01)


def test_nothing_outside_the_window_is_found(rng):
    place, truth = map_of(PLACES), np.array([0.3, 0.2, 0.4])
    window = Window(
        place, sampled(features_of(scan_at(truth, rng=rng))), truth + np.array([1.5, 0.0, 0.0]), 0.01 * np.eye(3)
    )
    peak = window.best(0.0)
    assert peak is None or abs(peak.pose[0] - truth[0]) > 1.0


def test_a_place_that_looks_like_another_has_a_second_peak(rng):
    rooms = np.vstack([box(x, 0.0, 3.0, 4.0, 0.0) for x in (0.0, 3.2)])
    place = map_of([(0.0, 0.0, 0.0), (3.2, 0.0, 0.0)], walls=rooms)
    scan = features_of(scan_at((0.2, 0.1, 0.1), walls=rooms, rng=rng))
    window = Window(place, sampled(scan), np.array([1.5, 0.0, 0.0]), np.diag([1.5, 0.5, 0.1]) ** 2)
    first = window.best(0.3)
    assert first is not None
    second = window.best(0.9 * first.agreement, first.pose)
    assert second is not None
    assert abs(second.pose[0] - first.pose[0]) == pytest.approx(3.2, abs=0.2)
    along_x = np.array([1.0, 0.0])
    assert window.best(0.9 * first.agreement, first.pose, along_x) is None


def test_beams_through_a_wall_count_and_those_along_it_do_not(rng):
    walls = box(0.0, 0.0, 6.0, 4.0, 0.0)
    place = map_of([(0.0, 0.0, 0.0), (1.0, 0.5, 0.3), (-1.0, 0.5, 0.1), (0.5, -0.5, 1.0)], walls=walls)
    inside = features_of(scan_at((0.5, 0.5, 0.0), walls=walls, rng=rng))
    assert loop_closure.seen_through(inside, place, np.array([0.5, 0.5, 0.0])) < 0.02
    large = features_of(scan_at((0.0, 0.0, 0.0), walls=box(0.0, 0.0, 12.0, 8.0, 0.0), rng=rng))
    assert loop_closure.seen_through(large, place, np.zeros(3)) > 0.9


def keyframe(pose, walls, rng, people):
    """A keyframe of a room, where so many groups of beams end before its walls, elsewhere each time."""
    scan = scan_at(pose, walls=walls, rng=rng)
    ranges = np.array(scan.ranges)
    for first in rng.integers(0, len(ranges) - 20, people):
        ranges[first : first + 20] = rng.uniform(0.4, 0.7) * ranges[first : first + 20].min()
    scan, zero = replace(scan, ranges=ranges), np.zeros((3, 3))
    return Keyframe(scan, np.array(pose), np.zeros(3), zero, zero, 0.0, features_of(scan))


@pytest.mark.parametrize("people", [0, 5])
def test_people_who_walk_about_are_no_surfaces_that_a_place_must_have_and_other_walls_are(people, rng):
    walls = box(0.0, 0.0, 6.0, 4.0, 0.0)
    poses = np.array([(0.0, 0.0, 0.0), (0.5, 0.5, 0.3), (-0.5, 0.5, 0.1), (0.3, -0.5, 1.0)])
    place = place_of([keyframe(pose, walls, rng, people) for pose in poses], np.arange(4), poses)
    assert place.changing < 0.02 if people == 0 else place.changing > 0.1
    through = [
        loop_closure.looked_through(
            keyframe(pose, walls, rng, people).features, place, se2.between(poses[-1], np.array(pose))
        )
        for pose in [(0.2, 0.2, 0.0), (0.4, -0.2, 1.0), (-0.3, 0.1, 2.0)]
    ]
    assert max(through) < loop_closure.THROUGH
    larger = keyframe((0.0, 0.0, 0.0), box(0.0, 0.0, 12.0, 8.0, 0.0), rng, people)
    assert loop_closure.looked_through(larger.features, place, se2.inverse(poses[-1])) > 2 * loop_closure.THROUGH


@pytest.mark.parametrize(
    ("worse", "gate"),
    [
        ({}, ""),
        ({"overlap": 0.2}, "overlap"),
        ({"agrees": 0.3}, "agreement"),
        ({"through": 0.5}, "visibility"),
        ({"through_back": 0.5}, "visibility"),
        ({"second": 0.58}, "uniqueness"),
        ({"chi2": CHI2 + 0.1}, "chi2"),
    ],
)
def test_each_gate_refuses_what_it_is_for_and_gives_a_reason(worse, gate):
    evidence = GOOD._replace(**worse)
    assert gate_of(evidence) == gate
    match = loop_closure.Match(0, 9, np.zeros(3), np.eye(3), evidence, gate)
    assert loop_closure.reason_of(match).endswith(".") == bool(gate)


def test_the_covariance_of_a_fit_covers_its_errors(rng):
    place, values = map_of(PLACES, rng=rng), []
    for _ in range(60):
        truth = np.array([*rng.uniform(-0.8, 0.8, 2), rng.uniform(-3, 3)])
        scan = features_of(scan_at(truth, rng=rng))
        fit = loop_closure.fitted(scan, place, truth + 0.05 * rng.standard_normal(3), np.ones(3))
        xi = se2.difference(fit.pose, truth)
        values.append(xi @ np.linalg.solve(fit.covariance, xi))
    assert np.mean(values) < 4.5
