"""Trajectories as TUM files: nothing is lost on the way there and back."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tangents import tangents

from longreach.errors import RecordingError
from longreach.geometry import se2, se3
from longreach.io.tum import read_spatial_tum, read_tum, write_spatial_tum, write_tum
from longreach.trajectory import PoseTrajectory


@pytest.fixture
def path(tmp_path):
    return tmp_path / "a.tum"


def test_a_trajectory_comes_back(path, rng):
    stamps = 1.7e9 + np.sort(rng.uniform(0, 100, 50))
    poses = np.column_stack([rng.uniform(-1e3, 1e3, (50, 2)), rng.uniform(-np.pi, np.pi, 50)])
    poses[:4, 2] = [0.0, np.pi, -np.pi + 1e-9, 1e-9]
    write_tum(path, PoseTrajectory(stamps, poses))
    found = read_tum(path)
    np.testing.assert_array_equal(found.stamps, stamps)
    np.testing.assert_allclose(found.poses[:, :2], poses[:, :2], atol=1e-9)
    np.testing.assert_allclose(se2.difference(poses, found.poses)[:, 2], 0.0, atol=1e-11)
    assert found.has_heading


def test_stamps_that_run_backwards_are_kept_in_the_order_of_the_file(path):
    stamps = np.array([976052857.3, 976052859.0, 976052858.1, 976052858.1, 976052860.5])
    poses = np.arange(15.0).reshape(5, 3) / 10
    write_tum(path, PoseTrajectory(stamps, poses))
    found = read_tum(path)
    np.testing.assert_array_equal(found.stamps, stamps)
    np.testing.assert_allclose(found.poses, poses, atol=1e-9)
    assert np.all(np.diff(found.clock) > 0)


def test_a_line_has_at_least_six_decimals_and_a_comment_says_what_the_columns_are(path):
    write_tum(path, PoseTrajectory(np.array([1.5]), np.array([[1.0, 2.0, np.pi / 2]])))
    comment, line = path.read_text().splitlines()
    assert comment == "# stamp[s] x[m] y[m] z[m] qx qy qz qw"
    stamp, x, y, z, qx, qy, qz, qw = line.split()
    assert (stamp, x, y) == ("1.500000000", "1.000000000", "2.000000000")
    assert [float(v) for v in (z, qx, qy)] == [0.0, 0.0, 0.0]
    assert [float(v) for v in (qz, qw)] == pytest.approx([np.sqrt(0.5)] * 2, abs=1e-12)


def test_positions_without_headings_come_back_as_such(path):
    poses = np.array([[1.0, 2.0, 0.0], [3.0, 4.0, 0.0]])
    write_tum(path, PoseTrajectory(np.array([0.0, 1.0]), poses, has_heading=False))
    found = read_tum(path)
    assert not found.has_heading
    np.testing.assert_array_equal(found.poses, poses)


@given(st.lists(tangents(3, 3), min_size=1, max_size=5))
def test_poses_in_space_come_back(tmp_path_factory, found):
    path = tmp_path_factory.mktemp("tum") / "tool.tum"
    stamps = 0.1 * np.arange(len(found))
    T = se3.exp(np.array(found))
    write_spatial_tum(path, stamps, T)
    again, read = read_spatial_tum(path)
    np.testing.assert_allclose(again, stamps, atol=1e-9)
    np.testing.assert_allclose(read, T, atol=1e-9)


def test_the_planar_part_of_poses_in_space_is_x_y_and_yaw(path):
    T = se3.from_rotation_translation(
        np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([1.0, 2.0, 3.0])
    )
    write_spatial_tum(path, np.array([5.0]), T[None])
    np.testing.assert_allclose(read_tum(path).poses, [[1.0, 2.0, np.pi / 2]], atol=1e-11)


def test_quaternions_of_any_length_and_sign_and_commas_are_read(path):
    path.write_text("# x\n\n0 1 2 3 0 0 -2 -2\n1,1,2,3,0,0,0.5,0.5\n2 1 2 3 0 0 0 -1\n")
    np.testing.assert_allclose(read_tum(path).poses, [[1, 2, np.pi / 2], [1, 2, np.pi / 2], [1, 2, 0]], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("0 1 2 3 0 0 0 1\n1 1 2 3 0 0 0 0\n", "line 2: the quaternion is zero"),
        ("0 1 2 3 0 0 0\n", "line 1: a TUM line is stamp x y z qx qy qz qw, 8 finite numbers"),
        ("0 1 2 nan 0 0 0 1\n", "line 1: a TUM line is"),
        ("0 1 2 x 0 0 0 1\n", "line 1: 'x' is not a number"),
        ("# nothing\n\n", "holds no poses"),
        ("", "holds no poses"),
    ],
)
def test_what_is_no_trajectory_is_said(path, text, sentence):
    path.write_text(text)
    with pytest.raises(RecordingError, match=sentence) as caught:
        read_tum(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("text", ["\ufeff# a mark\n0 1 2 3 0 0 0 1\n", "  # in\r\n\t0\t1  2 3 0 0 0 1 \r\n"])
def test_marks_of_the_encoding_and_spaces_around_are_no_matter(path, text):
    path.write_bytes(text.encode())
    np.testing.assert_array_equal(read_tum(path).poses, [[1.0, 2.0, 0.0]])


def test_a_file_that_is_not_there_is_said(path):
    with pytest.raises(RecordingError, match=r"a\.tum is not there"):
        read_tum(path)
