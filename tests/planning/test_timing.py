"""Time parametrisation: limits hold, the path is kept, and nothing heavy or loud comes with it."""

import subprocess
import sys

import numpy as np
import pytest

from longreach.configuration import ConfigurationTrajectory
from longreach.errors import PlanningError
from longreach.planning.timing import retime

VELOCITY = np.array([1.1, 1.1, 2.0, 2.1, 2.1, 3.1])
ACCELERATION = np.array([2.5, 2.5, 1.0, 10.0, 10.0, 10.0])


def wavy(rng, waypoints=40):
    """A smooth path of six joints."""
    u = np.linspace(0.0, 1.0, waypoints)[:, None]
    q = rng.normal(size=6) * u + 0.4 * np.sin(2 * np.pi * rng.uniform(0.5, 2.0, 6) * u + rng.uniform(0, 6, 6))
    return ConfigurationTrajectory(5.0 + u[:, 0], q, tuple("xyzabc"))


@pytest.mark.parametrize("seed", range(4))
def test_the_limits_hold_and_one_of_them_is_used(seed):
    fast = retime(wavy(np.random.default_rng(seed)), VELOCITY, ACCELERATION, rate=500.0)
    dt = np.diff(fast.stamps)
    assert np.all(np.abs(fast.velocities) <= VELOCITY * (1 + 1e-9))
    assert np.all(np.abs(np.diff(fast.q, axis=0)) <= VELOCITY * dt[:, None] * (1 + 1e-9))
    assert np.all(np.abs(np.diff(fast.velocities, axis=0)) <= ACCELERATION * dt[:, None] * (1 + 1e-6))
    used = np.maximum(
        np.abs(fast.velocities[1:-1]) / VELOCITY,
        np.abs(np.gradient(fast.velocities, dt[0], axis=0))[1:-1] / ACCELERATION,
    )
    assert np.median(used.max(axis=1)) > 0.9


def test_the_path_is_kept_from_rest_to_rest(rng):
    slow = wavy(rng)
    fast = retime(slow, VELOCITY, ACCELERATION, rate=2000.0)
    np.testing.assert_allclose(fast.q[[0, -1]], slow.q[[0, -1]], atol=1e-9)
    np.testing.assert_allclose(fast.velocities[[0, -1]], 0.0, atol=1e-9)
    distance = np.linalg.norm(fast.q[:, None] - slow.q[None], axis=2).min(axis=0)
    assert distance.max() < 1e-3
    assert fast.stamps[0] == slow.stamps[0]
    assert fast.joint_names == slow.joint_names


def test_one_joint_moves_as_the_trapezoid_does():
    q = np.linspace(0.0, 2.0, 9)[:, None]
    fast = retime(ConfigurationTrajectory(np.arange(9.0), q), np.array([0.5]), np.array([1.0]))
    assert fast.duration == pytest.approx(4.5, rel=1e-2)


def test_looser_limits_are_never_slower(rng):
    path = wavy(rng)
    assert retime(path, 2 * VELOCITY, 4 * ACCELERATION).duration == pytest.approx(
        0.5 * retime(path, VELOCITY, ACCELERATION).duration, rel=1e-2
    )


def test_waypoints_that_repeat_do_no_harm(rng):
    path = wavy(rng, 10)
    doubled = ConfigurationTrajectory(np.arange(20.0), np.repeat(path.q, 2, axis=0))
    assert retime(doubled, VELOCITY, ACCELERATION).duration == pytest.approx(
        retime(path, VELOCITY, ACCELERATION).duration
    )


def test_a_robot_that_stands_still_has_one_configuration():
    still = ConfigurationTrajectory(np.arange(3.0), np.ones((3, 6)))
    assert len(retime(still, VELOCITY, ACCELERATION)) == 1
    assert len(retime(ConfigurationTrajectory(np.zeros(1), np.ones((1, 6))), VELOCITY, ACCELERATION)) == 1


@pytest.mark.parametrize("wrong", [np.ones(5), np.zeros(6), np.full(6, np.nan)])
def test_limits_that_are_none_are_refused(rng, wrong):
    with pytest.raises(PlanningError, match="6 positive numbers"):
        retime(wavy(rng), wrong, wrong)


def test_toppra_is_loaded_only_when_it_is_needed():
    code = "import sys, longreach.planning.timing; print('toppra' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "False"


def test_velocities_are_those_of_a_parabola():
    t = np.array([0.0, 0.1, 0.3, 0.4, 0.9])
    trajectory = ConfigurationTrajectory(t, np.column_stack([t**2, 3.0 - t]))
    np.testing.assert_allclose(trajectory.velocities, np.column_stack([2 * t, -np.ones(5)]), atol=1e-12)
    assert trajectory.duration == 0.9


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((np.zeros(0), np.zeros((0, 2))), "at least one row"),
        ((np.zeros(2), np.zeros((2, 2))), "must increase"),
        ((np.arange(2.0), np.array([[0.0], [np.nan]])), "q must be finite"),
        ((np.arange(2.0), np.zeros((2, 2)), ("one",)), "1 joint names for 2 joints"),
    ],
)
def test_what_is_no_trajectory_is_refused(arguments, sentence):
    with pytest.raises(PlanningError, match=sentence):
        ConfigurationTrajectory(*arguments)


def test_the_arrays_are_read_only(rng):
    with pytest.raises(ValueError, match="read-only"):
        wavy(rng).q[0, 0] = 1.0
