import numpy as np
import pytest
from calibration_drives import DIFFERENTIAL, MECANUM, ODOMETRY, arc, motions_of, sideways, straight, turning

from longreach.calibration.observability import calibrate_motions, not_shown
from longreach.calibration.wheels import wheel_model
from longreach.errors import CalibrationError

MOUNT = np.array([0.2, -0.05, 0.1])
ROBOTS = {
    "differential": (DIFFERENTIAL, [0.101, 0.1015, 0.41]),
    "mecanum": (MECANUM, [0.101, 0.1015, 0.0995, 0.1, 0.41]),
    "odometry": (ODOMETRY, [1.01, 1.02, 0.99]),
}
RADII = {"radius_left", "radius_right"}
FOUR = {"radius_front_left", "radius_rear_left", "radius_rear_right", "radius_front_right"}
DRIVES = {"straight": straight(300), "turning": turning(300), "arc": arc(300), "sideways": sideways(300)}
DRIVES["straight and turning"] = np.concatenate((straight(200), turning(200)))
DRIVES["straight and sideways"] = np.concatenate((straight(200), sideways(200)))


@pytest.mark.parametrize(
    ("robot", "drive", "observable"),
    [
        ("differential", "straight", RADII | {"laser_yaw"}),
        ("differential", "straight and turning", RADII | {"track_width", "laser_x", "laser_y", "laser_yaw"}),
        ("mecanum", "straight and sideways", FOUR | {"laser_yaw"}),
        ("mecanum", "straight and turning", FOUR | {"k", "laser_x", "laser_y", "laser_yaw"}),
        ("odometry", "straight", {"scale_x", "laser_yaw"}),
        ("odometry", "sideways", {"scale_y", "laser_yaw"}),
        ("odometry", "turning", {"scale_heading"}),
        ("odometry", "arc", {"scale_heading"}),
        ("odometry", "straight and turning", {"scale_x", "scale_heading", "laser_x", "laser_y", "laser_yaw"}),
    ],
)
def test_exactly_what_a_drive_does_not_show_is_refused_and_keeps_its_nominal_value(rng, robot, drive, observable):
    description, true = ROBOTS[robot]
    model, nominal = wheel_model(description), np.add(MOUNT, [0.01, 0.01, 0.02])
    found = calibrate_motions(model, motions_of(rng, model, np.array(true), MOUNT, DRIVES[drive]), nominal)
    assert {name for name, shown in zip(found.names, found.observable, strict=True) if shown} == observable
    sigma = np.sqrt(np.diag(found.covariance))
    error = np.abs(found.values - [*true, *MOUNT])
    assert np.all(error[found.observable] < 4.0 * sigma[found.observable])
    np.testing.assert_array_equal(found.values[~found.observable], found.nominal[~found.observable])
    assert np.all(sigma[~found.observable] == 0.0)


@pytest.mark.parametrize(
    ("robot", "drive"),
    [
        ("differential", "turning"),
        ("differential", "arc"),
        ("mecanum", "straight"),  # pairs of wheels that differ drive as a laser that is turned
        ("mecanum", "turning"),
        ("mecanum", "arc"),
    ],
)
def test_what_shows_only_ratios_is_refused_altogether_with_manoeuvres(rng, robot, drive):
    description, true = ROBOTS[robot]
    model = wheel_model(description)
    motions = motions_of(rng, model, np.array(true), MOUNT, DRIVES[drive])
    with pytest.raises(CalibrationError, match="drive straight for 2 m, forwards and back; then turn on the spot"):
        calibrate_motions(model, motions)


def test_standing_still_shows_nothing(rng):
    model = wheel_model(DIFFERENTIAL)
    with pytest.raises(CalibrationError, match="No parameter is observable from this run"):
        calibrate_motions(model, motions_of(rng, model, model.nominal, MOUNT, np.zeros((100, 3))))


def test_a_refusal_names_the_parameter_and_the_manoeuvre():
    assert not_shown("k") == "k is not observable from this run: turn on the spot for 20 s."
    assert not_shown("laser_yaw").endswith("drive straight for 2 m, forwards and back.")
    assert not_shown("scale_y").endswith("drive sideways for 2 m, and back.")
