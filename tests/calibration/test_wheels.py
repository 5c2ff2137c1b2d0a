import numpy as np
import pytest
from calibration_drives import DIFFERENTIAL, MECANUM, ODOMETRY, SKID, arc, motions_of, sideways, straight, turning
from jacobians import assert_is_jacobian

from longreach.calibration.extrinsics import sensor_displacement
from longreach.calibration.wheels import Motions, base_motion, wheel_model
from longreach.errors import CalibrationError
from longreach.geometry import se2
from longreach.robot.description import RobotDescription


@pytest.mark.parametrize("robot", [DIFFERENTIAL, MECANUM, SKID])
def test_with_nominal_parameters_the_matrix_is_that_of_the_base(robot):
    model = wheel_model(robot)
    np.testing.assert_allclose(model.matrix(model.nominal)[0], robot.base.forward_matrix, atol=1e-15)


def test_a_base_that_is_steered_like_a_car_is_refused_by_its_kind():
    base = {
        "kind": "ackermann",
        "wheel_radius": 0.3,
        "wheelbase": 2.0,
        "track_width": 1.5,
        "rear_wheels": ["rear"],
        "steering": "steer",
    }
    with pytest.raises(CalibrationError, match="of the kind ackermann; calibrated are"):
        wheel_model(RobotDescription(name="car", base=base))


@pytest.mark.parametrize("robot", [DIFFERENTIAL, MECANUM, ODOMETRY, SKID])
def test_the_derivative_of_a_displacement_agrees_with_finite_differences(rng, robot):
    model = wheel_model(robot)
    q = np.concatenate((model.nominal * 1.02, [0.2, -0.1, 0.4], rng.normal(size=len(model.slip)) * 0.01))
    turns = rng.normal(0.2, 0.4, (12, model.matrix(model.nominal)[0].shape[1]))
    motions = Motions(turns, np.array([[0, 4], [4, 5], [6, 12]]), np.zeros((3, 3)))
    _, J = sensor_displacement(model, q, motions)
    for i in range(3):
        assert_is_jacobian(
            lambda x, i=i: sensor_displacement(model, x, motions)[0][i], J[i], q, difference=se2.difference
        )


def test_steps_are_composed_as_dead_reckoning_does(rng):
    model, turns = wheel_model(DIFFERENTIAL), rng.normal(0.0, 0.5, (30, 2))
    pose = np.zeros(3)
    for u in turns[10:]:
        pose = se2.retract(pose, DIFFERENTIAL.base.forward_matrix @ u)
    found, _ = base_motion(model, model.nominal, Motions(turns, np.array([[10, 30]]), np.zeros((1, 3))))
    np.testing.assert_allclose(se2.difference(pose, found[0]), 0.0, atol=1e-12)


def test_mecanum_wheels_that_roll_show_the_ratios_of_their_radii(rng):
    model, true = wheel_model(MECANUM), np.array([0.101, 0.1015, 0.0995, 0.1, 0.41])
    twists = np.concatenate((straight(60), sideways(60), turning(60), arc(20)))
    motions = motions_of(rng, model, true, np.zeros(3), twists)
    np.testing.assert_allclose(motions.turns @ (model.signs[0] * true[:4]), 0.0, atol=1e-12)
    assert np.abs(motions.turns @ (model.signs[0] * model.nominal[:4])).max() > 1e-4
