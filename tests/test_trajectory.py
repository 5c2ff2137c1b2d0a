import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from longreach.errors import LongreachError
from longreach.geometry import se2
from longreach.trajectory import PoseTrajectory, monotone_clock

# Stamps in milliseconds on a grid, at an offset of up to today's date: ties, jumps back and forth.
offsets = st.sampled_from([0.0, 976052857.0, 1.7e9])
grids = st.lists(st.integers(0, 40), min_size=1, max_size=30)


def good(stamps):
    """Which stamps are later than all before and earlier than all after, the slow way."""
    return np.array([np.all(stamps[:i] < s) and np.all(stamps[i + 1 :] > s) for i, s in enumerate(stamps)])


def stretches(stamps):
    """(start, stop) of each stretch of stamps that are not good."""
    edges = np.flatnonzero(np.diff(np.concatenate(([True], good(stamps), [True]))))
    return edges.reshape(-1, 2)


@given(offsets, grids)
def test_the_clock_never_runs_backwards_nor_stands_still(offset, grid):
    assert np.all(np.diff(monotone_clock(offset + 1e-3 * np.array(grid))) > 0)


@given(offsets, grids)
def test_stamps_in_order_with_all_others_are_kept_bit_for_bit(offset, grid):
    stamps = offset + 1e-3 * np.array(grid)
    clock = monotone_clock(stamps)
    assert_array_equal(clock[good(stamps)], stamps[good(stamps)])


@given(offsets, st.sets(st.integers(0, 10**6), min_size=1))
def test_increasing_stamps_are_kept_bit_for_bit(offset, grid):
    stamps = offset + 1e-6 * np.array(sorted(grid))
    assume(np.all(np.diff(stamps) > 0))
    assert_array_equal(monotone_clock(stamps), stamps)


@given(offsets, grids)
def test_no_step_of_a_repaired_stretch_is_far_shorter_than_the_even_one(offset, grid):
    stamps = offset + 1e-3 * np.array(grid)
    clock = monotone_clock(stamps)
    for start, stop in stretches(stamps):
        low = stamps[start - 1] if start > 0 else stamps[start:stop].min()
        high = stamps[stop] if stop < len(stamps) else stamps[start:stop].max()
        even = ((high - low) or 1.0) / (stop - start + 1)
        steps = np.diff(clock[max(start - 1, 0) : stop + 1])
        assert np.all(steps >= 0.49 * even)


@given(grids)
def test_a_repaired_clock_needs_no_repair(grid):
    clock = monotone_clock(1e-3 * np.array(grid))
    assert_array_equal(monotone_clock(clock), clock)


@given(grids, st.integers(0, 1000))
def test_a_shifted_recording_has_a_shifted_clock(grid, shift):
    stamps = 1e-3 * np.array(grid)
    assert_allclose(monotone_clock(stamps + shift), monotone_clock(stamps) + shift, atol=1e-9)


def test_one_stamp_that_jumps_back_is_put_between_its_neighbours():
    stamps = np.array([0.0, 1.0, 2.0, 1.5, 3.0, 4.0])
    clock = monotone_clock(stamps)
    assert_array_equal(clock[[0, 1, 4, 5]], [0.0, 1.0, 3.0, 4.0])
    assert_allclose(clock[2:4], [1.75 - 1 / 6, 1.75 + 1 / 6])


def test_equal_stamps_are_spread_around_where_they_were():
    clock = monotone_clock(np.array([0.0, 1.0, 1.0, 1.0, 2.0]))
    assert_allclose(clock, [0.0, 0.75, 1.0, 1.25, 2.0])


def test_a_recording_whose_stamps_are_all_equal_gets_a_clock_of_about_a_second():
    clock = monotone_clock(np.full(4, 7.0))
    assert_allclose(clock.mean(), 7.0)
    assert_allclose(np.diff(clock), 0.1)


def test_one_wild_stamp_moves_no_stamp_past_a_good_one():
    stamps = np.concatenate([np.arange(10.0), [1000.0], np.arange(10.0, 20.0), [2000.0, 2001.0]])
    clock = monotone_clock(stamps)
    assert_array_equal(clock[:10], stamps[:10])
    assert_array_equal(clock[-2:], stamps[-2:])
    assert np.all(np.diff(clock) > 0)


@pytest.mark.parametrize("n", [0, 1])
def test_too_few_stamps_to_be_out_of_order_are_kept(n):
    assert_array_equal(monotone_clock(np.full(n, 5.0)), np.full(n, 5.0))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_stamp_that_is_no_number_makes_no_clock(bad):
    with pytest.raises(LongreachError, match="finite numbers of seconds"):
        monotone_clock(np.array([0.0, bad, 1.0]))


def test_stamps_that_leave_no_room_are_refused():
    stamp = 1.7e9
    with pytest.raises(LongreachError, match="too close together"):
        monotone_clock(np.array([stamp, *[np.nextafter(stamp, 2e9)] * 5, np.nextafter(np.nextafter(stamp, 2e9), 2e9)]))


@pytest.fixture
def turn():
    """A quarter of a circle of radius 1 in 1 s, then 3 s of silence, then straight ahead for 1 s."""
    stamps = np.array([0.0, 1.0, 4.0, 5.0])
    poses = np.array([[0, 0, 0], [1, 1, np.pi / 2], [1, 2, np.pi / 2], [1, 3, np.pi / 2]])
    return PoseTrajectory(stamps, poses)


def test_a_pose_between_two_rows_lies_on_the_arc_between_them(turn):
    poses, known = turn.at(np.array([0.5]))
    assert_allclose(poses, [[np.sqrt(0.5), 1 - np.sqrt(0.5), np.pi / 4]])
    assert known.all()


def test_the_rows_themselves_come_back(turn):
    poses, known = turn.at(turn.clock, longest_gap=0.1)
    assert_allclose(poses, turn.poses)
    assert known.all()


def test_nothing_is_known_outside_the_trajectory_and_in_long_gaps(turn):
    poses, known = turn.at(np.array([-1.0, 0.5, 2.0, 4.5, 6.0]), longest_gap=1.0)
    assert known.tolist() == [False, True, False, True, False]
    assert_allclose(poses[[0, 4]], turn.poses[[0, 3]])


def test_interpolation_crosses_the_half_turn_the_short_way():
    trajectory = PoseTrajectory(np.array([0.0, 1.0]), np.array([[0.0, 0, 3.0], [0.0, 0, -3.0]]))
    poses, _ = trajectory.at(np.array([0.5]))
    assert_allclose(np.abs(poses[0, 2]), np.pi)


@given(st.integers(0, 2**32 - 1))
def test_interpolation_moves_at_constant_speed_between_two_rows(seed):
    rng = np.random.default_rng(seed)
    trajectory = PoseTrajectory(np.array([3.0, 4.0]), rng.uniform(-3, 3, size=(2, 3)))
    poses, _ = trajectory.at(np.linspace(3.0, 4.0, 5))
    steps = se2.difference(poses[:-1], poses[1:])
    assert_allclose(steps, np.tile(steps[0], (4, 1)), atol=1e-9)


def test_an_empty_trajectory_knows_no_pose_and_has_no_clock():
    empty = PoseTrajectory(np.zeros(0), np.zeros((0, 3)))
    assert len(empty) == 0
    poses, known = empty.at(np.array([1.0]))
    assert poses.shape == (1, 3)
    assert not known.any()
    with pytest.raises(LongreachError, match="empty"):
        empty.clock_at(np.array([1.0]))


def test_one_row_is_known_at_its_own_time_only():
    one = PoseTrajectory(np.array([2.0]), np.array([[1.0, 2.0, 3.0]]))
    _, known = one.at(np.array([1.9, 2.0, 2.1]))
    assert known.tolist() == [False, True, False]


def test_the_clock_at_a_rows_stamp_is_that_rows_clock():
    stamps = np.array([0.0, 1.0, 2.0, 1.5, 3.0])
    trajectory = PoseTrajectory(stamps, np.zeros((5, 3)))
    assert_array_equal(trajectory.clock_at(stamps), trajectory.clock)
    assert np.any(trajectory.clock != stamps)


def test_the_clock_between_stamps_is_that_of_the_nearest_row_and_the_rest():
    trajectory = PoseTrajectory(np.array([10.0, 11.0]), np.zeros((2, 3)), clock=np.array([0.0, 5.0]))
    assert_allclose(trajectory.clock_at(np.array([9.0, 10.2, 10.9, 12.0])), [-1.0, 0.2, 4.9, 6.0])


def test_the_arrays_are_copies_that_cannot_be_written(turn):
    stamps = np.array([0.0, 1.0])
    trajectory = PoseTrajectory(stamps, np.zeros((2, 3)), np.zeros((2, 3, 3)))
    stamps[0] = 0.5
    assert trajectory.stamps[0] == 0.0
    for array in (trajectory.stamps, trajectory.clock, trajectory.poses, trajectory.covariance):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@pytest.mark.usefixtures("unchecked")  # callers have no shape checks in front of ours
@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"poses": np.zeros((3, 3))}, r"poses has shape \(3, 3\), expected \(2, 3\)"),
        ({"covariance": np.zeros((1, 3, 3))}, "covariance has shape"),
        ({"clock": np.zeros(3)}, "clock has shape"),
        ({"poses": np.full((2, 3), np.nan)}, "poses must be finite"),
        ({"stamps": np.array([0.0, np.inf])}, "finite numbers of seconds"),
        ({"clock": np.array([1.0, 0.0])}, "must not run backwards"),
    ],
)
def test_a_trajectory_that_does_not_fit_together_is_refused(changes, sentence):
    whole = {"stamps": np.array([0.0, 1.0]), "poses": np.zeros((2, 3))}
    with pytest.raises(LongreachError, match=sentence):
        PoseTrajectory(**(whole | changes))
