"""How well a robot's tool can move in all directions, each measure with its analytic gradient.

With σ the six singular values of the Jacobian: M = √det(JJᵀ) = Πσ (4.30), κ = σ_max/σ_min (4.32), √(κ/M) (4.34), and
log M. The three linear rows are divided by a length that makes metres and radians comparable, 1 m unless given: κ
depends on it. (4.31) misses a factor det(JJᵀ): right is ∂M/∂q_k = M · tr((JJᵀ)⁻¹ H_k Jᵀ), H_k = ∂J/∂q_k.

In a singular configuration, where M has no gradient and κ no value, a singular value counts as at least 1e-12 of the
largest, so that all numbers are finite.
"""

from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from longreach.errors import ModelError
from longreach.robot import _manipulability_kernels as kernels
from longreach.robot.mobile_manipulator import MobileManipulator

Measure = Literal["m", "kappa", "sqrt_kappa_over_m", "log_m"]
Part = Literal["full", "arm"]


def manipulability(
    robot: MobileManipulator,
    q: Float[np.ndarray, "*batch n"],
    measure: Measure = "m",
    part: Part = "full",
    length: float = 1.0,
) -> tuple[Float[np.ndarray, "*batch"], Float[np.ndarray, "*batch n"]]:
    """Return a measure of the tool's Jacobian and its gradient over all of q, at one configuration or at many.

    part: full takes all columns, arm those of the arm's joints alone. length [m]: what the linear rows are divided by.

    Raises:
        ModelError: there are fewer than six columns, no such measure or part, or the length is not above 0.
    """
    first = _first_column(robot, measure, part, length)
    _, J = robot.forward_and_jacobian_batch(np.reshape(q, (-1, np.shape(q)[-1])))
    logs, gradients = np.empty((len(J), 2)), np.empty((len(J), 2, robot.dof))
    kernels.log_measures_batch(J, first, float(length), logs, gradients)
    value, gradient = _of_logs(measure, logs, gradients)
    return value.reshape(np.shape(q)[:-1]), gradient.reshape(np.shape(q))


def _first_column(robot: MobileManipulator, measure: str, part: str, length: float) -> int:
    if measure not in get_args(Measure):
        raise ModelError(f"There is no measure {measure!r}; there are {', '.join(get_args(Measure))}.")
    if part not in get_args(Part):
        raise ModelError(f"There is no part {part!r}; there are {', '.join(get_args(Part))}.")
    if not 0.0 < length < np.inf:
        raise ModelError(f"The length is {length:g} m; it must be above 0 and finite.")
    first = robot.arm.start if part == "arm" else 0
    if robot.dof - first < 6:
        raise ModelError(
            f"Manipulability needs six joints, but {robot.name} has {robot.dof - first} in its {part} Jacobian."
        )
    return first


def _of_logs(measure: str, logs: np.ndarray, gradients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a measure (m,) and its gradient (m, n) from log M and log κ and theirs."""
    log_m, log_kappa = logs[:, 0], logs[:, 1]
    if measure == "log_m":
        return log_m, gradients[:, 0]
    if measure == "m":
        value, exponent = np.exp(log_m), gradients[:, 0]
    elif measure == "kappa":
        value, exponent = np.exp(log_kappa), gradients[:, 1]
    else:
        value, exponent = np.exp(0.5 * (log_kappa - log_m)), 0.5 * (gradients[:, 1] - gradients[:, 0])
    return value, value[:, None] * exponent
