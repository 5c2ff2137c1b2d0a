"""The whole-body controller: what base and arm are commanded so that the tool stays on its path, wherever the base is.

Base and arm each follow the plan, and the arm takes up what the base does wrong: of the twist V that the tool needs,
the base's command gives J_base u, and the arm gives the rest,

    q̇_arm = J_arm# (V_ref + k e - J_base u),    e = the tool's pose error, world-aligned,

J# being damped near singularities. So the tool's error is the estimate's, and not the base's, as long as the arm can
reach. Open loop, nobody looks: the base does the plan's velocities, the arm follows the plan's angles.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.geometry import so3
from longreach.robot.mobile_manipulator import MobileManipulator


class WholeBodyConfig(BaseModel):
    """Settings of the whole-body controller."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    loop: Literal["closed", "open"] = Field(default="closed", description="Whether the estimate of the base is used.")
    base_gain: float = Field(default=1.5, ge=0, description="From the base's error to its velocity [1/s]; ours.")
    tool_gain: float = Field(default=8.0, ge=0, description="From the tool's error to its velocity [1/s]; ours.")
    arm_gain: float = Field(default=4.0, ge=0, description="From a joint's error to its speed, open loop [1/s]; ours.")
    reach_speed: float = Field(default=0.25, gt=0, description="Of the tool pulled to a pose [m/s]; ISO 10218's slow.")
    reach_turn: float = Field(default=1.0, gt=0, description="And how fast it turns [rad/s]; ours.")
    damping: float = Field(default=0.05, ge=0, description="Largest damping of the arm's inverse [1]; ours.")
    singular: float = Field(default=0.02, ge=0, description="Damped where M of the arm is below this [m³]; ours.")


class Reference(NamedTuple):
    """Where the plan is now: q (n,) and q̇ (n,), base first."""

    q: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " n"]


class DesiredVelocity(NamedTuple):
    """Velocities of the arm (m,) [rad/s] and the twist of the base (3,) in its own axes."""

    arm: Float[np.ndarray, " m"]
    base: Float[np.ndarray, "3"]


def step(
    robot: MobileManipulator, config: WholeBodyConfig, q: Float[np.ndarray, " n"], reference: Reference
) -> DesiredVelocity:
    """Return what to tell base and arm where the robot is at q (n,), as measured and estimated, base first."""
    base, arm = robot.base, robot.arm
    u_ref = reference.velocity[base]
    if config.loop == "open":
        correction = config.arm_gain * (reference.q[arm] - q[arm])
        return DesiredVelocity(reference.velocity[arm] + correction, _in_body(reference.q[base], u_ref))
    away = reference.q[base] - q[base]
    away[2:] = (away[2:] + np.pi) % (2.0 * np.pi) - np.pi
    u = u_ref + config.base_gain * away
    T, J = robot.forward_and_jacobian(q)
    T_ref, J_ref = robot.forward_and_jacobian(reference.q)
    e = _pose_error(T, T_ref)
    V = J_ref @ reference.velocity + config.tool_gain * e
    return DesiredVelocity(_damped(J[:, arm], V - J[:, base] @ u, config), _in_body(q[base], u))


def reach(
    robot: MobileManipulator, config: WholeBodyConfig, q: Float[np.ndarray, " n"], T_ref: Float[np.ndarray, "4 4"]
) -> DesiredVelocity:
    """Return how the arm pulls the tool straight to T_world_tool from q (n,), slowly; the base stands."""
    T, J = robot.forward_and_jacobian(q)
    V = config.arm_gain * _pose_error(T, T_ref)
    much = max(np.linalg.norm(V[:3]) / config.reach_speed, np.linalg.norm(V[3:]) / config.reach_turn, 1.0)
    return DesiredVelocity(_damped(J[:, robot.arm], V / much, config), np.zeros(3))


def _pose_error(T: np.ndarray, T_ref: np.ndarray) -> np.ndarray:
    """Return what T lacks to T_ref, (6,) [v; ω], world-aligned."""
    return np.concatenate([T_ref[:3, 3] - T[:3, 3], so3.log(T_ref[:3, :3] @ T[:3, :3].T)])


def _in_body(pose: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the body twist of a base whose pose (3,) changes by u (3,) in the world's axes; both (0,) where bolted."""
    if not len(pose):
        return np.zeros(3)
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([c * u[0] + s * u[1], -s * u[0] + c * u[1], u[2]])


def _damped(J: np.ndarray, V: np.ndarray, config: WholeBodyConfig) -> np.ndarray:
    """Return J# V: the inverse, damped by λ² = λ_max² (1 - M/M_0)² below M_0 (Nakamura & Hanafusa 1986)."""
    A = J @ J.T
    M = np.sqrt(max(np.linalg.det(A), 0.0))
    if config.singular > M:
        A = A + (config.damping * (1.0 - M / config.singular)) ** 2 * np.eye(len(A))
    return J.T @ np.linalg.solve(A, V)
