"""Where on a map a base is, without a start: found at once, by driving, or said to be ambiguous."""

from dataclasses import replace

import numpy as np
import pytest
from room_maps import map_along, rows_along, walk
from room_scans import NOWHERE, ROOM, scan_at

from longreach.geometry import se2
from longreach.mapping import global_start, map_localizer
from longreach.mapping.known_map import features_of, prepared
from longreach.mapping.mapper import PathRow
from longreach.odometry.scan_geometry import scan_geometry

RANGE = 4.0  # [m] of the laser in the hall
HALL = np.array([[-8.0, -1.5, 8.0, -1.5], [8.0, -1.5, 8.0, 1.5], [8.0, 1.5, -8.0, 1.5], [-8.0, 1.5, -8.0, -1.5]])
PILLAR = np.array([[0.5, 1.0, 1.2, 1.0], [1.2, 1.0, 1.2, 1.5], [0.5, 1.5, 0.5, 1.0]])  # at one side of its middle
ENDS = [np.array([x, 0.1, 0.0]) for x in np.arange(-6.5, 6.6, 0.4)]


def shortened(scan):
    return replace(scan, ranges=np.where(scan.ranges > RANGE, np.inf, scan.ranges), range_max=RANGE)


def hall(walls, rng):
    made = map_along(ENDS, rng, walls)
    return prepared(replace(made, scans=tuple(map(shortened, made.scans))))


def features(scan):
    return features_of(scan, scan_geometry(scan, NOWHERE, 5), np.zeros(3))


def drive(walls, rng, start=-5.5, end=-1.5):
    poses = [np.array([x, 0.0, 0.0]) for x in np.arange(start, end, 0.05)]
    scans, rows = rows_along(poses, rng, walls=walls)
    return poses, list(map(shortened, scans)), rows


def test_the_base_is_found_in_a_room_at_once_whatever_way_it_looks(rng):
    known = prepared(map_along(walk(), rng))
    for k in range(12):
        pose = np.array([*rng.uniform(-0.9, 0.9, 2), rng.uniform(-np.pi, np.pi)])
        found = global_start.search(known, features(scan_at(pose, rng=rng)))
        assert found[0].weight > 0.9, k
        off = se2.difference(found[0].pose, pose)
        assert np.hypot(*off[:2]) < 0.05
        assert abs(off[2]) < 0.02


def test_a_scan_of_somewhere_else_is_found_nowhere(rng):
    known = prepared(map_along(walk(), rng))
    angles = 2.0 * np.pi / 12 * np.arange(13)
    corners = np.column_stack([np.cos(angles), np.sin(angles)]) * np.where(np.arange(13) % 2, 3.0, 1.2)[:, None]
    star = np.hstack([corners[:-1], corners[1:]])
    found = global_start.search(known, features(scan_at([0.0, 0.1, 0.0], walls=star, rng=rng)))
    assert not found


def test_two_ends_that_look_the_same_are_two_hypotheses_and_stay_so(rng):
    known = hall(HALL, rng)
    poses, scans, rows = drive(HALL, rng)
    state, given, _ = global_start.step(global_start.init(known, NOWHERE), scans, rows)
    assert state.settled is None
    assert given == []
    last = poses[-1]
    for expected in (last, np.array([-last[0], -last[1], np.pi])):
        off = [se2.difference(h.pose, expected) for h in state.hypotheses]
        assert min(np.hypot(*one[:2]) for one in off) < 0.2
    assert all(h.weight < 0.9 for h in state.hypotheses)
    assert sum(h.weight for h in state.hypotheses) == pytest.approx(1.0, abs=0.05)


def test_driving_on_to_where_they_differ_settles_it(rng):
    walls = np.vstack([HALL, PILLAR])
    known = hall(walls, rng)
    poses, scans, rows = drive(walls, rng)
    opened, given, _ = global_start.step(global_start.init(known, NOWHERE), scans[:1], rows[:1])
    assert opened.settled is None
    assert len(opened.hypotheses) > 1
    state, given, corrections = global_start.step(global_start.init(known, NOWHERE), scans, rows)
    assert state.settled is not None
    assert rows[0].stamp < given[0].stamp < rows[-1].stamp
    off = se2.difference(given[-1].pose, poses[-1])
    assert np.hypot(*off[:2]) < 0.02
    assert all(c.status == "used" for c in corrections)


def test_a_search_may_be_fed_in_any_portions(rng):
    walls = np.vstack([HALL, PILLAR])
    known = hall(walls, rng)
    _, scans, rows = drive(walls, rng)
    _, at_once, _ = global_start.step(global_start.init(known, NOWHERE), scans, rows)
    state, given = global_start.init(known, NOWHERE), []
    for k in range(0, len(rows), 7):
        state, part, _ = global_start.step(state, scans[k : k + 7], rows[k : k + 7])
        given += part
    assert len(given) == len(at_once) > 0
    for one, two in zip(at_once, given, strict=True):
        np.testing.assert_array_equal(one.pose, two.pose)


def test_a_map_of_the_room_moved_as_a_whole_moves_what_is_found(rng):
    made, scan = map_along(walk(), rng), features(scan_at([0.3, -0.2, 2.0], walls=ROOM, rng=rng))
    moved = np.array([7.3, -4.1, 0.7])
    poses = se2.compose(np.broadcast_to(moved, made.graph.poses.shape), made.graph.poses)
    one = global_start.search(prepared(made), scan)[0]
    two = global_start.search(prepared(replace(made, graph=replace(made.graph, poses=poses))), scan)[0]
    np.testing.assert_allclose(se2.compose(moved, one.pose), two.pose, atol=0.01)


def kidnapped(rng, before=60, after=60):
    """A base that goes on a circle is carried elsewhere between two scans, and odometry does not see it."""
    poses = walk(step=0.05)
    first, second = poses[:before], [np.array([0.3 + 0.01 * k, 0.4, 2.0]) for k in range(after)]
    scans, rows = rows_along(first, rng)
    others, on = rows_along(second, rng)
    t = rows[-1].stamp + 0.1
    scans += [replace(scan, stamp=scan.stamp + t) for scan in others]
    rows += [PathRow(row.stamp + t, se2.compose(rows[-1].pose, row.pose), rows[-1].covariance) for row in on]
    return [*first, *second], scans, rows


def test_a_base_that_is_carried_away_is_said_to_be_lost_and_found_again(rng):
    known = prepared(map_along(walk(), rng))
    poses, scans, rows = kidnapped(rng)
    state = global_start.init(known, NOWHERE)
    start = map_localizer.init(known, NOWHERE, poses[0], global_start.SIGMAS)
    state, given, corrections = global_start.step(replace(state, settled=start), scans, rows)
    alarms = [c for c in corrections if c.reason.startswith(global_start.LOST)]
    found = [c for c in corrections if c.reason.startswith(global_start.FOUND)]
    assert len(alarms) == len(found) == 1
    assert rows[60].stamp <= alarms[0].stamp <= rows[60].stamp + 5.0
    assert not any(row.lost for row in given if row.stamp < rows[60].stamp)
    assert state.settled is not None
    off = se2.difference(given[-1].pose, poses[-1])
    assert np.hypot(*off[:2]) < 0.01


def test_where_nothing_is_found_rows_are_odometry_s_and_their_covariance_grows(rng):
    known = prepared(map_along(walk(), rng))
    poses = walk(step=0.05)
    scans, rows = rows_along(poses, rng, drift=0.02)
    angles = scans[0].angles
    star = 1.0 + 2.0 * np.cos(3.5 * angles) ** 2
    scans[40:] = [replace(scan, ranges=star + 0.01 * rng.standard_normal(len(star))) for scan in scans[40:]]
    start = map_localizer.init(known, NOWHERE, poses[0], global_start.SIGMAS)
    state, given, _ = global_start.step(replace(global_start.init(known, NOWHERE), settled=start), scans, rows)
    late = [row for row in given if row.lost]
    assert late
    assert given[-1].lost
    assert state.settled is None
    sigmas = [np.linalg.det(row.covariance) for row in late]
    assert np.all(np.diff(sigmas) > -1e-12 * sigmas[0])
    assert sigmas[-1] > sigmas[0] > 100.0 * np.linalg.det(given[30].covariance)
    for a, b, one, two in zip(late[:-1], late[1:], rows[-len(late) : -1], rows[-len(late) + 1 :], strict=True):
        np.testing.assert_allclose(se2.between(a.pose, b.pose), se2.between(one.pose, two.pose), atol=1e-9)


def test_beams_that_end_in_space_that_the_map_has_not_seen_tell_nothing(rng):
    known = hall(HALL, rng)
    for x, covered in ((-5.0, 1.0), (7.0, 1.0), (-12.0, 0.0)):
        scan = features(shortened(scan_at([x, 0.0, 0.0], walls=HALL, rng=rng)))
        if abs(x) > 8.0:
            scan = features(shortened(scan_at([-5.0, 0.0, 0.0], walls=HALL, rng=rng)))
        pose = np.array([x, 0.0, 0.0])
        said = known.evidence(known.nearest(pose)[0], scan, pose)
        assert said.covered == pytest.approx(covered, abs=0.1)
        assert said.share > 0.95 or covered == 0.0


def test_a_scan_of_a_place_beside_the_map_is_not_settled_on_a_place_of_it(rng):
    walls = np.vstack([HALL, PILLAR])
    known = hall(walls, rng)
    beyond = np.array([[-3.0, -2.0, 3.0, -2.0], [3.0, -2.0, 3.0, 2.2], [3.0, 2.2, 1.0, 1.6], [1.0, 1.6, -3.0, 2.2]])
    for heading in (0.0, 1.0, 2.0):
        found = global_start.search(known, features(shortened(scan_at([0.0, 0.0, heading], walls=beyond, rng=rng))))
        assert not found or found[0].weight < 0.9
