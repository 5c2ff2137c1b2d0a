"""When to be where on a path of configurations: as soon as the joints' limits allow.

Source: Pham & Pham 2018, "A new approach to time-optimal path parameterization based on reachability analysis", by
toppra. It keeps the limits at the points of a grid; what lies between them is stretched until it keeps them, too.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory
from longreach.errors import PlanningError

_FINER = 4  # points of the grid a stretch between two waypoints
_COARSEST = 200  # points of the grid at least


def retime(
    trajectory: ConfigurationTrajectory,
    velocity_limits: Float[np.ndarray, " dof"],
    acceleration_limits: Float[np.ndarray, " dof"],
    rate: float = 125.0,
) -> ConfigurationTrajectory:
    """Return the same path, a cubic spline through the configurations, from rest to rest in the least time.

    Arguments: limits (dof,) [rad/s, rad/s², or m/s, m/s²], the same in both directions; rate: rows a second [Hz], the
    default being the UR10's control loop.

    Raises:
        PlanningError: limits that are not positive, or a path on which they cannot be kept.
    """
    dof = trajectory.q.shape[1]
    for name, limits in {"velocity": velocity_limits, "acceleration": acceleration_limits}.items():
        if len(limits) != dof or not (np.all(np.isfinite(limits)) and np.all(limits > 0)):
            raise PlanningError(f"The {name} limits must be {dof} positive numbers, one a joint.")
    q = trajectory.q
    steps = np.max(np.abs(np.diff(q, axis=0)) / velocity_limits, axis=1)  # [s], each at the velocity limit
    moving = steps > 1e-9
    if not np.any(moving):
        return ConfigurationTrajectory(trajectory.stamps[:1], q[:1], trajectory.joint_names)
    q = q[np.concatenate(([True], moving))]
    knots = np.concatenate(([0.0], np.cumsum(steps[moving])))
    motion = _fastest(knots, q, velocity_limits, acceleration_limits)
    stretch = _stretch(motion, velocity_limits, acceleration_limits)
    rows = max(int(np.ceil(motion.duration * stretch * rate)), 1) + 1
    t = np.linspace(0.0, motion.duration, rows)
    return ConfigurationTrajectory(
        trajectory.stamps[0] + stretch * t, motion(t), trajectory.joint_names, motion(t, 1) / stretch
    )


def _fastest(knots: np.ndarray, q: np.ndarray, velocity: np.ndarray, acceleration: np.ndarray) -> Any:
    """Return toppra's motion: called with times and an order it gives q, q̇ or q̈; `duration` [s]."""
    from toppra import SplineInterpolator, algorithm, constraint  # here, for it takes seconds to import

    path = SplineInterpolator(knots, q)
    limits = [
        constraint.JointVelocityConstraint(np.column_stack([-velocity, velocity])),
        constraint.JointAccelerationConstraint(np.column_stack([-acceleration, acceleration])),
    ]
    finer = max(_FINER, int(np.ceil(_COARSEST / (len(knots) - 1))))
    part = np.arange(finer) / finer
    grid = np.append((knots[:-1, None] + np.diff(knots)[:, None] * part).ravel(), knots[-1])
    solver = algorithm.TOPPRA(limits, path, gridpoints=grid, parametrizer="ParametrizeConstAccel")
    motion = solver.compute_trajectory(0.0, 0.0)
    if motion is None:
        raise PlanningError("The limits cannot be kept on this path; give it fewer or smoother waypoints.")
    return motion


def _stretch(motion: Any, velocity: np.ndarray, acceleration: np.ndarray) -> float:
    """Return by how much longer (1: none) the motion must take, so that the limits hold between the grid's points."""
    t = np.linspace(0.0, motion.duration, 20 * _COARSEST + 1)
    speed = np.max(np.abs(motion(t, 1)) / velocity)
    force = np.max(np.abs(motion(t, 2)) / acceleration)
    return float(max(1.0, speed, np.sqrt(force)))


def eased(trajectory: ConfigurationTrajectory, ramp: float = 1.0, rate: float = 50.0) -> ConfigurationTrajectory:
    """Return the same path at the same pace, but from rest and to rest: a robot cannot start at full speed.

    Within `ramp` [s] at either end the pace grows and falls without a jump of acceleration, so that the whole takes
    `ramp` longer. rate: rows a second [Hz].

    Raises:
        PlanningError: a ramp that is not positive, or one row only.
    """
    from scipy.interpolate import CubicSpline  # here, for it takes a while to import

    if not (0.0 < ramp < np.inf and 0.0 < rate < np.inf) or len(trajectory) < 2:
        raise PlanningError("A trajectory is eased over a positive time, and has at least two rows.")
    length = trajectory.duration
    ramp = min(ramp, length)
    path = CubicSpline(trajectory.stamps, trajectory.q)
    t = np.linspace(0.0, length + ramp, int(np.ceil((length + ramp) * rate)) + 1)
    up, down = np.minimum(t / ramp, 1.0), np.minimum((t[-1] - t) / ramp, 1.0)
    # The pace is 3 u² - 2 u³ in a ramp, u its part; the integral of that is u³ - u⁴/2.
    tau = ramp * (up**3 - up**4 / 2) + np.maximum(t - ramp, 0.0)
    tau = np.where(t > length, length - ramp * (down**3 - down**4 / 2), tau)
    pace = np.minimum(3 * up**2 - 2 * up**3, 3 * down**2 - 2 * down**3)
    at = trajectory.stamps[0] + np.clip(tau, 0.0, length)
    return ConfigurationTrajectory(
        trajectory.stamps[0] + t, path(at), trajectory.joint_names, path(at, 1) * pace[:, None], trajectory.reports
    )
