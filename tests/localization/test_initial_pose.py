"""Where fixes put the base on the map."""

import numpy as np

from longreach.estimation.planar import filter as planar_filter
from longreach.geometry import se2
from longreach.localization.initial_pose import Fixed, from_fixes, on_map, thinned
from longreach.measurement import PoseMeasurement, TwistMeasurement

MOTION = np.array([5.0, -3.0, 2.2])  # T_map_odom
SIGMA = 0.05


def path(stamp):
    """Odometry along an arc at 1 m/s, from the identity on."""
    return se2.exp(stamp * np.array([1.0, 0.0, 0.1]))


def fixed_at(stamps, rng=None, where=path):
    R, made = np.diag([SIGMA**2, SIGMA**2, np.inf]), []
    for stamp in stamps:
        pose = se2.compose(MOTION, where(stamp))
        seen = pose[:2] + (0.0 if rng is None else SIGMA * rng.normal(size=2))
        made.append(Fixed(where(stamp), PoseMeasurement(float(stamp), np.append(seen, 0.0), R)))
    return tuple(made)


def test_a_fix_with_heading_is_the_pose_with_its_covariance_in_the_body_frame():
    R = np.diag([0.01, 0.04, 0.001])
    pose, covariance = from_fixes((Fixed(np.zeros(3), PoseMeasurement(0.0, np.array([1.0, 2.0, np.pi / 2]), R)),))
    np.testing.assert_array_equal(pose, [1.0, 2.0, np.pi / 2])
    np.testing.assert_allclose(covariance, 9.0 * np.diag([0.04, 0.01, 0.001]), atol=1e-15)


def test_fixes_without_heading_show_it_once_they_are_far_enough_apart():
    fixed = fixed_at(np.arange(0.0, 2.0, 0.2))
    known = [from_fixes(fixed[: n + 1]) is not None for n in range(len(fixed))]
    assert known == [False] * 3 + [True] * 7  # 10 deviations are 0.5 m
    pose, covariance = from_fixes(fixed)
    np.testing.assert_allclose(se2.difference(se2.compose(MOTION, fixed[-1].pose), pose), 0.0, atol=1e-9)
    assert np.sqrt(covariance[2, 2]) < np.radians(60.0)


def test_the_pose_is_within_what_its_covariance_says(rng):
    nees = []
    for _ in range(60):
        fixed = fixed_at(np.arange(0.0, 0.8, 0.1), rng)
        if (found := from_fixes(fixed)) is None:
            continue
        error = se2.difference(found[0], se2.compose(MOTION, fixed[-1].pose))
        nees.append(error @ np.linalg.solve(found[1], error))
    assert len(nees) > 50
    assert np.mean(nees) < 3.0  # larger than needed, for the last fix is fused as well
    assert np.max(nees) < 16.0


def test_a_robot_that_stands_is_not_on_the_map_however_often_it_is_seen(rng):
    assert from_fixes(fixed_at(np.arange(60.0), rng, lambda stamp: np.zeros(3))) is None
    many = fixed_at(np.arange(500.0), where=lambda stamp: np.zeros(3))
    assert thinned(many[:499]) == many[:499]
    assert len(thinned(many)) == 250
    assert thinned(many)[0] is many[0]


def test_the_filter_on_the_map_is_the_one_in_odom_about_another_reference(rng):
    state = planar_filter.init(0.0, np.zeros(3))
    for k in range(1, 20):
        state, _ = planar_filter.step(state, TwistMeasurement(0.1 * k, np.array([0.5, 0.0, 0.3]), 1e-4 * np.eye(3)))
    A = rng.normal(size=state.newest.P.shape)  # an odom whose reference is correlated with all else
    local, P = state.newest._replace(P=A @ A.T), np.diag([0.01, 0.02, 0.03])
    placed = on_map(local, MOTION, P)
    pose, covariance = placed.pose
    np.testing.assert_allclose(pose, MOTION, atol=1e-12)
    np.testing.assert_allclose(covariance, P + local.P[:3, :3], atol=1e-12)
    np.testing.assert_array_equal(placed.mean[:13], local.mean[:13])
    np.testing.assert_array_equal(placed.P[13:16, :13], 0.0)
    assert np.linalg.eigvalsh(placed.P)[0] > -1e-12
