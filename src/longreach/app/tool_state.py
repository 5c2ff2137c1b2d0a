"""Where the tool and the base are, and how sure that is: the state s of (3.5) with its covariance."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.geometry import so3
from longreach.measurement import frozen_array


@dataclass(frozen=True, eq=False)
class ToolState:
    """s (10,) = [x y z q_w q_x q_y q_z x_b y_b θ_b], the tool's pose (3.3) with q_w ≥ 0 and the base's (3.4) [m, rad].

    covariance (6, 6): of the tool's error ξ = log(mean⁻¹ · truth) = [v; ω], in the tool's frame.
    """

    s: Float[np.ndarray, "10"]
    covariance: Float[np.ndarray, "6 6"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "s", frozen_array(self.s, (10,), "ToolState.s"))
        object.__setattr__(self, "covariance", frozen_array(self.covariance, (6, 6), "ToolState.covariance"))


def tool_state(
    base_pose: Float[np.ndarray, "3"],
    base_covariance: Float[np.ndarray, "3 3"],
    T_world_tool: Float[np.ndarray, "4 4"],
    J: Float[np.ndarray, "6 joints_and_base"],
    joint_covariance: Float[np.ndarray, "joints joints"] | None = None,
) -> ToolState:
    """Carry the base's and the joints' uncertainty to the tool, to first order.

    Arguments: base_covariance of ξ = log(mean⁻¹ · truth) in the base's frame; J (6, 3 + n) [v; ω], world-aligned at the
    tool, with respect to q = [x, y, θ, q1..qn]; joint_covariance (n, n) [rad²], None where the joints are exact.
    The thesis stops at (3.5); a base error ξ moves q by blkdiag(R(θ), 1) ξ, and a world-aligned motion of the tool is
    its own frame's error after blkdiag(Rᵀ, Rᵀ).
    """
    R = T_world_tool[:3, :3]
    J_tool = np.vstack([R.T @ J[:3], R.T @ J[3:]])
    c, s = np.cos(base_pose[2]), np.sin(base_pose[2])
    J_base = J_tool[:, :3] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    covariance = J_base @ base_covariance @ J_base.T
    if joint_covariance is not None:
        covariance = covariance + J_tool[:, 3:] @ joint_covariance @ J_tool[:, 3:].T
    rotation = so3.log(R)
    angle = np.linalg.norm(rotation)
    q_xyz = 0.5 * np.sinc(angle / (2.0 * np.pi)) * rotation  # sin(angle/2) · axis
    return ToolState(
        np.concatenate([T_world_tool[:3, 3], [np.cos(0.5 * angle)], q_xyz, base_pose]),
        0.5 * (covariance + covariance.T),
    )
