"""How a tool stands as seen from where it should stand, and how that changes with the joints.

There is one error, e = log(T_target⁻¹ T) = [ρ; φ·axis] (4.28), zero at the target and growing away from it; a solver
moves against it. (3.18) of the thesis is tan(φ)·axis, singular at 90° and pointing away from the target beyond: a named
option, "cross", with its signs turned to agree with (4.28).
"""

from typing import Literal

import numpy as np
from jaxtyping import Float

from longreach.errors import PlanningError
from longreach.geometry import so3
from longreach.planning import _task_kernels

Kind = Literal["log", "cross"]


def orientation_error(
    R: Float[np.ndarray, "3 3"], R_target: Float[np.ndarray, "3 3"], kind: Kind = "log"
) -> Float[np.ndarray, "3"]:
    """Return the rotation from R_target to R, as seen from R_target: φ·axis [rad], or tan(φ)·axis (3.18) [1].

    Raises:
        PlanningError: kind is "cross" and the rotation is 90° or more, where (3.18) means nothing.
    """
    R_relative = R_target.T @ R
    if kind == "log":
        return so3.log(R_relative)
    cos = 0.5 * (np.trace(R_relative) - 1.0)
    _check_below_quarter(cos)
    S = R_relative - R_relative.T
    return np.array([S[2, 1], S[0, 2], S[1, 0]]) / (2.0 * cos)


def _check_below_quarter(cos: float) -> None:
    if cos < 1e-9:
        raise PlanningError('The orientation is 90° or more from its target; only the error of kind "log" goes so far.')


def pose_error_and_jacobian(
    T: Float[np.ndarray, "4 4"], J: Float[np.ndarray, "6 n"], T_target: Float[np.ndarray, "4 4"], kind: Kind = "log"
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6 n"]]:
    """Return the error e (6,) [m, rad] of the pose T and its derivative (6, n) with respect to the joints.

    Arguments: J: the world-aligned geometric Jacobian at T (3.12). J itself is the derivative only where e is small.
    """
    e, J_e = np.empty(6), np.empty_like(J)
    if kind == "log":
        _task_kernels.pose_error_and_jacobian(T_target, T, J, e, J_e)
        return e, J_e
    _check_below_quarter(0.5 * (float(np.sum(T_target[:3, :3] * T[:3, :3])) - 1.0))
    _task_kernels.cross_error_and_jacobian(T_target, T, J, e, J_e)
    return e, J_e
