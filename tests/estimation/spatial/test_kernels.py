"""The steps of the 15-state filter: Jacobian, prediction, correction, against the textbook and each other."""

import numpy as np
import pytest
from jacobians import assert_is_jacobian

from longreach.estimation.spatial import _kernels as kernels
from longreach.estimation.spatial.online import init
from longreach.spatial_measurement import SpatialRecording
from longreach.spatial_settings import SpatialSettings

Q = SpatialSettings(()).process_noise


def spd(rng, n, scale):
    A = rng.normal(size=(n, n))
    return scale**2 * (A @ A.T / n + 0.1 * np.eye(n))


def moved(x, dt, lead):
    out = np.empty(15)
    kernels.move(x, dt, lead, np.empty((3, 3)), out)
    return out


def transition(x, dt, lead):
    R, J, F = np.empty((3, 3)), np.empty((6, 12)), np.eye(15)
    kernels.move(x, dt, lead, R, np.empty(15))
    kernels.jacobian(x, dt, lead, R, J)
    F[:6, 3:] += J
    F[6:9, 12:] = dt * np.eye(3)
    return F


def advance(x, P, dt, **settings):
    x, P = x.copy(), P.copy()
    state = init(SpatialSettings((), **settings), SpatialRecording("none", ()))
    kernels.advance(x, P, dt, dt, state.model, state.control, kernels.work_room())
    return x, P


def correct(x, P, start, r, H, R, gate=np.inf):
    x, P = x.copy(), P.copy()
    room = kernels.work_room()[1]
    nis = kernels.correct(x, P, P, False, len(r), start, H.shape[1], r, H, R, gate, room)
    return x, P, nis


@pytest.mark.parametrize("lead", [0.0, 0.5])
@pytest.mark.parametrize("dt", [0.01, 0.4])
def test_the_jacobian_of_the_motion_is_right(rng, lead, dt):
    for _ in range(5):
        x = rng.normal(size=15) * 0.6
        assert_is_jacobian(lambda x: moved(x, dt, lead), transition(x, dt, lead), x, atol=1e-7)


@pytest.mark.parametrize("gravity", [0.0, 9.81])
def test_the_jacobian_of_an_acceleration_is_right_in_tilt_and_acceleration(rng, gravity):
    room, H = kernels.work_room(), rng.normal(size=(6, 6))
    x, turning, lever = rng.normal(size=15) * 0.5, rng.normal(size=3), rng.normal(size=3)
    row = (12, 3, np.inf, gravity, rng.normal(size=6), H, np.eye(6), lever)

    def innovation(x):
        kernels.observe(x, np.zeros((15, 15)), row, turning, False, room)
        return room[2][0][:3].copy()

    innovation(x)
    A, C = room[2][1][:3].copy(), room[2][3][:3].copy()
    full = np.zeros((3, 15))
    full[:, 3:6], full[:, 6:12], full[:, 12:] = A[:, :3], C, A[:, 9:]
    assert_is_jacobian(innovation, -full, x)


def test_the_midpoint_rule_follows_a_turn_to_second_order():
    x = np.zeros(15)
    x[6], x[11] = 1.0, 1.0  # a circle of 1 m
    exact = np.array([np.sin(0.2), 1 - np.cos(0.2)])
    first, second = (np.linalg.norm(moved(x, 0.2, lead)[:2] - exact) for lead in (0.0, 0.5))
    assert second < 4e-4
    assert first > 50 * second


def test_prediction_is_that_of_the_textbook(rng):
    x, P = rng.normal(size=15) * 0.5, spd(rng, 15, 0.1)
    F = transition(x, 0.2, 0.5)
    ours, covariance = advance(x, P, 0.2)
    np.testing.assert_allclose(ours, moved(x, 0.2, 0.5), atol=1e-14)
    np.testing.assert_allclose(covariance, F @ P @ F.T + 0.2 * Q, atol=1e-14)


def test_without_rotation_it_is_the_linear_kalman_filter(rng):
    x, P = np.zeros(15), np.zeros((15, 15))
    linear = np.r_[0:3, 6:9, 12:15]
    P[np.ix_(linear, linear)] = spd(rng, 9, 0.3)
    noise = np.zeros((15, 15))
    noise[linear, linear] = rng.uniform(0.01, 0.1, 9)
    y, S = x[linear].copy(), P[np.ix_(linear, linear)].copy()
    for k in range(60):
        dt = float(rng.uniform(0.0, 0.3))
        x, P = advance(x, P, dt, process_noise=noise)
        F = np.kron(np.array([[1, dt, dt * dt / 2], [0, 1, dt], [0, 0, 1]]), np.eye(3))
        y, S = F @ y, F @ S @ F.T + dt * noise[np.ix_(linear, linear)]
        start = (0, 6, 12)[k % 3]
        H, R, z = rng.normal(size=(2, 3)), spd(rng, 2, 0.2), rng.normal(size=2)
        G = np.zeros((2, 9))
        G[:, 3 * (k % 3) : 3 * (k % 3) + 3] = H
        x, P, nis = correct(x, P, start, z - H @ x[start : start + 3], H, R)
        V, r = G @ S @ G.T + R, z - G @ y
        K = S @ G.T @ np.linalg.inv(V)
        y, S = y + K @ r, (np.eye(9) - K @ G) @ S
        assert nis == pytest.approx(r @ np.linalg.solve(V, r))
        np.testing.assert_allclose(x[linear], y, atol=1e-9)
        np.testing.assert_allclose(P[np.ix_(linear, linear)], S, atol=1e-9)


def test_covariance_stays_symmetric_and_positive_over_random_steps(rng):
    x, P = np.zeros(15), spd(rng, 15, 0.3)
    for k in range(3000):
        x, P = advance(x, P, float(10.0 ** rng.uniform(-4, 0.3)), filter=("ekf", "ukf")[k % 2])
        rows = int(rng.integers(1, 7))
        start, R = int(rng.choice([0, 6])), spd(rng, rows, 10.0 ** rng.uniform(-4, 0))
        H = np.eye(6)[rng.permutation(6)[:rows]]
        x, P, nis = correct(x, P, start, rng.normal(size=rows) * 0.1, H, R)
        assert np.isfinite(nis)
        x[3:5], x[6:] = np.clip(x[3:5], -1, 1), np.clip(x[6:], -2, 2)  # keep the numbers where a robot lives
        if k % 20 == 0:
            assert np.array_equal(P, P.T)
            deviation = np.sqrt(np.diag(P))
            assert np.linalg.eigvalsh(P / np.outer(deviation, deviation))[0] > 0.0


@pytest.mark.parametrize("alpha", [1e-3, 0.5, 1.0])
def test_the_unscented_prediction_is_the_extended_one_where_nothing_bends(rng, alpha):
    x, P = rng.normal(size=15) * 0.3, spd(rng, 15, 1e-3)
    (a, A), (b, B) = advance(x, P, 0.1), advance(x, P, 0.1, filter="ukf", alpha=alpha)
    np.testing.assert_allclose(b, a, atol=1e-12)
    np.testing.assert_allclose(B, A, rtol=1e-4, atol=1e-9)


def test_the_unscented_covariance_is_that_of_its_sigma_points(rng):
    x, P, gamma = rng.normal(size=15) * 0.3, spd(rng, 15, 0.3), np.sqrt(15.0)
    L = gamma * np.linalg.cholesky(P)
    points = np.array([moved(x + s * column, 0.1, 0.5) for column in L.T for s in (1, -1)]) - moved(x, 0.1, 0.5)
    _, ours = advance(x, P, 0.1, filter="ukf", alpha=1.0)
    np.testing.assert_allclose(ours, points.T @ points / 30 + 0.1 * Q, atol=1e-12)


def test_the_unscented_path_is_not_shortened_by_an_uncertain_heading():
    x, P = np.zeros(15), np.zeros((15, 15))
    x[6], P[5, 5] = 1.0, 1.0
    assert advance(x, P, 1.0, filter="ukf")[0][0] == pytest.approx(1.0)


def test_as_robot_localization_sigma_points_move_along_the_mean(rng):
    x, P = rng.normal(size=15) * 0.3, spd(rng, 15, 0.1)
    F = transition(x, 0.1, 0.0)
    F[:6, 3:6] = np.eye(6)[:, 3:]
    ours, covariance = advance(x, P, 0.1, filter="ukf", as_robot_localization=True)
    np.testing.assert_allclose(ours, moved(x, 0.1, 0.0), atol=1e-14)
    np.testing.assert_allclose(covariance, F @ P @ F.T + 0.1 * Q, atol=1e-14)


def test_as_robot_localization_the_ukf_corrects_without_the_last_noise(rng):
    x, P, bare, R = np.zeros(15), spd(rng, 15, 0.3), spd(rng, 15, 0.2), spd(rng, 2, 0.1)
    H, r = np.eye(6)[:2], rng.normal(size=2)
    G = np.eye(15)[[6, 7]]
    K = bare @ G.T @ np.linalg.inv(G @ bare @ G.T + R)
    ours, covariance = x.copy(), P.copy()
    room = kernels.work_room()[1]
    kernels.correct(ours, covariance, bare, True, 2, 6, 6, r, H, R, np.inf, room)
    np.testing.assert_allclose(ours, K @ r, atol=1e-13)
    np.testing.assert_allclose(covariance, P - K @ (G @ bare @ G.T) @ K.T, atol=1e-13)


def test_a_gate_leaves_everything_as_it_was(rng):
    x, P = rng.normal(size=15) * 0.1, spd(rng, 15, 0.1)
    after, covariance, nis = correct(x, P, 6, np.full(3, 9.0), np.eye(3, 6), 0.01 * np.eye(3), gate=9.0)
    assert nis > 9.0
    assert np.array_equal(after, x)
    assert np.array_equal(covariance, P)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_no_number_is_refused(rng, value):
    x, P = rng.normal(size=15) * 0.1, spd(rng, 15, 0.1)
    for r, R in ((np.full(3, value), np.eye(3)), (np.zeros(3), np.full((3, 3), value))):
        after, covariance, nis = correct(x, P, 6, r, np.eye(3, 6), R)
        assert nis == np.inf
        assert np.array_equal(after, x)
        assert np.array_equal(covariance, P)


def test_dynamic_noise_grows_with_the_square_of_the_speed(rng):
    x, P = np.zeros(15), np.zeros((15, 15))
    x[7], x[11] = 3.0, 4.0
    _, covariance = advance(x, P, 1e-6, dynamic_process_noise=True)
    np.testing.assert_allclose(np.diag(covariance)[:6], 25e-6 * np.diag(Q)[:6], rtol=1e-4)
    np.testing.assert_allclose(np.diag(covariance)[6:], 1e-6 * np.diag(Q)[6:], rtol=1e-4)


def test_a_semidefinite_covariance_has_a_root(rng):
    A = rng.normal(size=(15, 4))
    P, L = A @ A.T, np.full((15, 15), np.nan)
    assert not kernels.cholesky(P, 15, 1e-14, L)
    np.testing.assert_allclose(L @ L.T, P, atol=1e-6)
