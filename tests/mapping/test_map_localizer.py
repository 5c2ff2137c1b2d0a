"""Localising in a map of a room: scans that are cast in it, odometry that drifts, and a truth that is known."""

import numpy as np
import pytest
from room_maps import map_along, rows_along, walk, wrong_map_along
from room_scans import NOWHERE, scan_at

from longreach.errors import MappingError
from longreach.geometry import se2
from longreach.mapping import map_localizer
from longreach.mapping.known_map import covariances_of, prepared
from longreach.mapping.map_file import Map
from longreach.mapping.pose_graph import PoseGraph, adjoints, information, jacobians, residuals

WIDE = np.diag([0.2**2, 0.2**2, 0.1**2])


@pytest.fixture(scope="module")
def mapped():
    return map_along(walk(), np.random.default_rng(1))


@pytest.fixture(scope="module")
def known(mapped):
    return prepared(mapped)


def localised(known, poses, scans, rows, off=(0.08, -0.06, 0.03), covariance=WIDE):
    state = map_localizer.init(known, NOWHERE, se2.compose(poses[0], np.array(off)), covariance)
    return map_localizer.step(state, scans, rows)


def errors_of(given, poses):
    xi = np.array([se2.difference(row.pose, pose) for row, pose in zip(given, poses, strict=True)])
    P = np.array([row.covariance for row in given])
    return xi, np.einsum("ki,kij,kj->k", xi, np.linalg.inv(P), xi)


def test_the_pose_is_held_on_the_map_to_millimetres_while_odometry_drifts(known, rng):
    poses = walk(step=0.05)[::-1]
    scans, rows = rows_along(poses, rng, drift=0.06)
    _, given, corrections = localised(known, poses, scans, rows)
    xi, nees = errors_of(given, poses)
    drifted = se2.difference(se2.compose(se2.compose(poses[0], se2.inverse(rows[0].pose)), rows[-1].pose), poses[-1])
    assert np.hypot(*drifted[:2]) > 0.05
    assert np.sqrt(np.mean(np.sum(xi[:, :2] ** 2, axis=1))) < 0.008
    assert np.degrees(np.sqrt(np.mean(xi[:, 2] ** 2))) < 0.2
    assert np.mean(nees) < 4.5
    assert all(c.status == "used" for c in corrections)


def test_at_standstill_the_covariance_holds_the_error_of_map_and_surfaces_and_does_not_shrink():
    nees, sigmas = [], []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        known = prepared(wrong_map_along(walk(), rng))
        poses = [walk()[2 * seed]] * 300  # 30 s
        scans, rows = rows_along(poses, rng)
        _, given, _ = localised(known, poses, scans, rows)
        _, found = errors_of(given, poses)
        nees.append(found[-100:].mean())
        sigmas.append([np.sqrt(given[k].covariance[0, 0]) for k in (100, -1)])
    assert 0.1 < np.mean(nees) < 4.5
    early, late = np.mean(sigmas, axis=0)
    assert late > 0.9 * early > 0.002


def test_odometry_goes_on_where_a_scan_is_of_another_place_and_the_reason_is_said(known, rng):
    poses = walk(step=0.05)
    scans, rows = rows_along(poses, rng)
    elsewhere = walk()[-1]
    scans[30:] = [scan_at(elsewhere, row.stamp, rng=rng) for row in rows[30:]]
    _, given, corrections = localised(known, poses, scans, rows)
    late = [c for c in corrections if c.stamp >= rows[31].stamp]
    assert late
    assert all(c.status in ("refused", "gated") and c.reason for c in late)
    jumps = [
        np.hypot(
            *se2.difference(se2.between(rows[k - 1].pose, rows[k].pose), se2.between(given[k - 1].pose, given[k].pose))[
                :2
            ]
        )
        for k in range(31, len(rows))
    ]
    assert max(jumps) < 1e-9
    assert np.linalg.det(given[-1].covariance) > np.linalg.det(given[31].covariance)


def test_a_fit_that_is_taken_after_others_were_not_says_so(known, rng):
    poses = walk(step=0.05)
    scans, rows = rows_along(poses, rng)
    scans[20:40] = [scan_at(walk()[-1], row.stamp, rng=rng) for row in rows[20:40]]
    _, _, corrections = localised(known, poses, scans, rows)
    assert [c.status for c in corrections if "in a row" in c.reason] == ["used"]


def test_where_the_map_bends_the_pose_follows_after_a_few_fits_that_agree_and_says_why(known, rng):
    poses = walk(step=0.05)
    scans, rows = rows_along(poses, rng)
    at = [*poses[:40], *(se2.compose(pose, np.array([0.04, 0.02, 0.0])) for pose in poses[40:])]
    scans[40:] = [scan_at(pose, row.stamp, rng=rng) for pose, row in zip(at[40:], rows[40:], strict=True)]
    state, given, corrections = localised(known, poses, scans, rows)
    bent = [c for c in corrections if "the map bends" in c.reason]
    assert len(bent) == 1
    assert rows[40].stamp < bent[0].stamp < rows[60].stamp
    assert np.hypot(*se2.difference(given[-1].pose, at[-1])[:2]) < 0.01
    assert not state.test.is_lost


def test_a_map_that_is_moved_as_a_whole_moves_what_is_localised_in_it_and_nothing_else(mapped, known, rng):
    moved = np.array([3.0, -2.0, 1.0])
    graph = mapped.graph
    other = Map(
        PoseGraph(se2.compose(np.broadcast_to(moved, graph.poses.shape), graph.poses), graph.odometry, graph.closures),
        mapped.weights, mapped.scans, mapped.twists, mapped.session, mapped.sessions,
    )  # fmt: skip
    poses = walk(step=0.05)[:60]
    scans, rows = rows_along(poses, rng)
    _, given, _ = localised(known, poses, scans, rows)
    at = [se2.compose(moved, pose) for pose in poses]
    _, also, _ = localised(prepared(other), at, scans, rows)
    for one, two in zip(given, also, strict=True):
        np.testing.assert_allclose(se2.compose(moved, one.pose), two.pose, atol=2e-3)
        np.testing.assert_allclose(one.covariance, two.covariance, rtol=0.1, atol=1e-7)


def test_scans_and_rows_may_come_in_any_portions(known, rng):
    poses = walk(step=0.05)[:40]
    scans, rows = rows_along(poses, rng)
    _, at_once, _ = localised(known, poses, scans, rows)
    state = map_localizer.init(known, NOWHERE, se2.compose(poses[0], np.array([0.08, -0.06, 0.03])), WIDE)
    given = []
    state = map_localizer.init(known, NOWHERE, se2.compose(poses[0], np.array([0.08, -0.06, 0.03])), WIDE)
    for k in range(0, 40, 8):
        state, part, _ = map_localizer.step(state, scans[k : k + 8], rows[k : k + 8])
        given += part
    for one, two in zip(at_once, given, strict=True):
        np.testing.assert_array_equal(one.pose, two.pose)
        np.testing.assert_array_equal(one.covariance, two.covariance)


def test_far_from_all_keyframes_no_fit_is_tried(known, rng):
    poses = [np.array([0.3 * k, 0.0, 0.0]) for k in range(60)]
    _, rows = rows_along(poses, rng)
    scans = [scan_at(walk()[0], row.stamp, rng=rng) for row in rows]
    _, _, corrections = localised(known, poses, scans, rows)
    assert "the nearest place of the map is" in corrections[-1].reason


@pytest.mark.parametrize(
    ("pose", "covariance", "said"),
    [
        ([80.0, 0.0, 0.0], WIDE, r"The start \(80\.0, 0\.0\) m is .* m from the nearest place of the map"),
        ([np.nan, 0.0, 0.0], WIDE, "finite pose"),
        ([0.0, 0.0, 0.0], np.zeros((3, 3)), "larger than 0"),
    ],
)
def test_a_start_that_is_none_is_refused(known, pose, covariance, said):
    with pytest.raises(MappingError, match=said):
        map_localizer.init(known, NOWHERE, np.array(pose), covariance)


def test_a_map_that_shows_nothing_is_refused(mapped):
    scans = tuple(scan_at(pose, float(k), np.zeros((0, 4))) for k, pose in enumerate(mapped.graph.poses))
    with pytest.raises(MappingError, match="shows anything"):
        prepared(Map(mapped.graph, mapped.weights, scans, mapped.twists, mapped.session, mapped.sessions))


def test_covariances_against_the_whole_map_are_those_of_errors_without_their_best_rigid_motion(mapped):
    graph, n = mapped.graph, len(mapped.graph.poses)
    A, B = jacobians(graph.poses, graph.edges, residuals(graph.poses, graph.edges))
    J = np.zeros((len(A), 3, 3 * n))
    for e, (i, j) in enumerate(zip(graph.edges.i, graph.edges.j, strict=True)):
        J[e, :, 3 * i : 3 * i + 3], J[e, :, 3 * j : 3 * j + 3] = A[e], B[e]
    H = np.einsum("mia,mij,mjb->ab", J, information(graph.edges.covariance), J)
    C = np.zeros_like(H)
    C[3:, 3:] = np.linalg.inv(H[3:, 3:])
    G = adjoints(se2.between(graph.poses, np.zeros((n, 3)))).reshape(-1, 3)
    at = np.tile([1.0, 1.0, 0.0], n)[:, None] * G
    T = np.eye(3 * n) - G @ np.linalg.solve(at.T @ at, at.T)
    expected = (T @ C @ T.T).reshape(n, 3, n, 3)[range(n), :, range(n)]
    found = covariances_of(mapped)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-12)
