"""Range flow from scan to scan, as a matcher: nothing is added to it, and nothing taken off."""

from dataclasses import replace

import numpy as np
from room_scans import NOWHERE, STEP, along, scans_along

from longreach.odometry import range_flow
from longreach.odometry.lidar import LidarConfig, lidar_odometry


def test_range_flow_behind_the_face_is_range_flow(rng):
    scans = scans_along(along(STEP, 5), rng=rng)
    found = lidar_odometry(scans, NOWHERE, LidarConfig(method="range-flow"))
    for match, same in zip(found, range_flow.lidar_odometry(scans, NOWHERE), strict=True):
        np.testing.assert_array_equal(match.measurement.pose, same.measurement.pose)
        np.testing.assert_array_equal(match.measurement.covariance, same.measurement.covariance)
        np.testing.assert_array_equal(match.measurement.shared_covariance, np.zeros((3, 3)))
        np.testing.assert_array_equal(match.motion, same.measurement.pose)
        assert match.keyframe


def test_a_prior_makes_no_difference_to_it(rng):
    scans = scans_along(along(STEP, 5), rng=rng)
    config = LidarConfig(method="range-flow")
    with_it = lidar_odometry(scans, NOWHERE, config, priors=[None, *[2.0 * STEP] * 5])
    for match, same in zip(with_it, lidar_odometry(scans, NOWHERE, config), strict=True):
        np.testing.assert_array_equal(match.measurement.pose, same.measurement.pose)


def test_after_scans_that_see_nothing_it_starts_anew_with_the_first_that_does(rng):
    scans = scans_along(along(STEP, 9), rng=rng)
    for i in (3, 4):
        scans[i] = replace(scans[i], ranges=np.zeros(360))
    matches = lidar_odometry(scans, NOWHERE, LidarConfig(method="range-flow"))
    for match in matches[7:]:
        np.testing.assert_allclose(match.measurement.pose, STEP, atol=2e-2)
