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
    """The mean NEES of runs of wheels that differ and slip as assumed is the number of parameters within 30 %."""
    model, nees = wheel_model(robot), []
    for _ in range(15):
        true, drive = WHEELS, DRIVE
        if robot is MECANUM:
            radii = 0.1012 + rng.normal(size=4) * 0.00025
            slip = rng.normal(size=len(model.slip)) * model.slip_deviation
            true, drive = np.concatenate((radii, [0.41], slip)), np.concatenate((DRIVE, sideways(80)))
        motions = motions_of(rng, model, true, MOUNT, drive, (0.001, 0.0005, 0.002))
        noise = rng.normal(size=motions.turns.shape) * 0.002
        found = calibrate_motions(model, motions._replace(turns=motions.turns + noise), MOUNT, scale_deviation=0.0)
        e = found.values - [*true[: len(model.nominal)], *MOUNT]
        nees.append(e @ np.linalg.solve(found.covariance, e) / len(e))
    assert 0.7 < np.mean(nees) < 1.3


def test_slip_of_rollers_is_not_taken_for_radii_that_differ(rng):
    """Of equal wheels the ratios of radii found are 1 within what is stated."""
    model, inside = wheel_model(MECANUM), []
    for _ in range(10):
        slip = rng.normal(size=len(model.slip)) * model.slip_deviation
        true = np.concatenate((np.full(4, 0.1), [0.4], slip))
        motions = motions_of(rng, model, true, MOUNT, np.concatenate((DRIVE, sideways(80))))
        found = calibrate_motions(model, motions, MOUNT)
        ratios = np.eye(4)[:3] - 0.25
        d, P = ratios @ found.values[:4], ratios @ found.covariance[:4, :4] @ ratios.T
        inside.append(d @ np.linalg.solve(P, d) < 11.3)  # 1 % of a chi-square of 3 degrees of freedom
    assert sum(inside) >= 9


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


@pytest.mark.parametrize("robot", [DIFFERENTIAL, MECANUM])
@pytest.mark.parametrize("fault", ["wheels", "laser"])
def test_wheels_that_are_exchanged_and_a_laser_that_is_upside_down_are_said(rng, robot, fault):
    model = wheel_model(robot)
    true, drive = (WHEELS, DRIVE) if robot is DIFFERENTIAL else (model.nominal, np.concatenate((DRIVE, sideways(80))))
    motions = motions_of(rng, model, true, MOUNT, drive)
    if fault == "wheels":
        sides = ["left" in name for name in model.names[:-1]]
        left, right = np.flatnonzero(sides), np.flatnonzero(np.logical_not(sides))
        order = np.arange(len(sides))
        order[left], order[right] = right, left
        motions = motions._replace(turns=motions.turns[:, order].copy())
    else:
        motions = motions._replace(displacement=motions.displacement * [1.0, -1.0, -1.0])
    with pytest.raises(
        CalibrationError, match=r"exchange the left and the right wheels.*or say that the sensor is upside"
    ):
        calibrate_motions(model, motions, MOUNT)


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
