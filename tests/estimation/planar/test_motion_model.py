from dataclasses import replace

import numpy as np
import pytest
from jacobians import assert_is_jacobian
from scipy.linalg import expm
from true_motion import draw

from longreach.estimation.planar import _ekf_kernels as kernels
from longreach.estimation.planar import ekf, motion_model
from longreach.estimation.planar.config import FilterConfig
from longreach.geometry import se2

MODEL = motion_model.MotionModel(0.5, np.array([1.0, 0.7, 2.0]) ** 2, 1e-3)


def chain(dt, tau):
    f, g, e, q = kernels.singer(float(dt), float(tau))
    return (
        np.array([[1.0, dt, f], [0.0, 1.0, g], [0.0, 0.0, e]]),
        np.array([[q[0], q[1], q[2]], [q[1], q[3], q[4]], [q[2], q[4], q[5]]]),
    )


def random_mean(rng, clones=0):
    mean = rng.normal(size=13 + 3 * clones)
    mean[5] *= 2.0
    return mean


def difference(a, b):
    out = b - a
    for i in (0, *range(13, len(a), 3)):
        out[i : i + 3] = se2.difference(a[i : i + 3], b[i : i + 3])
    return out


@pytest.mark.parametrize("dt", [0.03, 0.3, 0.4999, 0.5001, 1.0, 4.0])
def test_the_discrete_chain_is_that_of_van_loan(dt):
    tau = 0.5
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / tau]])
    G = np.diag([0.0, 0.0, 2.0 / tau])
    block = expm(np.block([[-A, G], [np.zeros((3, 3)), A.T]]) * dt)
    Phi = block[3:, 3:].T
    Phi_ours, Q_ours = chain(dt, tau)
    np.testing.assert_allclose(Phi_ours, Phi, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(Q_ours, Phi @ block[:3, 3:], rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("first", [1e-5, 1e-3, 0.1, 0.45, 0.6, 30.0])
@pytest.mark.parametrize("second", [1e-5, 1e-3, 0.1, 0.45, 0.6, 30.0])
def test_two_short_predictions_are_one_long_one(first, second):
    (Phi1, Q1), (Phi2, Q2), (Phi, Q) = chain(first, 0.5), chain(second, 0.5), chain(first + second, 0.5)
    np.testing.assert_allclose(Phi2 @ Phi1, Phi, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(Phi2 @ Q1 @ Phi2.T + Q2, Q, rtol=1e-11)


def test_unmeasured_acceleration_keeps_its_stationary_variance():
    Phi, Q = chain(0.37, 0.5)
    assert Phi[2, 2] ** 2 + Q[2, 2] == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize("dt", [1e-3, 0.1, 2.0])
@pytest.mark.parametrize("clones", [0, 2])
def test_the_transition_jacobian_is_its_derivative(rng, dt, clones):
    mean = random_mean(rng, clones)
    _, F, _ = motion_model.transition(MODEL, mean, dt)
    assert_is_jacobian(
        lambda x: motion_model.transition(MODEL, x, dt)[0],
        F,
        mean,
        motion_model.retract,
        difference,
        atol=2e-6,
        step=1e-5,
    )


def test_no_time_changes_nothing(rng):
    mean = random_mean(rng, 1)
    new, F, Q = motion_model.transition(MODEL, mean, 0.0)
    np.testing.assert_array_equal(new, mean)
    np.testing.assert_allclose(F, np.eye(16), atol=1e-15)
    np.testing.assert_array_equal(Q, 0.0)


def test_constant_twist_moves_along_the_exponential(rng):
    mean = random_mean(rng)
    mean[6:9] = 0.0
    new, _, _ = motion_model.transition(MODEL, mean, 1.7)
    np.testing.assert_allclose(new[:3], se2.retract(mean[:3], 1.7 * mean[3:6]), atol=1e-14)
    np.testing.assert_array_equal(new[3:], mean[3:])


def test_draws_spread_as_the_process_noise_says(rng):
    mean, dt = random_mean(rng), 0.1
    new, _, Q = motion_model.transition(MODEL, mean, dt)
    errors = np.array([difference(new, draw(MODEL, mean, dt, rng)) for _ in range(4000)])
    np.testing.assert_array_equal(errors[:, 10:], 0.0)
    L = np.linalg.cholesky(Q[:10, :10])
    whitened = np.linalg.solve(L, errors[:, :10].T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(10), atol=0.12)
    np.testing.assert_allclose(whitened.mean(axis=1), 0.0, atol=0.08)


def spread(rng, scale):
    A = rng.normal(size=(13, 13))
    return scale**2 * (A @ A.T / 13 + 0.1 * np.eye(13))


def test_stamps_that_are_off_add_what_the_base_moves_in_that_time(rng):
    mean, P = random_mean(rng), spread(rng, 1.0)
    mean[3:6] *= 0.5
    exact = ekf.predict(MODEL, mean, P, 0.1)
    off = ekf.predict(replace(MODEL, stamp_deviation=0.02), mean, P, 0.1)
    np.testing.assert_array_equal(off[0], exact[0])
    added = off[1] - exact[1]
    np.testing.assert_allclose(added[3:], 0.0, atol=1e-15)
    np.testing.assert_allclose(added[:, 3:], 0.0, atol=1e-15)
    velocities = mean[3:6] + rng.normal(size=(40_000, 3)) @ np.linalg.cholesky(P[3:6, 3:6]).T
    moved = 0.02 * rng.normal(size=(40_000, 1)) * velocities
    np.testing.assert_allclose(added[:3, :3], np.cov(moved.T), atol=0.03 * np.abs(added).max())


def test_stamps_that_are_off_do_not_matter_to_a_base_that_stands():
    P = np.diag([1.0, 1.0, 1.0, *[0.0] * 10])
    off = replace(MODEL, stamp_deviation=10.0)
    np.testing.assert_array_equal(
        ekf.predict(off, np.zeros(13), P, 0.1)[1], ekf.predict(MODEL, np.zeros(13), P, 0.1)[1]
    )


def test_the_filters_settings_reach_the_motion_model():
    config = FilterConfig(stamp_deviation=0.03, acceleration_deviation=(1.0, 2.0, 3.0), gyro_bias_walk=0.1)
    assert config.motion.stamp_deviation == 0.03
    np.testing.assert_allclose(config.motion.acceleration_variance, [1.0, 4.0, 9.0])
    assert config.motion.bias_walk == pytest.approx(0.01)
