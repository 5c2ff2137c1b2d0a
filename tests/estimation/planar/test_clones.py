"""Pose clones: past poses that the filter remembers, and the wheel odometry whose readings carry one along."""

import numpy as np
import pytest
from jacobians import assert_is_jacobian
from scipy.linalg import block_diag
from scipy.stats import chi2
from true_motion import draw

from longreach.estimation.planar import ekf
from longreach.estimation.planar.config import FilterConfig
from longreach.estimation.planar.filter import init, step
from longreach.estimation.planar.motion_model import WheelModel
from longreach.estimation.planar.state import Clone, PoseClone
from longreach.geometry import se2
from longreach.measurement import PoseMeasurement, RelativePoseMeasurement

NO_GATE = FilterConfig(gate_mode="none", history=0.0, coupled_to_wheels=(False, False, False))
ALONE, COUPLED = WheelModel(np.zeros(3)), WheelModel(np.ones(3))
EXACT_SCALE = WheelModel(np.zeros(3), reach=1e300)
STEP = np.array([[4e-4, 1e-4, 2e-5], [1e-4, 3e-4, 5e-5], [2e-5, 5e-5, 1e-4]])
READING = np.diag([1e-3, 5e-4, 2e-3])


def spd(rng, n):
    A = rng.normal(size=(n, n))
    return A @ A.T / n + 0.1 * np.eye(n)


def test_carrying_a_clone_moves_its_error_by_the_derivative(rng):
    mean, P, z = rng.normal(size=19), spd(rng, 19), np.array([0.5, -0.3, 1.2])
    mean[10:13] = 0.0
    clone = mean[16:19]
    moved, covariance, _ = ekf.carry(EXACT_SCALE, mean, P, 16, z, STEP)
    np.testing.assert_allclose(moved, [*mean[:16], *se2.compose(clone, z)], atol=1e-15)

    def error_about_the_new(error):
        return se2.difference(se2.compose(clone, z), se2.compose(se2.retract(clone, error), z))

    J = se2.adjoint(se2.inverse(z))
    assert_is_jacobian(error_about_the_new, J, np.zeros(3))
    T = block_diag(np.eye(16), J)
    T[16:, 10:13] = se2.right_jacobian(se2.log(z)) @ np.diag(se2.log(z))
    np.testing.assert_allclose(covariance, T @ P @ T.T + block_diag(np.zeros((16, 16)), STEP), atol=1e-12)
    np.testing.assert_array_equal(covariance, covariance.T)


def test_the_pose_shares_the_error_of_a_step_that_leads_it(rng):
    mean, P, z = rng.normal(size=19), spd(rng, 19), np.array([0.5, -0.3, 1.2])
    P[10:13] = P[:, 10:13] = mean[10:13] = 0.0
    _, alone, _ = ekf.carry(ALONE, mean, P, 16, z, STEP)
    _, shared, _ = ekf.carry(WheelModel(np.array([1.0, 1.0, 0.0])), mean, P, 16, z, STEP)
    between = se2.adjoint(se2.between(mean[:3], se2.compose(mean[16:19], z)))  # both as one moved by the world
    S = between @ np.diag([1.0, 1.0, 0.0])
    expected = np.zeros((19, 19))
    expected[:3, :3], expected[:3, 16:], expected[16:, :3] = S @ STEP @ S.T, S @ STEP, STEP @ S.T
    np.testing.assert_allclose(shared - alone, expected, atol=1e-12)
    D = np.hstack([np.eye(3), np.zeros((3, 13)), -between])
    _, all_shared, _ = ekf.carry(COUPLED, mean, P, 16, z, STEP)
    _, exact, _ = ekf.carry(COUPLED, mean, P, 16, z, np.zeros((3, 3)))
    np.testing.assert_allclose(D @ all_shared @ D.T, D @ exact @ D.T, atol=1e-11)  # their difference is left alone


def test_wheels_alone_move_the_pose_as_they_say(rng):
    """However the base jerks about, the filter on wheels alone is nearly the wheels."""
    config = NO_GATE.model_copy(update={"coupled_to_wheels": (True, True, True)})
    state = init(0.0, np.zeros(3), None, config)
    state, _ = step(state, PoseClone(0.0, "wheels"))
    raw = np.zeros(3)
    for i in range(400):
        z = np.array([0.02, 0.0, 0.05]) * rng.choice([-1.0, 0.0, 1.0]) * np.array([1.0, 1.0, rng.uniform(-1, 1)])
        raw = se2.compose(raw, z)
        reading = 1e-6 * np.eye(3)
        state, _ = step(state, RelativePoseMeasurement(0.02 * i, 0.02 * (i + 1), z, 0.01 * STEP, "wheels", reading))
    np.testing.assert_allclose(clone_in_world(state), raw, atol=0.04)  # of 5 m
    np.testing.assert_allclose(state.belief.pose, raw, atol=0.06)


def test_a_clone_is_the_pose_and_carrying_it_back_changes_nothing(rng):
    mean, P = rng.normal(size=16), spd(rng, 16)
    P[10:13] = P[:, 10:13] = mean[10:13] = 0.0
    mean, P = ekf.chosen(mean, P, ekf.copying(19, 0, 16))
    np.testing.assert_array_equal(mean[16:], mean[:3])
    np.testing.assert_array_equal(P[16:, :], P[:3, :])
    z = np.array([0.5, -0.3, 1.2])
    *there, _ = ekf.carry(COUPLED, mean, P, 16, z, np.zeros((3, 3)))
    back, covariance, _ = ekf.carry(COUPLED, *there, 16, se2.inverse(z), np.zeros((3, 3)))
    np.testing.assert_allclose(back, mean, atol=1e-14)
    np.testing.assert_allclose(covariance, P, atol=1e-12)


def drive(rng, n=40):
    """Steps of wheels that turn and drive, at uneven stamps."""
    stamps = np.cumsum(rng.uniform(0.05, 0.3, n + 1)).tolist()
    return stamps, [np.array([0.05, 0.01, 0.03]) + 0.02 * rng.normal(size=3) for _ in range(n)]


def clone_in_world(state):
    mean = state.newest.mean
    return se2.compose(mean[13:16], mean[16:19])


def start(config=NO_GATE):
    return init(0.0, np.array([1.0, -2.0, 2.5]), np.diag([0.01, 0.02, 0.005]), config)


@pytest.mark.parametrize(("scale", "tolerance"), [(1.0, 2e-3), (0.1, 2e-5), (0.01, 2e-7)])
def test_readings_without_error_are_steps_from_clone_to_clone(rng, scale, tolerance):
    """Two roads: the clone carried along by the steps, or cloned anew after each; to first order they are one."""
    config = NO_GATE.model_copy(
        update={"acceleration_deviation": (scale,) * 3, "initial_twist_deviation": (scale,) * 3}
    )
    stamps, steps = drive(rng)
    steps, Q = [scale * z for z in steps], scale**2 * STEP
    carried, cloned = (init(0.0, np.array([1.0, -2.0, 2.5]), 1e-2 * scale**2 * np.eye(3), config) for _ in range(2))
    carried, _ = step(carried, PoseClone(stamps[0], "wheels"))
    cloned, _ = step(cloned, PoseClone(stamps[0], "wheels"))
    for before, now, z in zip(stamps, stamps[1:], steps, strict=False):
        exact = RelativePoseMeasurement(before, now, z, Q, "wheels", np.zeros((3, 3)))
        carried, a = step(carried, exact)
        cloned, b = step(cloned, RelativePoseMeasurement(before, now, z, Q, "wheels"))
        cloned, _ = step(cloned, PoseClone(now, "wheels"))
        assert (a.status, b.status) == ("used", "used")
        assert a.nis == pytest.approx(b.nis, rel=1e-2, abs=1e-6)
        assert carried.newest.clones["wheels"] == cloned.newest.clones["wheels"] == Clone(16, now)
    mean, other = carried.newest.mean, cloned.newest.mean
    np.testing.assert_allclose(se2.difference(carried.belief.pose, cloned.belief.pose), 0.0, atol=tolerance)
    np.testing.assert_allclose(mean[3:10], other[3:10], atol=10 * tolerance)
    np.testing.assert_allclose(
        se2.difference(mean[:3], mean[16:]), 0.0, atol=2e-3 * tolerance
    )  # the wheels say where we are
    unit = np.array([*[scale] * 9, 1.0])
    A, B = (state.belief.covariance / np.outer(unit, unit) for state in (carried, cloned))
    np.testing.assert_allclose(A, B, atol=0.02 * scale * B.max())


def test_the_error_of_a_reading_does_not_add_up(rng):
    """A hundred readings, each good to 3 cm, of steps that are nearly exact."""
    tiny, reading = 1e-10 * np.eye(3), 1e-3 * np.eye(3)
    white, summed = (init(0.0, np.zeros(3), np.zeros((3, 3)), NO_GATE) for _ in range(2))
    white, _ = step(white, PoseClone(0.0, "wheels"))
    summed, _ = step(summed, PoseClone(0.0, "wheels"))
    z = np.array([0.01, 0.0, 0.01])
    for i in range(100):
        stamps = 0.1 * i, 0.1 * (i + 1)
        white, _ = step(white, RelativePoseMeasurement(*stamps, z, tiny, "wheels", reading))
        summed, _ = step(summed, RelativePoseMeasurement(*stamps, z, tiny + reading, "wheels"))
        summed, _ = step(summed, PoseClone(stamps[1], "wheels"))
    assert np.diag(white.belief.pose_covariance).max() < 1e-3
    assert np.diag(summed.belief.pose_covariance)[2] > 5e-3


def test_the_filter_on_wheels_is_as_wrong_as_it_says(rng):
    """Monte Carlo on the model itself: steps that are wrong by STEP add up, readings are off by READING each time."""
    config, runs, nees = FilterConfig(gate_mode="none", history=0.0), 60, []
    for _ in range(runs):
        x, now = np.zeros(13), 0.0
        x[3:6] = rng.normal(size=3)
        x[6:9] = rng.normal(size=3) * config.acceleration_deviation
        x[9] = 0.02 * rng.normal()
        state = init(0.0, x[:3], None, config)
        state, _ = step(state, PoseClone(0.0, "wheels"))
        counted = x[:3]
        for _ in range(20):
            x, now = draw(config.motion, x, 0.1, rng), now + 0.1
            reading = se2.retract(x[:3], -np.linalg.cholesky(READING) @ rng.normal(size=3))
            z = se2.retract(se2.between(counted, reading), -np.linalg.cholesky(STEP) @ rng.normal(size=3))
            counted = reading
            state, _ = step(state, RelativePoseMeasurement(state.stamp, now, z, STEP, "wheels", READING))
        error = se2.difference(state.belief.pose, x[:3])
        nees.append(error @ np.linalg.solve(state.belief.pose_covariance, error))
    low, high = chi2.ppf([0.005, 0.995], 3 * runs) / runs
    assert low < np.mean(nees) < high


def test_after_a_fix_the_wheels_go_on_from_there(rng):
    state = start()
    state, _ = step(state, PoseClone(0.0, "wheels"))
    state, _ = step(state, PoseMeasurement(0.0, np.array([1.2, -2.1, 2.4]), 1e-12 * np.eye(3)))
    z = np.array([0.1, 0.0, 0.05])
    state, correction = step(state, RelativePoseMeasurement(0.0, 0.1, z, 1e-9 * np.eye(3), "wheels", 1e-9 * np.eye(3)))
    assert correction.status == "used"
    np.testing.assert_allclose(
        se2.difference(se2.compose(np.array([1.2, -2.1, 2.4]), z), state.belief.pose), 0.0, atol=1e-3
    )


@pytest.mark.parametrize("cloned", [None, 0.0])
def test_a_reading_without_a_clone_at_its_start_is_refused(cloned):
    state = start()
    if cloned is not None:
        state, _ = step(state, PoseClone(cloned, "wheels"))
    before = state.newest
    state, correction = step(state, RelativePoseMeasurement(0.05, 0.1, np.zeros(3), STEP, "wheels", READING))
    assert correction.status == "refused"
    assert "where wheels has no pose clone" in correction.reason
    assert state.newest.clones == before.clones
    assert state.tallies["wheels"].refused == 1


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_reading_that_is_not_finite_moves_neither_the_pose_nor_the_clone(bad):
    state, _ = step(start(), PoseClone(0.0, "wheels"))
    before = state.newest.mean[16:]
    state, correction = step(
        state, RelativePoseMeasurement(0.0, 0.1, np.array([bad, 0.0, 0.0]), STEP, "wheels", READING)
    )
    assert correction.status == "refused"
    np.testing.assert_array_equal(state.newest.mean[16:], before)
    assert state.newest.clones["wheels"] == Clone(16, 0.0)


def test_a_late_reading_gives_what_it_gives_in_order(rng):
    config = FilterConfig(gate_mode="none", history=2.0)
    stamps, steps = drive(rng, 6)
    events = [PoseClone(stamps[0], "wheels")]
    events += [
        RelativePoseMeasurement(a, b, z, STEP, "wheels", READING)
        for a, b, z in zip(stamps, stamps[1:], steps, strict=False)
    ]
    fix = PoseMeasurement(stamps[3], np.array([1.2, -2.0, 2.6]), np.diag([0.01, 0.01, np.inf]), "fixes")
    in_order, late = start(config), start(config)
    for event in sorted([*events, fix], key=lambda e: (e.stamp, isinstance(e, PoseClone), e.source)):
        in_order, _ = step(in_order, event)
    for event in [*events, fix]:
        late, _ = step(late, event)
    np.testing.assert_allclose(late.belief.pose, in_order.belief.pose, atol=1e-12)
    np.testing.assert_allclose(late.belief.covariance, in_order.belief.covariance, atol=1e-12)
