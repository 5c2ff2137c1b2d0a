"""SO(3), rotations in space as matrices (..., 3, 3); tangent vectors ω are rotation vectors [rad] in the body frame.

Source: Solà, Deray & Atchuthan 2018, "A micro Lie theory for state estimation in robotics", appendix B.
"""

import numpy as np
from jaxtyping import Float

from longreach.geometry import _kernels


def hat(w: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return [ω]×, the matrix of the cross product with ω."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def exp(w: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Return the rotation about ω by |ω|."""
    rows = np.array(w, dtype=float, order="C").reshape(-1, 3)
    out = np.empty((len(rows), 3, 3))
    _kernels.so3_exp_all(rows, out)
    return out.reshape(*np.shape(w), 3)


def log(R: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Return the rotation vector ω, |ω| ≤ π, with exp(ω) = R; precise near 0 and near π."""
    rows = np.array(R, dtype=float, order="C").reshape(-1, 3, 3)
    out = np.empty((len(rows), 3))
    _kernels.so3_log_all(rows, out)
    return out.reshape(np.shape(R)[:-1])


def compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a · b."""
    return a @ b


def inverse(R: Float[np.ndarray, "*batch 3 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """Return R⁻¹ = Rᵀ."""
    return np.swapaxes(R, -1, -2)


def adjoint(R: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Return Ad with R · exp(ω) = exp(Ad ω) · R: R itself."""
    return R


def retract(R: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return R · exp(ω)."""
    return R @ exp(w)


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return ω = log(a⁻¹ · b), so that retract(a, ω) = b."""
    return log(inverse(a) @ b)


def right_jacobian(w: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return J_r with exp(ω + δ) = exp(ω) · exp(J_r δ) to first order in δ."""
    out = np.empty((3, 3))
    _kernels.so3_left_jacobian(-w[0], -w[1], -w[2], out)
    return out


def right_jacobian_inverse(w: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return J_r⁻¹: log(exp(ω) · exp(δ)) = ω + J_r⁻¹ δ to first order in δ."""
    out = np.empty((3, 3))
    _kernels.so3_left_jacobian_inverse(-w[0], -w[1], -w[2], out)
    return out


def from_roll_pitch_yaw(roll: float, pitch: float, yaw: float) -> Float[np.ndarray, "3 3"]:
    """Return Rz(yaw) Ry(pitch) Rx(roll), the convention of URDF and REP-103 [rad]."""
    return exp(np.array([0.0, 0.0, yaw])) @ exp(np.array([0.0, pitch, 0.0])) @ exp(np.array([roll, 0.0, 0.0]))
