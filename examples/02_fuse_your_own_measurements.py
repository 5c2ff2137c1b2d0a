"""Fuse measurements one at a time, as they come in, one of them late.

python examples/02_fuse_your_own_measurements.py
"""

import numpy as np

import longreach as lr
from longreach.estimation.planar import filter as planar_filter
from longreach.estimation.planar.config import FilterConfig

rng = np.random.default_rng(0)
twist = np.array([0.5, 0.0, 0.2])  # [m/s, m/s, rad/s]: the base drives in a circle
odometry_noise = np.diag([0.02, 0.02, 0.02]) ** 2
position_noise = np.diag([0.05**2, 0.05**2, np.inf])  # infinite: the heading is not measured


def where(stamp: float) -> np.ndarray:
    """Return the true pose [m, m, rad] on the circle."""
    turned = twist[2] * stamp
    radius = twist[0] / twist[2]
    return np.array([radius * np.sin(turned), radius * (1 - np.cos(turned)), turned])


state = planar_filter.init(0.0, np.zeros(3), np.diag([0.01, 0.01, 0.01]) ** 2, FilterConfig())
for k in range(1, 501):
    stamp = 0.02 * k
    state, _ = planar_filter.step(
        state, lr.TwistMeasurement(stamp, twist + 0.02 * rng.standard_normal(3), odometry_noise)
    )
    if k % 50 == 0:  # a camera on the ceiling, whose pictures take 0.3 s to be looked at
        seen = where(stamp - 0.3) + np.append(0.05 * rng.standard_normal(2), 0.0)
        state, correction = planar_filter.step(
            state, lr.PoseMeasurement(stamp - 0.3, seen, position_noise, source="camera")
        )
        print(f"{stamp:4.1f} s: camera {correction.status}, NIS {correction.nis:.2f} of {correction.dof}")

belief = state.belief
error = belief.pose - where(belief.stamp)
print(f"error {np.hypot(*error[:2]):.3f} m, stated {np.sqrt(np.trace(belief.covariance[:2, :2])):.3f} m")
