import numpy as np
import pytest
from calibration_drives import DIFFERENTIAL, MECANUM, motions_of, sideways, straight, turning

from longreach.calibration.observability import calibrate_motions
from longreach.calibration.wheels import Motions, wheel_model
from longreach.errors import CalibrationError

MOUNT = np.array([0.2, -0.05, 0.1])
DRIVE = np.concatenate((straight(80), turning(80), straight(40), turning(120, 0.1)))
WHEELS = np.array([0.101, 0.1015, 0.41])


@pytest.mark.parametrize("yaw", [0.1, -1.6, 3.1])
def test_wheels_and_laser_are_found_from_any_yaw(rng, yaw):
    model, mount = wheel_model(DIFFERENTIAL), np.array([0.2, -0.05, yaw])
    found = calibrate_motions(model, motions_of(rng, model, WHEELS, mount, DRIVE))
    assert found.observable.all()
    np.testing.assert_allclose(found.values, [*WHEELS, *mount], atol=0.005)
    np.testing.assert_allclose(found.values[0] / found.values[1], WHEELS[0] / WHEELS[1], rtol=1e-3)


@pytest.mark.parametrize("robot", [DIFFERENTIAL, MECANUM])
def test_stated_covariances_are_of_the_size_of_the_errors(rng, robot):
    """The mean NEES of runs of wheels and slip as assumed is the number of parameters within 30 %."""
    model = wheel_model(robot)
    drive = DRIVE if robot is DIFFERENTIAL else np.concatenate((DRIVE, sideways(80)))
    nees = []
    for _ in range(15):
        true = model.nominal * (1.0 + rng.normal(size=len(model.nominal)) * 0.01)
        slip = rng.normal(size=len(model.slip)) * model.slip if len(model.slip) else None
        motions = motions_of(rng, model, true, MOUNT, drive, (0.001, 0.0005, 0.002), slip=slip)
        noise = rng.normal(size=motions.turns.shape) * 0.002
        found = calibrate_motions(model, motions._replace(turns=motions.turns + noise), MOUNT, scale_deviation=0.0)
        e = found.values - [*true, *MOUNT]
        nees.append(e @ np.linalg.solve(found.covariance, e) / len(e))
    assert 0.7 < np.mean(nees) < 1.3


def test_rollers_that_slip_sideways_change_neither_radii_nor_arm(rng):
    model, true = wheel_model(MECANUM), np.array([0.1012, 0.1004, 0.0999, 0.101, 0.41])
    drive = np.concatenate((DRIVE, sideways(80)))
    slip = np.array([-0.02, 0.0, 0.0, 0.0, 0.0])
    found = calibrate_motions(model, motions_of(rng, model, true, MOUNT, drive, slip=slip))
    np.testing.assert_allclose(found.values[:5], true, rtol=0.006)
    np.testing.assert_allclose(found.fit.slip[0], -0.02, atol=0.002)


def test_motions_that_slip_are_left_out(rng):
    model = wheel_model(DIFFERENTIAL)
    motions = motions_of(rng, model, WHEELS, MOUNT, DRIVE)
    displacement = motions.displacement.copy()
    slipped = rng.permutation(len(displacement))[:30]
    displacement[slipped] += [0.1, 0.02, 0.05]
    found = calibrate_motions(model, motions._replace(displacement=displacement))
    np.testing.assert_array_equal(np.flatnonzero(~found.fit.used), np.sort(slipped))
    np.testing.assert_allclose(found.values, [*WHEELS, *MOUNT], atol=0.005)


def test_a_length_is_no_better_than_the_scale_of_the_sensor(rng):
    model = wheel_model(DIFFERENTIAL)
    motions = motions_of(rng, model, WHEELS, MOUNT, DRIVE)
    coarse = calibrate_motions(model, motions, scale_deviation=0.02)
    sigma = np.sqrt(np.diag(coarse.covariance))
    assert np.all(sigma[:3] > 0.019 * coarse.values[:3])
    ratio = np.array([1.0, -1.0, 0.0, 0.0, 0.0, 0.0])
    assert np.sqrt(ratio @ coarse.covariance @ ratio) < 0.1 * sigma[0]


def test_wheels_that_are_exchanged_are_said(rng):
    model = wheel_model(DIFFERENTIAL)
    motions = motions_of(rng, model, WHEELS, MOUNT, DRIVE)
    with pytest.raises(CalibrationError, match="exchange the left and the right wheels"):
        calibrate_motions(model, motions._replace(turns=motions.turns[:, ::-1].copy()))


def test_too_few_motions_are_refused(rng):
    model = wheel_model(DIFFERENTIAL)
    motions = motions_of(rng, model, WHEELS, MOUNT, DRIVE[:10])
    with pytest.raises(CalibrationError, match="There are 10 motions between keyframes"):
        calibrate_motions(model, motions)


def test_slip_throughout_is_said(rng):
    model = wheel_model(DIFFERENTIAL)
    motions = motions_of(rng, model, WHEELS, MOUNT, DRIVE)
    displacement = motions.displacement * rng.uniform(-0.5, 1.0, (len(motions.displacement), 1))
    with pytest.raises(CalibrationError, match="the wheels slip throughout"):
        calibrate_motions(model, Motions(motions.turns, motions.spans, displacement))


def test_a_laser_that_is_upside_down_is_said(rng):
    model = wheel_model(DIFFERENTIAL)
    motions = motions_of(rng, model, WHEELS, MOUNT, DRIVE)
    with pytest.raises(CalibrationError, match="say that the sensor is upside down"):
        calibrate_motions(model, motions._replace(displacement=motions.displacement * [1.0, -1.0, -1.0]))
