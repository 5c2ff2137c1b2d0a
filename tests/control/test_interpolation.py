"""Interpolation: through the points, smooth, at rest at the ends, and the polynomials that others know by name."""

import numpy as np
import pytest
from jacobians import assert_is_jacobian
from scipy.interpolate import BPoly, CubicHermiteSpline, CubicSpline

from longreach.configuration import ConfigurationTrajectory
from longreach.control.interpolation import sample, timed_points
from longreach.errors import ControlError


@pytest.fixture
def trajectory(rng):
    stamps = 100.0 + np.cumsum(rng.uniform(0.05, 0.4, 12))
    return ConfigurationTrajectory(stamps, rng.normal(size=(12, 9)), velocities=rng.normal(size=(12, 9)))


@pytest.mark.parametrize("degree", ["cubic", "quintic"])
def test_the_path_goes_through_every_point_with_its_velocity(trajectory, degree):
    q, qd, _ = sample(trajectory, trajectory.stamps, degree)
    np.testing.assert_allclose(q, trajectory.q, atol=1e-12)
    np.testing.assert_allclose(qd, trajectory.velocities, atol=1e-12)


@pytest.mark.parametrize("degree", ["cubic", "quintic"])
def test_velocities_and_accelerations_are_the_derivatives(trajectory, degree, rng):
    for t in rng.uniform(trajectory.stamps[1] + 0.01, trajectory.stamps[-1] - 0.01, 20).tolist():
        _, qd, qdd = sample(trajectory, t, degree)
        at = np.array([t])
        assert_is_jacobian(lambda s: sample(trajectory, float(s[0]), degree)[0], qd[:, None], at, atol=1e-5)
        assert_is_jacobian(lambda s: sample(trajectory, float(s[0]), degree)[1], qdd[:, None], at, atol=2e-3)


@pytest.mark.parametrize(("degree", "orders"), [("cubic", 2), ("quintic", 3)])
def test_a_cubic_is_smooth_to_the_velocity_and_a_quintic_to_the_acceleration(trajectory, degree, orders):
    knots, eps = trajectory.stamps[1:-1], 1e-9
    before, after = sample(trajectory, knots - eps, degree), sample(trajectory, knots + eps, degree)
    for order in range(orders):
        np.testing.assert_allclose(before[order], after[order], atol=1e-4)
    if degree == "cubic":
        assert np.abs(before[2] - after[2]).max() > 1.0


def test_a_cubic_is_that_of_scipy(trajectory, rng):
    t = rng.uniform(trajectory.stamps[0], trajectory.stamps[-1], 100)
    other = CubicHermiteSpline(trajectory.stamps, trajectory.q, trajectory.velocities)
    for order, ours in enumerate(sample(trajectory, t)):
        np.testing.assert_allclose(ours, other(t, order), rtol=1e-9, atol=1e-8)


def test_a_quintic_with_accelerations_is_that_of_scipy(trajectory, rng):
    t, a = rng.uniform(trajectory.stamps[0], trajectory.stamps[-1], 100), rng.normal(size=trajectory.q.shape)
    other = BPoly.from_derivatives(trajectory.stamps, np.stack([trajectory.q, trajectory.velocities, a], axis=1))
    for order, ours in enumerate(sample(trajectory, t, "quintic", a)):
        np.testing.assert_allclose(ours, other(t, order), rtol=1e-7, atol=1e-6)


def test_a_quintic_between_two_points_at_rest_has_the_least_jerk():
    s = np.linspace(0.0, 1.0, 21)
    q, _, _ = sample(timed_points(np.array([0.0, 2.0]), np.array([[1.0], [4.0]])), 2.0 * s, "quintic")
    np.testing.assert_allclose(q[:, 0], 1.0 + 3.0 * (10 * s**3 - 15 * s**4 + 6 * s**5), atol=1e-12)


def test_points_without_velocities_are_joined_by_the_spline_that_starts_and_ends_at_rest(rng):
    stamps, q = np.cumsum(rng.uniform(0.1, 1.0, 8)), rng.normal(size=(8, 3))
    t = np.linspace(stamps[0], stamps[-1], 50)
    other = CubicSpline(stamps, q, bc_type="clamped")
    for order, ours in enumerate(sample(timed_points(stamps, q), t)):
        np.testing.assert_allclose(ours, other(t, order), rtol=1e-9, atol=1e-9)


def test_given_velocities_stay_but_the_last_is_zero(rng):
    v = rng.normal(size=(3, 2))
    points = timed_points(np.arange(3.0), rng.normal(size=(3, 2)), v)
    np.testing.assert_array_equal(points.velocities[:-1], v[:-1])
    np.testing.assert_array_equal(points.velocities[-1], 0.0)


@pytest.mark.parametrize("degree", ["cubic", "quintic"])
def test_before_the_start_and_after_the_end_the_robot_stands(trajectory, degree):
    for t, row in ((trajectory.stamps[0] - 1.0, 0), (trajectory.stamps[-1] + 1.0, -1)):
        q, qd, qdd = sample(trajectory, float(t), degree)
        np.testing.assert_array_equal(q, trajectory.q[row])
        np.testing.assert_array_equal([qd, qdd], 0.0)


def test_a_single_point_is_held():
    q, qd, _ = sample(timed_points(np.array([1.0]), np.array([[0.3, -0.2]])), 1.0)
    np.testing.assert_array_equal(q, [0.3, -0.2])
    np.testing.assert_array_equal(qd, 0.0)


def test_accelerations_that_do_not_fit_are_refused(trajectory):
    for degree, a in (("cubic", np.zeros((12, 9))), ("quintic", np.zeros((3, 9)))):
        with pytest.raises(ControlError, match="one row of 9 for each of the 12 waypoints"):
            sample(trajectory, 0.0, degree, a)
