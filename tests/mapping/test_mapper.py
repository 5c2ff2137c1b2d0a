"""The mapper: loops closed, closures refused, and a batch that is a fold of the step."""

import numpy as np
import pytest
from rooms_to_map import ROUND, driven, mapped, ring, rows_of, scans_of

from longreach.geometry import se2
from longreach.mapping import mapper
from longreach.mapping.refinement import refined

DRIFT = (0.002, 0.002, 0.002)  # [1, 1, rad/m]


def errors(poses, truth_rows, state):
    at = {round(5 * k.stamp): n for n, k in enumerate(state.keyframes)}
    truth = np.array([truth_rows[k] for k in at])
    return np.hypot(*(se2.compose(truth[0], poses)[:, :2] - truth[:, :2]).T)


@pytest.fixture(scope="module")
def lap():
    rng = np.random.default_rng(3)
    truth, walls = driven([*ROUND, *ROUND[1:3]]), ring(rng)
    return truth, walls, scans_of(truth, walls, rng), rows_of(truth, DRIFT)


@pytest.fixture(scope="module")
def state(lap):
    _, _, scans, rows = lap
    return mapper.settled(mapper.step(mapper.init(np.eye(4)), scans, rows))


def test_a_loop_is_closed_and_drift_taken_back(lap, state):
    truth, *_ = lap
    before = errors(np.array([k.odom for k in state.keyframes]), truth, state)
    after = errors(state.poses, truth, state)
    assert len(state.accepted) > 5
    assert not state.withdrawn
    assert before.max() > 0.3
    assert after.max() < 0.5 * before.max()
    match = state.matches[state.accepted[-1]]
    at = [round(5 * state.keyframes[k].stamp) for k in (match.i, match.j)]
    seen, true = se2.between(*state.poses[[match.i, match.j]]), se2.between(*truth[at])
    np.testing.assert_allclose(seen, true, atol=0.03)


def test_a_refined_map_keeps_its_loops_closed(lap, state):
    truth, *_ = lap
    edges = mapper.closure_edges([state.matches[a] for a in state.accepted])
    solved = refined(state.keyframes, state.poses, edges).solved
    assert solved.converged
    assert np.count_nonzero(solved.weights) > len(state.accepted)
    assert errors(solved.poses, truth, state).max() < 0.2


def test_scans_and_rows_in_pieces_give_the_same_map(lap, state):
    _, _, scans, rows = lap
    pieces = mapper.init(np.eye(4))
    for i in range(0, len(rows), 7):
        pieces = mapper.step(pieces, scans[i : i + 7], [])  # rows settle later than scans come
        pieces = mapper.step(pieces, [], rows[max(i - 3, 0) : i + 4] if i else rows[:4])
    pieces = mapper.settled(mapper.step(pieces, [], rows[-7:]))
    assert [k.stamp for k in pieces.keyframes] == [k.stamp for k in state.keyframes]
    np.testing.assert_array_equal(pieces.poses, state.poses)


def test_moving_odom_moves_the_map_and_nothing_in_it(lap, state):
    _, _, scans, rows = lap
    by = np.array([3.0, -2.0, 1.0])
    moved = [row._replace(pose=se2.compose(by, row.pose)) for row in rows]
    other = mapper.settled(mapper.step(mapper.init(np.eye(4)), scans, moved))
    np.testing.assert_allclose(other.poses, se2.compose(by, state.poses), atol=1e-6)
    assert other.accepted == state.accepted


def test_rows_between_keyframes_follow_their_corrections(lap, state):
    _, _, _, rows = lap
    covariances = np.zeros((len(state.keyframes), 3, 3))
    poses, covariance = mapper.on_map(state.keyframes, state.poses, covariances, rows)
    at = {row.stamp: pose for row, pose in zip(rows, poses, strict=True)}
    for keyframe, pose in zip(state.keyframes, state.poses, strict=True):
        np.testing.assert_allclose(at[keyframe.stamp], pose, atol=1e-9)
    assert np.hypot(*np.diff(poses[:, :2], axis=0).T).max() < 0.5
    assert (np.linalg.eigvalsh(covariance) >= -1e-12).all()


def test_a_drive_that_never_comes_back_closes_nothing(rng):
    truth, walls = driven(ROUND[:3]), ring(rng)
    state = mapped(truth, walls, rng, drift=DRIFT)
    assert state.accepted == ()


def test_a_row_of_a_scan_already_used_is_not_taken_again(lap):
    _, _, scans, rows = lap
    state = mapper.step(mapper.init(np.eye(4)), scans[:20], rows[:20])
    again = mapper.step(state, [], rows[:20])
    assert len(again.keyframes) == len(state.keyframes)
    assert again.waiting == ()
