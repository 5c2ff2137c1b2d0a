"""Keyframed LIDAR odometry on scans that take a while: each beam at its own time, undistorted by the base's motion."""

from itertools import pairwise

import numpy as np
import pytest
from room_scans import NOWHERE, error_of, sweeps_along

from longreach.geometry import se2, se3, so3
from longreach.measurement import LaserScan
from longreach.odometry.lidar import lidar_odometry


def test_a_sweep_on_a_turning_base_is_carried_to_where_it_began(rng):
    twist, period, n = np.array([0.03, 0.0, 0.12]), 0.1, 360
    start = np.array([-1.0, 0.0, 0.0])
    poses = [start, *(se2.compose(start, se2.exp(i * twist)) for i in range(5))]  # at rest in the first scan
    sweeps = sweeps_along(poses, [np.zeros(3), *[twist] * 5])
    sweeps = [ranges + 0.01 * rng.standard_normal(n) for ranges in sweeps]
    priors = [None, np.zeros(3), *[se2.exp(twist)] * 4]

    def worst(increment):
        scans = [LaserScan(0.1 * i, r, -np.pi, 2 * np.pi / n, time_increment=increment) for i, r in enumerate(sweeps)]
        found = [m for m in lidar_odometry(scans, NOWHERE, priors=priors)[1:] if m.measurement is not None]
        assert len(found) == 4
        return max(np.abs(error_of(m, poses)).max() for m in found)

    assert worst(period / n) < 0.65 * worst(0.0)  # the mean needs a few scans after so sudden a start


def test_a_sweep_after_a_blind_spell_is_carried_as_the_prior_says():
    before, after = np.array([0.02, 0.01, 0.03]), np.array([-0.03, 0.0, -0.05])  # while nothing is seen it turns back
    twists, blind = [np.zeros(3)] * 2 + [before] * 10 + [after] * 8, range(10, 18)
    poses = [np.array([-1.0, 0.0, 0.0])]
    for twist in twists:
        poses.append(se2.compose(poses[-1], se2.exp(twist)))
    sweeps = [0.0 * r if i in blind else r for i, r in enumerate(sweeps_along(poses[:-1], twists))]
    scans = [LaserScan(0.1 * i, r, -np.pi, 2 * np.pi / 360, time_increment=0.1 / 360) for i, r in enumerate(sweeps)]
    found = lidar_odometry(scans, NOWHERE, priors=[None, *(se2.exp(twist) for twist in twists[:-1])])
    assert [match.measurement is None for match in found[9:17]] == [True] * 8
    usual, first = (np.abs(error_of(found[i], poses)).max() for i in (8, 17))
    assert first < 2.0 * usual < 0.003  # after so sudden a start


@pytest.mark.parametrize("blind", [0, 1])
def test_what_the_base_turned_in_a_gap_is_no_motion_of_the_sweeps_after_it(blind, rng):
    twists = [np.array([0.02, 0.0, 0.06])] * 90
    poses = [np.array([-1.0, 0.0, 0.0])]
    for twist in twists[:-1]:
        poses.append(se2.compose(poses[-1], se2.exp(twist)))
    sweeps = [r + 0.01 * rng.standard_normal(360) for r in sweeps_along(poses, twists)]
    kept = [i for i in range(90) if not 20 + blind <= i < 65]  # 2.7 rad in 4.5 s
    ranges = {i: 0.0 * sweeps[i] if i == 20 and blind else sweeps[i] for i in kept}
    scans = [LaserScan(0.1 * i, ranges[i], -np.pi, 2 * np.pi / 360, time_increment=0.1 / 360) for i in kept]
    priors = [None, *(se2.between(poses[a], poses[b]) for a, b in pairwise(kept))]
    matches = lidar_odometry(scans, NOWHERE, priors=priors)
    assert sum(match.measurement is None for match in matches) == blind
    errors = np.array(
        [np.abs(error_of(m, poses)).max() for m in matches if m.measurement is not None and m.stamp > 6.4]
    )
    assert errors.max() < 0.02
    assert np.median(errors) < 0.005


def test_sweeps_of_a_base_that_turns_to_and_fro_at_two_radians_a_second_are_far_better_undistorted(rng):
    n, twists = 360, [np.array([0.02, 0.0, 0.2 * np.sin(0.1 * i)]) for i in range(60)]
    poses = [np.array([-1.0, 0.0, 0.0])]
    for twist in twists[:-1]:
        poses.append(se2.compose(poses[-1], se2.exp(twist)))
    sweeps = [r + 0.01 * rng.standard_normal(n) for r in sweeps_along(poses, twists)]

    def errors(increment):
        scans = [LaserScan(0.1 * i, r, -np.pi, 2 * np.pi / n, time_increment=increment) for i, r in enumerate(sweeps)]
        matches = lidar_odometry(scans, NOWHERE, priors=[None, *(se2.exp(twist) for twist in twists[:-1])])
        return np.abs([error_of(m, poses) for m in matches if m.measurement is not None])

    with_it, without = errors(0.1 / n), errors(0.0)
    assert len(with_it) == len(without) == 59
    assert (np.median(with_it, axis=0) < 0.45 * np.median(without, axis=0)).all()


def test_sweeps_whose_motion_lags_behind_are_corrected_and_say_how_wrong_that_leaves_them(rng):
    n, twists = 360, [np.array([0.02, 0.0, 0.2 * np.sin(0.1 * i)]) for i in range(120)]
    poses = [np.array([-1.0, 0.0, 0.0])]
    for twist in twists[:-1]:
        poses.append(se2.compose(poses[-1], se2.exp(twist)))
    sweeps = [r + 0.01 * rng.standard_normal(n) for r in sweeps_along(poses, twists)]
    scans = [LaserScan(0.1 * i, r, -np.pi, 2 * np.pi / n, time_increment=0.1 / n) for i, r in enumerate(sweeps)]
    nees, errors = [], []
    for match in lidar_odometry(scans, NOWHERE, priors=[None, *(se2.exp(twist) for twist in twists[:-1])])[20:]:
        xi = error_of(match, poses)
        errors.append(np.abs(xi))
        nees.append(xi @ np.linalg.solve(match.measurement.covariance, xi))
    assert np.median(errors, axis=0)[2] < 0.0013  # 0.0019 where the lag is not corrected
    assert 1.0 < np.mean(nees) < 6.0  # with the ranges' noise alone it is above 100


def test_sweeps_of_a_laser_off_the_middle_and_turned_are_undistorted_by_its_own_motion(rng):
    n, mount = 360, np.array([0.6, -0.3, 1.2])
    T = se3.from_rotation_translation(so3.from_roll_pitch_yaw(0.0, 0.0, mount[2]), np.array([*mount[:2], 0.2]))
    twists = [np.array([0.02, 0.0, 0.2 * np.sin(0.1 * i)]) for i in range(40)]
    poses = [np.array([-1.0, 0.0, 0.0])]
    for twist in twists[:-1]:
        poses.append(se2.compose(poses[-1], se2.exp(twist)))
    A = se2.adjoint(se2.inverse(mount))
    sweeps = sweeps_along([se2.compose(pose, mount) for pose in poses], [A @ twist for twist in twists])
    sweeps = [r + 0.01 * rng.standard_normal(n) for r in sweeps]
    scans = [LaserScan(0.1 * i, r, -np.pi, 2 * np.pi / n, time_increment=0.1 / n) for i, r in enumerate(sweeps)]
    matches = lidar_odometry(scans, T, priors=[None, *(se2.exp(twist) for twist in twists[:-1])])
    errors = np.abs([error_of(match, poses) for match in matches])
    assert (np.median(errors, axis=0) < 0.004).all()
