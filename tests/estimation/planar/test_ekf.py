from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from longreach.estimation import replay_buffer
from longreach.estimation.planar import _ekf_kernels as kernels
from longreach.estimation.planar import ekf
from longreach.estimation.planar.config import FilterConfig
from longreach.estimation.planar.filter import init, step
from longreach.estimation.planar.measurement_models import PlanarImu, observe
from longreach.estimation.planar.motion_model import MotionModel
from longreach.estimation.planar.state import Keyframe, PoseClone
from longreach.geometry import se2
from longreach.measurement import PoseMeasurement, RelativePoseMeasurement, TwistMeasurement

MODEL = MotionModel(0.5, np.array([1.0, 1.0, 2.0]) ** 2, 1e-8)
STILL = 1e-9


def spd(rng, n, scale):
    A = rng.normal(size=(n, n))
    return scale**2 * (A @ A.T / n + 0.1 * np.eye(n))


def all_corrected(state):
    """The filter that a smoother looks back over: fixes and all else correct the whole state."""
    return replace(state, buffer=replay_buffer.init(state.newest.key, state.newest._replace(links=())))


def textbook_chain(dt, variance, tau=0.5):
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / tau]])
    block = expm(np.block([[-A, np.diag([0.0, 0.0, 2.0 * variance / tau])], [np.zeros((3, 3)), A.T]]) * dt)
    Phi = block[3:, 3:].T
    return Phi, Phi @ block[:3, 3:]


def test_covariance_stays_symmetric_positive_definite_over_random_steps(rng):
    mean, P = np.zeros(16), spd(rng, 16, 0.3)
    cloned = -1
    for k in range(10_000):
        mean, P = ekf.predict(MODEL, mean, P, float(10.0 ** rng.uniform(-4, 0.3)))
        if k == 100:
            mean, P = ekf.chosen(mean, P, ekf.copying(19, 0, 16))
            cloned = k
        kind = k % 4 if cloned >= 0 else k % 3
        R3 = spd(rng, 3, 10.0 ** rng.uniform(-4, 0))
        measurement = (
            TwistMeasurement(0.0, mean[3:6] + rng.normal(size=3) * 0.1, R3),
            PoseMeasurement(0.0, se2.compose(mean[13:16], mean[:3]) + rng.normal(size=3) * 0.1, R3),
            PlanarImu(0.0, 0.1, rng.normal(size=2) * 0.1, np.array([0.2, -0.3]), 1e-4, R3[:2, :2]),
            RelativePoseMeasurement(0.0, 0.0, se2.between(mean[16:19], mean[:3]) if cloned >= 0 else np.zeros(3), R3),
        )[kind]
        (r, H, R, _), fault = observe(mean, measurement, *((16,) if kind == 3 else ()))
        assert not fault
        mean, P, nis, scale, _ = ekf.correct(mean, P, r, H, R, gain=("all", "local", "fix")[k % 7 % 3])
        assert np.isfinite(nis)
        assert scale == 1.0
        if k % 10 == 0 or 100 <= k < 110:
            assert np.array_equal(P, P.T)
            deviation = np.sqrt(np.diag(P))
            smallest = np.linalg.eigvalsh(P / np.outer(deviation, deviation))[0]
            assert smallest > (-1e-14 if 100 <= k < 105 else 0.0)  # a fresh clone is the pose: singular by nature
            # keep the numbers in a range where a robot lives
            mean = np.concatenate([mean[:3] % 10.0, np.clip(mean[3:13], -2.0, 2.0), mean[13:] % 10.0])


def test_without_rotation_it_is_the_linear_kalman_filter(rng):
    config = FilterConfig(
        acceleration_deviation=(1.0, 0.7, STILL), initial_twist_deviation=(0.5, 0.4, STILL), gate_mode="none", history=0
    )
    state = all_corrected(init(0.0, np.array([1.0, 2.0, 0.0]), np.diag([0.04, 0.01, 0.0]), config))
    x = np.array([1.0, 0.0, 0.0, 2.0, 0.0, 0.0])  # position, velocity, acceleration of x, then of y
    P = np.diag([0.04, 0.25, 1.0, 0.01, 0.16, 0.49])
    now = 0.0
    for k in range(200):
        dt = float(rng.choice([0.0, 0.01, 0.1, 1.3]))
        now += dt
        (Fx, Qx), (Fy, Qy) = textbook_chain(dt, 1.0), textbook_chain(dt, 0.49)
        F, Q = block_diag(Fx, Fy), block_diag(Qx, Qy)
        x, P = F @ x, F @ P @ F.T + Q
        z, R = rng.normal(size=2), spd(rng, 2, 0.1)
        full = np.diag([0.0, 0.0, np.inf])
        full[:2, :2] = R
        kind = k % 3
        H = np.zeros((2, 6))
        H[0, kind] = H[1, 3 + kind] = 1.0
        state, correction = step(
            state,
            (
                PoseMeasurement(now, np.array([*z, 0.0]), full, source="one"),
                TwistMeasurement(now, np.array([*z, 0.0]), full, source="one"),
                PlanarImu(now, 0.0, z, np.zeros(2), np.inf, R, source="one"),
            )[kind],
        )
        S = H @ P @ H.T + R
        K = P @ H.T @ np.linalg.inv(S)
        innovation = z - H @ x
        x, P = x + K @ innovation, (np.eye(6) - K @ H) @ P
        assert correction.nis == pytest.approx(innovation @ np.linalg.solve(S, innovation), rel=1e-6)
        order = [0, 3, 6, 1, 4, 7]
        world = np.concatenate([state.belief.pose, state.newest.mean[3:]])
        np.testing.assert_allclose(world[order], x, atol=1e-7)
        np.testing.assert_allclose(state.belief.covariance[np.ix_(order, order)], P, rtol=1e-6, atol=1e-9)


def test_relative_poses_without_process_information_are_dead_reckoning(rng):
    config = FilterConfig(
        acceleration_deviation=(1e5, 1e5, 1e5), initial_twist_deviation=(1e3, 1e3, 1e3), gate_mode="none", history=0
    )
    start, P0 = np.array([1.0, -2.0, 2.5]), np.diag([0.01, 0.02, 0.005])
    state = init(0.0, start, P0, config)
    state, _ = step(state, PoseClone(0.0, "wheels"))
    pose, covariance, now = start, P0, 0.0
    for _ in range(60):
        stamp = now + float(rng.uniform(0.01, 2.0))  # what the stamps say does not matter
        z = np.array([0.1, 0.02, 0.1]) * rng.normal(size=3)
        R = spd(rng, 3, 1e-3)
        state, _ = step(state, RelativePoseMeasurement(now, stamp, z, R, "wheels"))
        state, _ = step(state, PoseClone(stamp, "wheels"))
        now = stamp
        pose = se2.compose(pose, z)
        A = se2.adjoint(se2.inverse(z))
        covariance = A @ covariance @ A.T + R
    np.testing.assert_allclose(se2.difference(pose, state.belief.pose), 0.0, atol=1e-5)
    np.testing.assert_allclose(state.belief.pose_covariance, covariance, rtol=1e-3, atol=1e-6)


def test_two_matches_to_one_keyframe_share_its_error():
    """On a line: against batch least squares over the poses at the keyframe and at both matches."""
    dt, (Phi, Q) = 0.5, textbook_chain(0.5, 1.0)
    config = FilterConfig(
        acceleration_deviation=(1.0, 1.0, STILL), initial_twist_deviation=(0.5, 0.5, STILL), gate_mode="none", history=0
    )
    prior, r, fix = np.diag([0.3**2, 0.5**2, 1.0]), 0.05**2, 0.1**2
    z1, z2, z_fix = 0.2, 0.5, 0.9
    state = all_corrected(init(0.0, np.zeros(3), np.diag([0.3**2, 0.3**2, 0.0]), config))
    R = np.diag([r, r, 1e-6])
    for event in (
        Keyframe(0.0, "lidar"),
        RelativePoseMeasurement(0.0, dt, np.array([z1, 0.0, 0.0]), R, "lidar"),
        RelativePoseMeasurement(0.0, 2 * dt, np.array([z2, 0.0, 0.0]), R, "lidar"),
        PoseMeasurement(2 * dt, np.array([z_fix, 0.0, 0.0]), np.diag([fix, np.inf, np.inf])),
    ):
        if isinstance(event, PoseMeasurement):  # no number of matches makes the pose surer than their keyframe
            assert state.belief.covariance[0, 0] > prior[0, 0]
        state, _ = step(state, event)
    information, vector = np.zeros((9, 9)), np.zeros(9)
    information[:3, :3] += np.linalg.inv(prior)
    for k in (0, 3):
        J = np.zeros((3, 9))
        J[:, k : k + 3], J[:, k + 3 : k + 6] = -Phi, np.eye(3)
        information += J.T @ np.linalg.solve(Q, J)
    for late, early, z, variance in ((3, 0, z1, r), (6, 0, z2, r), (6, None, z_fix, fix)):
        J = np.zeros(9)
        J[late] = 1.0
        if early is not None:
            J[early] = -1.0
        information += np.outer(J, J) / variance
        vector += J * z / variance
    P, x = np.linalg.inv(information), np.linalg.solve(information, vector)
    last = state.newest
    assert state.belief.pose[0] == pytest.approx(x[6], abs=1e-7)
    assert state.belief.covariance[0, 0] == pytest.approx(P[6, 6], rel=1e-6)
    keyframe, i = np.zeros(len(last.mean)), [13, 16]  # the fix corrects the keyframe too: the reference, and the clone
    keyframe[i] = 1.0
    assert keyframe @ last.mean == pytest.approx(x[0], abs=1e-7)
    assert keyframe @ last.P @ keyframe == pytest.approx(P[0, 0], rel=1e-6)


def test_inflation_brings_the_nis_to_the_gate(rng):
    for k in (1, 2, 3):
        mean, P, R = np.zeros(13), spd(rng, 13, 0.3), spd(rng, k, 0.1)
        H = rng.normal(size=(k, 13))
        r = 1e3 * rng.normal(size=k)
        rejected = ekf.correct(mean, P, r, H, R, 9.0, False)
        assert rejected.scale == 0.0
        np.testing.assert_array_equal(rejected.covariance, P)
        taken = ekf.correct(mean, P, r, H, R, 9.0, True)
        assert r @ np.linalg.solve(H @ P @ H.T + taken.scale * R, r) == pytest.approx(9.0, rel=1e-6)
        assert taken.nis == pytest.approx(rejected.nis)
        assert taken.nis == pytest.approx(r @ np.linalg.solve(H @ P @ H.T + R, r))


def test_an_exact_measurement_beyond_the_gate_cannot_be_inflated(rng):
    H = np.eye(3, 13)
    result = ekf.correct(np.zeros(13), np.eye(13), np.full(3, 100.0), H, np.zeros((3, 3)), 9.0, True)
    assert result.scale == 0.0


def test_what_has_no_innovation_covariance_changes_nothing():
    mean, P = np.zeros(13), np.zeros((13, 13))
    result = ekf.correct(mean, P, np.ones(3), np.eye(3, 13), np.zeros((3, 3)))
    assert result.nis == np.inf
    assert result.scale == 0.0
    np.testing.assert_array_equal(result.mean, mean)


@pytest.mark.parametrize("turn", [0.0, 1.0, 3.0])
def test_a_pose_that_nothing_was_known_of_is_as_measured(turn):
    P = block_diag(np.diag([1e4] * 13), np.zeros((3, 3)))
    R = np.array([[4e-4, 1e-4, 2e-5], [1e-4, 3e-4, 5e-5], [2e-5, 5e-5, 1e-4]])
    mean, z = np.zeros(16), np.array([3.0, -1.0, turn])
    (r, H, R_z, _), _ = observe(mean, PoseMeasurement(0.0, z, R))
    absolute = ekf.correct(mean, P, r, H, R_z)
    np.testing.assert_allclose(absolute.mean[:3], z, atol=1e-6)
    B = block_diag([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]], 1.0)
    np.testing.assert_allclose(B @ absolute.covariance[:3, :3] @ B.T, R, atol=1e-9)
    # relative to an exact clone, the covariance is in the frame of the pose measured
    mean, P = np.zeros(19), block_diag(P, np.zeros((3, 3)))
    mean[16:] = [-1.0, 2.0, 0.5]
    (r, H, R_z, _), _ = observe(mean, RelativePoseMeasurement(0.0, 0.0, z, R), 16)
    relative = ekf.correct(mean, P, r, H, R_z)
    np.testing.assert_allclose(se2.difference(se2.compose(mean[16:], z), relative.mean[:3]), 0.0, atol=1e-6)
    np.testing.assert_allclose(relative.covariance[:3, :3], R, atol=1e-9)


def test_errors_are_carried_to_the_frame_of_the_new_mean(rng):
    """An error ξ of a pose, seen from X · exp(dx), is Ad(exp(-dx)) ξ; the rest stays as it is."""
    mean, dx = rng.normal(size=16), 0.5 * rng.normal(size=16)
    G = np.empty((16, 16))
    new = kernels.retract(mean, dx, G)
    xi = 1e-6 * rng.normal(size=16)
    for i in (0, 13):
        moved = se2.compose(se2.retract(mean[i : i + 3], xi[i : i + 3]), se2.exp(dx[i : i + 3]))
        np.testing.assert_allclose(se2.difference(new[i : i + 3], moved), (G @ xi)[i : i + 3], atol=1e-11)
    np.testing.assert_array_equal(G[3:13], np.eye(16)[3:13])
