from typing import get_args

import numpy as np
import pytest
from jacobians import assert_is_jacobian

from longreach.errors import RecordingError
from longreach.estimation.planar import _ekf_kernels as kernels
from longreach.estimation.planar import motion_model
from longreach.estimation.planar.measurement_models import MODELS, Measurement, PlanarImu, Relation, observe, planar_imu
from longreach.estimation.planar.noise_adaptation import NOMINAL, inflated
from longreach.geometry import se2, se3, so3
from longreach.measurement import Imu, PoseMeasurement, RelativePoseMeasurement, TwistMeasurement

R3 = np.array([[4e-4, 1e-4, 2e-5], [1e-4, 3e-4, 5e-5], [2e-5, 5e-5, 1e-4]])
R2 = np.array([[4e-4, 1e-4], [1e-4, 3e-4]])


def masked(rows):
    R = R3.copy()
    for i in rows:
        R[i, :] = R[:, i] = 0.0
        R[i, i] = np.inf
    return R


CASES = {
    "twist": TwistMeasurement(1.0, np.array([0.3, -0.2, 0.5]), R3),
    "twist, forward only": TwistMeasurement(1.0, np.array([0.3, np.nan, np.nan]), masked([1, 2])),
    "pose": PoseMeasurement(1.0, np.array([0.3, -0.2, 3.0]), R3),
    "pose, position only": PoseMeasurement(1.0, np.array([0.3, -0.2, 0.5]), masked([2])),
    "relative pose": RelativePoseMeasurement(0.5, 1.0, np.array([0.3, -0.2, 1.5]), R3),
    "relative pose, heading unknown": RelativePoseMeasurement(0.5, 1.0, np.array([0.3, -0.2, np.nan]), masked([2])),
    "imu": PlanarImu(1.0, 0.4, np.array([0.1, 0.2]), np.array([0.2, -0.3]), 1e-4, R2),
    "imu, rate only": PlanarImu(1.0, 0.4, None, np.array([0.2, -0.3]), 1e-4),
}
ROWS = {
    "twist, forward only": 1,
    "pose, position only": 2,
    "relative pose, heading unknown": 2,
    "imu, rate only": 1,
}


def felt(x, imu):
    (vx, vy, w), a, p = x[3:6], x[6:9], imu.position
    at_p = a[:2] + w * np.array([-vy, vx]) + a[2] * np.array([-p[1], p[0]]) - w * w * p
    return np.array([w + x[9], *at_p])


# z - h(x), in plain words
RESIDUALS = {
    TwistMeasurement: lambda x, m: m.twist - x[3:6],
    PoseMeasurement: lambda x, m: m.pose - se2.compose(x[13:16], x[:3]),
    RelativePoseMeasurement: lambda x, m: -se2.difference(m.pose, se2.between(x[16:19], x[:3])),
    PlanarImu: lambda x, m: (
        np.array([m.rate, *(np.zeros(2) if m.acceleration is None else m.acceleration)]) - felt(x, m)
    ),
}


def random_mean(rng):
    return np.concatenate([rng.normal(size=3), 2.0 * rng.normal(size=3), rng.normal(size=13)])


@pytest.mark.parametrize("name", CASES)
def test_the_observation_jacobian_is_its_derivative(rng, name):
    measurement = CASES[name]
    clone = (16,) if isinstance(measurement, RelativePoseMeasurement) else ()
    mean = random_mean(rng)
    (r, H, R, blocks), fault = observe(mean, measurement, *clone)
    k = ROWS.get(name, 3)
    np.testing.assert_array_equal(blocks, ([1, 0, 0] if isinstance(measurement, PlanarImu) else [0, 0, 1])[:k])
    assert r.shape == (k,)
    assert H.shape == (k, 19)
    assert R.shape == (k, k)
    assert fault == ""
    at = np.zeros(19)  # where the model is linearised: poses at the pose measured, the rest at the mean
    if name == "pose":
        at[:3] = se2.difference(se2.compose(mean[13:16], mean[:3]), measurement.pose)
    elif name == "relative pose, heading unknown":
        x = se2.between(mean[16:19], mean[:3])
        at[:3] = se2.difference(x, np.array([*measurement.pose[:2], x[2]]))
        measurement = RelativePoseMeasurement(0.5, 1.0, np.array([*measurement.pose[:2], x[2]]), R3)
    elif clone:
        at[:3] = se2.difference(mean[:3], se2.compose(mean[16:19], measurement.pose))
    G = np.empty((19, 19))
    there = kernels.retract(mean, at, G)
    J = H @ np.linalg.inv(G)  # over the errors as they are seen from where the model is linearised
    assert_is_jacobian(
        lambda error: -RESIDUALS[type(measurement)](motion_model.retract(there, error), measurement)[:k],
        J,
        np.zeros(19),
    )
    if k == 3:
        np.testing.assert_allclose(H @ at, r - r * (not np.any(at)), atol=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_the_factors_of_a_sources_noise_are_on_its_covariance(rng, name):
    measurement, mean = CASES[name], random_mean(rng)
    clone = (16,) if isinstance(measurement, RelativePoseMeasurement) else ()
    noise = inflated(NOMINAL, np.array([2.0, 5.0]))  # translations, turns
    stated, larger = observe(mean, measurement, *clone)[0], observe(mean, measurement, *clone, noise=noise)[0]
    D = np.diag(np.sqrt([2.0, 5.0])[stated.blocks])
    np.testing.assert_allclose(larger.R, D @ stated.R @ D, rtol=1e-14)
    np.testing.assert_array_equal(larger.innovation, stated.innovation)


def together(mean):
    """How the errors of all poses change (n, 3) as the world moves under them, which no relative pose can tell."""
    out = np.zeros((len(mean), 3))
    for i in (0, *range(16, len(mean), 3)):
        out[i : i + 3] = se2.adjoint(se2.inverse(mean[i : i + 3]))
    return out


def test_a_relative_pose_says_nothing_of_where_all_poses_are_together(rng):
    """Huang, Mourikis & Roumeliotis 2010: else the filter grows certain of a heading that nothing measures."""
    for _ in range(20):
        mean = random_mean(rng)
        _, H, _, _ = observe(mean, RelativePoseMeasurement(0.5, 1.0, rng.normal(size=3), R3), 16)[0]
        np.testing.assert_allclose(H @ together(mean), 0.0, atol=1e-12)
        dx, G = rng.normal(size=19), np.empty((19, 19))
        after = kernels.retract(mean, dx, G)
        np.testing.assert_allclose(G @ together(mean), together(after), atol=1e-12)


def test_every_kind_of_measurement_has_a_model_and_every_model_a_jacobian_test():
    assert set(MODELS) - {Relation} == set(get_args(Measurement)) == {type(case) for case in CASES.values()}


def test_what_the_model_predicts_has_no_innovation(rng):
    mean = random_mean(rng)
    for case in (
        TwistMeasurement(1.0, mean[3:6], R3),
        PoseMeasurement(1.0, se2.compose(mean[13:16], mean[:3]) + np.array([0, 0, 2 * np.pi]), R3),
        RelativePoseMeasurement(0.5, 1.0, se2.between(mean[16:19], mean[:3]), R3),
    ):
        clone = (16,) if isinstance(case, RelativePoseMeasurement) else ()
        np.testing.assert_allclose(observe(mean, case, *clone)[0].innovation, 0.0, atol=1e-12)


def test_the_imu_feels_what_its_place_in_the_world_does(rng):
    """Second road: differentiate the world position of the sensor twice and turn it to the base's axes."""
    mean = rng.normal(size=13)
    p, h = np.array([0.2, -0.3]), 1e-4

    def place(dt):
        # chain without decay over ±h; Magnus terms beyond the exponential are of third order and do not matter here
        x = se2.retract(mean[:3], dt * mean[3:6] + 0.5 * dt**2 * mean[6:9])
        return se2.transform(x, p[None])[0]

    world = (place(h) - 2.0 * place(0.0) + place(-h)) / h**2
    felt = world @ np.array([[np.cos(mean[2]), -np.sin(mean[2])], [np.sin(mean[2]), np.cos(mean[2])]])
    imu = PlanarImu(1.0, mean[5] + mean[9], felt, p, 1e-4, R2)
    np.testing.assert_allclose(observe(mean, imu)[0].innovation, 0.0, atol=1e-5)


def test_planar_imu_turns_the_sensor_to_the_base_and_leaves_gravity_out():
    T = se3.from_rotation_translation(so3.from_roll_pitch_yaw(np.pi, 0.0, 0.5), np.array([0.2, -0.3, 0.17]))
    rate, acceleration = np.array([0.0, 0.0, 0.7]), np.array([0.4, -0.1, 9.81])
    imu = Imu(3.0, T[:3, :3].T @ rate, T[:3, :3].T @ acceleration)
    planar = planar_imu(imu, T, 1e-4, 0.01)
    assert planar.stamp == 3.0
    assert planar.rate == pytest.approx(0.7)
    np.testing.assert_allclose(planar.acceleration, [0.4, -0.1], atol=1e-12)
    np.testing.assert_array_equal(planar.position, [0.2, -0.3])
    assert planar_imu(imu, T, 1e-4).acceleration is None


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"twist": np.array([np.nan, 0.0, 0.0])}, "not finite"),
        ({"twist": np.array([np.inf, 0.0, 0.0])}, "not finite"),
        ({"twist": np.array([1e30, 0.0, 0.0])}, "larger than anything"),
        ({"covariance": np.diag([1.0, np.nan, 1.0])}, "not finite"),
        ({"covariance": np.diag([1.0, -1.0, 1.0])}, "positive semidefinite"),
        ({"covariance": np.diag([1.0, -np.inf, 1.0])}, "not finite"),
        ({"covariance": np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])}, "positive semidefinite"),
        ({"covariance": np.array([[1.0, 0.5, 0.0], [0.2, 1.0, 0.0], [0.0, 0.0, 1.0]])}, "symmetric"),
        ({"covariance": np.array([[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1.0]])}, "positive semidefinite"),
        ({"covariance": np.diag([np.inf] * 3)}, "measures nothing"),
    ],
)
def test_what_is_no_measurement_is_named(changes, says):
    good = {"twist": np.zeros(3), "covariance": R3}
    _, fault = observe(np.zeros(13), TwistMeasurement(1.0, **{**good, **changes}))
    assert says in fault


def test_random_covariances_are_distinguished_from_indefinite_ones(rng):
    for _ in range(200):
        eigenvalues = rng.normal(size=3) * 10.0 ** rng.uniform(-4, 4, size=3)
        basis = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        R = basis @ np.diag(eigenvalues) @ basis.T
        R = 0.5 * (R + R.T)
        if abs(np.linalg.eigvalsh(R)[0]) > 1e-6 * np.abs(eigenvalues).max():
            _, fault = observe(np.zeros(13), TwistMeasurement(1.0, np.zeros(3), R))
            assert (fault == "") == (eigenvalues.min() > 0)


def test_a_covariance_stored_by_columns_is_the_same_covariance(rng):
    z = rng.normal(size=3)
    by_rows = observe(np.zeros(16), PoseMeasurement(1.0, z, R3))[0]
    by_columns = observe(np.zeros(16), PoseMeasurement(1.0, z, np.asfortranarray(R3)))[0]
    np.testing.assert_array_equal(by_rows.R, by_columns.R)


def test_an_imu_with_half_an_acceleration_is_refused_in_a_sentence():
    with pytest.raises(RecordingError, match="both an acceleration and its covariance"):
        PlanarImu(1.0, 0.1, np.zeros(2), np.zeros(2), 1e-4)
    with pytest.raises(RecordingError, match="finite number of seconds"):
        PlanarImu(float("nan"), 0.1, None, np.zeros(2), 1e-4)
