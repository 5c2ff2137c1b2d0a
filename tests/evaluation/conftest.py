"""Made trajectories for the tests of this room."""

import numpy as np
import pytest

from longreach.geometry import se2
from longreach.trajectory import PoseTrajectory


@pytest.fixture
def drive(rng):
    """A base that drives, sidesteps and turns at random for 40 s."""
    n, step = 400, 0.1
    twists = np.cumsum(rng.normal(size=(n, 3)), axis=0) * np.array([0.03, 0.02, 0.05])
    poses = [np.array([1.0, -2.0, 0.5])]
    for twist in twists[:-1]:
        poses.append(se2.retract(poses[-1], twist * step))
    return PoseTrajectory(step * np.arange(n), np.array(poses))


@pytest.fixture
def disturb(rng):
    """Add an independent error to each row, in its own frame, and state that error's covariance."""

    def disturbed(trajectory, size=0.05):
        deviations = size * np.array([1.0, 0.7, 0.3])
        xi = rng.normal(size=trajectory.poses.shape) * deviations
        covariance = np.tile(np.diag(deviations**2), (len(trajectory), 1, 1))
        return PoseTrajectory(trajectory.stamps, se2.retract(trajectory.poses, -xi), covariance, trajectory.clock)

    return disturbed
