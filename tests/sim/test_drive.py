"""The drive: smooth, within the robot's limits, and its derivatives are true."""

import numpy as np
import pytest

from longreach.robot.bases import MecanumBase
from longreach.robot.description import RobotDescription
from longreach.sim.drive import make_drive, middle, move
from longreach.sim.room import FREE

ROBOT = RobotDescription(
    name="thing",
    base=MecanumBase(wheel_radius=0.0759, half_length=0.319, half_width=0.2755),
    velocity_limits=(1.1, 1.1, 2.0),
    acceleration_limits=(2.5, 2.5, 1.0),
)


@pytest.fixture(params=[(0, 60.0), (1, 20.0), (2, 3.0)], ids=lambda p: f"{p[1]:.0f}s")
def drive(request):
    return make_drive(ROBOT, request.param[1], np.random.default_rng(request.param[0]))


def test_velocity_and_acceleration_are_the_derivatives_of_the_pose(drive, rng):
    t, h = rng.uniform(0.0, drive.duration, 200), 1e-5
    before, now, after = (move(drive, t + k * h) for k in (-1, 0, 1))
    np.testing.assert_allclose((after.poses - before.poses) / (2 * h), now.velocity, atol=1e-6)
    np.testing.assert_allclose((after.velocity - before.velocity) / (2 * h), now.acceleration, atol=1e-3)


def test_it_starts_at_the_identity_and_stands_at_both_ends(drive):
    ends = move(drive, np.array([0.0, drive.duration]))
    np.testing.assert_allclose(ends.poses[0], 0.0, atol=1e-15)
    np.testing.assert_allclose(ends.velocity, 0.0, atol=1e-12)


def test_it_keeps_the_limits_and_stays_in_the_free_part(drive):
    motion = move(drive, np.arange(0.0, drive.duration, 0.003))
    assert np.hypot(*motion.velocity[:, :2].T).max() < 1.1
    assert np.abs(motion.velocity[:, 2]).max() < 2.0
    assert np.hypot(*motion.acceleration[:, :2].T).max() < 2.5
    assert np.abs(motion.acceleration[:, 2]).max() < 1.0
    assert (np.abs(motion.poses[:, :2] - middle(drive)).max(axis=0) < FREE).all()


def test_a_minute_of_it_is_fast_and_erratic():
    drive = make_drive(ROBOT, 60.0, np.random.default_rng(5))
    motion = move(drive, np.arange(0.0, 60.0, 0.01))
    assert np.hypot(*motion.velocity[:, :2].T).mean() > 0.35
    assert np.ptp(motion.poses[:, 2]) > 1.0
    reversals = np.diff(np.sign(motion.twist), axis=0).astype(bool).sum(axis=0)
    assert (reversals > 6).all()
