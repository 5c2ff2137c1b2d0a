"""Roll, pitch and yaw of many rotations at once, against one at a time and numeric derivatives."""

import numpy as np
from jacobians import assert_is_jacobian

from longreach.estimation.spatial.angles import angle_rates, body_rates, from_angles, to_angles
from longreach.geometry import so3


def test_angles_and_rotations_are_each_others_inverse(rng):
    rho = np.column_stack([rng.uniform(-3, 3, 20), rng.uniform(-1.5, 1.5, 20), rng.uniform(-3, 3, 20)])
    np.testing.assert_allclose(to_angles(from_angles(rho)), rho, atol=1e-12)
    for angles, R in zip(rho, from_angles(rho), strict=True):
        np.testing.assert_allclose(R, so3.from_roll_pitch_yaw(*angles), atol=1e-12)
    np.testing.assert_allclose(angle_rates(rho) @ body_rates(rho), np.broadcast_to(np.eye(3), (20, 3, 3)), atol=1e-9)


def test_body_rates_are_the_derivative_of_the_rotation(rng):
    rho = rng.normal(size=(1, 3)) * 0.5
    R = from_angles(rho)[0]
    assert_is_jacobian(lambda a: so3.log(R.T @ from_angles(a[None])[0]), body_rates(rho)[0], rho[0])
