"""Where to be between the rows of a trajectory: cubic and quintic Hermite interpolation.

What ros_control's joint trajectory controller does: cubic through positions and velocities, quintic through positions,
velocities and accelerations, at rest before the start and after the end, the last velocity zero. Where it has
positions alone it goes in straight lines with jumps of velocity; ours goes along the smooth spline through them.
Source: ros_control, joint_trajectory_controller, "Trajectory representation".
"""

from typing import Literal

import numpy as np
from jaxtyping import Float

from longreach.configuration import ConfigurationTrajectory
from longreach.control import _interpolation_kernels
from longreach.errors import ControlError

Degree = Literal["cubic", "quintic"]


def timed_points(
    stamps: Float[np.ndarray, " n"],
    q: Float[np.ndarray, "n dof"],
    velocities: Float[np.ndarray, "n dof"] | None = None,
    joint_names: tuple[str, ...] = (),
) -> ConfigurationTrajectory:
    """Return the trajectory through timed points that ends at rest.

    Arguments: stamps (n,) [s]; q (n, dof) [rad or m]; velocities (n, dof) or None: those of the cubic spline with
    continuous accelerations that starts and ends at rest.

    Raises:
        PlanningError: numbers or shapes that are no trajectory.
    """
    if velocities is not None:
        end = np.array(velocities, dtype=float)
        end[-1:] = 0.0
        return ConfigurationTrajectory(stamps, q, joint_names, end)
    points = ConfigurationTrajectory(stamps, q, joint_names)
    if len(points) < 2:
        return points
    from scipy.interpolate import CubicSpline  # here, for it takes a while to import

    smooth = CubicSpline(points.stamps, points.q, bc_type="clamped")(points.stamps, 1)
    smooth[-1] = 0.0
    return ConfigurationTrajectory(points.stamps, points.q, joint_names, smooth)


def sample(
    trajectory: ConfigurationTrajectory,
    t: float | Float[np.ndarray, " m"],
    degree: Degree = "cubic",
    accelerations: Float[np.ndarray, "n dof"] | None = None,
) -> tuple[Float[np.ndarray, "*m dof"], Float[np.ndarray, "*m dof"], Float[np.ndarray, "*m dof"]]:
    """Return q, q̇, q̈ at one time [s] or at many: (dof,) or (m, dof) each.

    cubic has continuous velocities, quintic continuous accelerations, too: those given, one row a waypoint, or else
    the mean of what the two cubics that meet in a waypoint have, and 0 at both ends; between two points at rest that is
    the path of least jerk. Before the start and after the end the robot stands.

    Raises:
        ControlError: accelerations of another shape, or for a cubic, which cannot have them.
    """
    times = np.atleast_1d(np.asarray(t, dtype=float))
    n, dof = trajectory.q.shape
    if accelerations is None:
        a = trajectory.q[:0]
    elif degree == "cubic" or accelerations.shape != (n, dof):
        raise ControlError(f"Accelerations are for degree quintic, one row of {dof} for each of the {n} waypoints.")
    else:
        a = np.ascontiguousarray(accelerations, dtype=float)
    out = np.empty((len(times), 3, dof))
    _interpolation_kernels.sample_all(
        trajectory.stamps, trajectory.q, trajectory.velocities, a, degree == "quintic", times, out
    )
    if np.ndim(t) == 0:
        return out[0, 0], out[0, 1], out[0, 2]
    return out[:, 0], out[:, 1], out[:, 2]
