"""Where a filter starts."""

import numpy as np
import pytest

from longreach.app.start import start_pose
from longreach.geometry import se2
from longreach.measurement import PoseMeasurement
from longreach.trajectory import PoseTrajectory

MOTION = np.array([5.0, -3.0, 2.2])
SIGMA = 0.05


@pytest.fixture
def path():
    """Dead reckoning: 20 m along an arc in 20 s, from the identity on."""
    stamps = np.linspace(0.0, 20.0, 201)
    return PoseTrajectory(stamps, se2.exp(np.outer(stamps, [1.0, 0.0, 0.1])))


def position_fixes(path, stamps, rng=None):
    poses = se2.compose(MOTION, path.at(np.array(stamps))[0])
    if rng is not None:
        poses = poses + SIGMA * rng.normal(size=poses.shape)
    R = np.diag([SIGMA**2, SIGMA**2, np.inf])
    return [PoseMeasurement(float(t), np.array([*p[:2], 0.0]), R) for t, p in zip(stamps, poses, strict=True)]


def test_a_fix_with_heading_is_the_start_with_its_covariance_in_the_body_frame():
    R = np.diag([0.01, 0.04, 0.001])
    pose, covariance = start_pose([PoseMeasurement(0.0, np.array([1.0, 2.0, np.pi / 2]), R)], [], 0.0)
    np.testing.assert_array_equal(pose, [1.0, 2.0, np.pi / 2])
    np.testing.assert_allclose(covariance, 9.0 * np.diag([0.04, 0.01, 0.001]), atol=1e-15)


@pytest.mark.parametrize("first", [0.0, 2.0])
def test_fixes_without_heading_tell_it_from_the_way_between_them(path, first):
    pose, covariance = start_pose(position_fixes(path, np.arange(first, 20.0, 0.5)), [path], 0.0)
    np.testing.assert_allclose(se2.difference(MOTION, pose), 0.0, atol=1e-3)
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert np.sqrt(covariance[2, 2]) < np.radians(60.0)


def test_the_start_is_within_what_its_covariance_says(path, rng):
    nees = []
    for _ in range(60):
        pose, covariance = start_pose(position_fixes(path, np.arange(0.0, 20.0, 0.5), rng), [path], 0.0)
        error = se2.difference(pose, MOTION)
        nees.append(error @ np.linalg.solve(covariance, error))
    assert np.mean(nees) < 3.0  # larger than needed, for the fixes are fused as well
    assert np.max(nees) < 16.0


def test_the_first_path_that_has_rows_is_taken(path):
    empty = PoseTrajectory(np.zeros(0), np.zeros((0, 3)))
    pose, _ = start_pose(position_fixes(path, [0.0, 1.0, 2.0, 3.0]), [empty, path], 0.0)
    np.testing.assert_allclose(se2.difference(MOTION, pose), 0.0, atol=1e-3)


def test_one_fix_leaves_the_heading_open(path):
    pose, covariance = start_pose(position_fixes(path, [3.0]), [path], 0.0)
    assert covariance[2, 2] == pytest.approx(np.pi**2)
    assert np.isfinite(pose).all()


def test_without_any_path_the_first_fix_is_the_start(path):
    fixes = position_fixes(path, [3.0, 4.0])
    pose, covariance = start_pose(fixes, [], 3.0)
    np.testing.assert_array_equal(pose, [*fixes[0].pose[:2], 0.0])
    np.testing.assert_allclose(np.diag(covariance), [(3 * SIGMA) ** 2, (3 * SIGMA) ** 2, np.pi**2])


def test_fixes_that_dead_reckoning_does_not_reach_are_where_it_starts(path):
    fixes = position_fixes(path, [1.0, 2.0])
    late = [PoseMeasurement(100.0 + fix.stamp, fix.pose, fix.covariance) for fix in fixes]
    pose, covariance = start_pose(late, [path], 0.0)
    assert np.isfinite(pose).all()
    assert covariance[2, 2] == pytest.approx(np.pi**2)


def test_a_robot_that_stands_leaves_the_heading_open(rng):
    still = PoseTrajectory(np.arange(10.0), np.zeros((10, 3)))
    pose, covariance = start_pose(position_fixes(still, np.arange(10.0), rng), [still], 0.0)
    np.testing.assert_allclose(pose[:2], MOTION[:2], atol=0.2)
    assert np.sqrt(covariance[2, 2]) > 0.5
