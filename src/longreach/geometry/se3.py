"""SE(3), rigid motions in space as matrices (..., 4, 4); tangent vectors ξ = [v; ω] in the body frame.

Source: Solà, Deray & Atchuthan 2018, "A micro Lie theory for state estimation in robotics", appendix D; the block Q of
the Jacobian: Barfoot, "State Estimation for Robotics" (2017), (7.86).
"""

import numpy as np
from jaxtyping import Float

from longreach.geometry import _kernels, so3


def from_rotation_translation(R: Float[np.ndarray, "3 3"], p: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return the motion that rotates by R and then moves by p [m]."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p
    return T


def exp(xi: Float[np.ndarray, "*batch 6"]) -> Float[np.ndarray, "*batch 4 4"]:
    """Move from the identity by the twist ξ for one second."""
    rows = np.array(xi, dtype=float, order="C").reshape(-1, 6)
    out = np.empty((len(rows), 4, 4))
    _kernels.se3_exp_all(rows, out)
    return out.reshape(*np.shape(xi)[:-1], 4, 4)


def log(T: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 6"]:
    """Return the twist ξ, |ω| ≤ π, with exp(ξ) = T; precise near 0 and near π."""
    rows = np.array(T, dtype=float, order="C").reshape(-1, 4, 4)
    out = np.empty((len(rows), 6))
    _kernels.se3_log_all(rows, out)
    return out.reshape(*np.shape(T)[:-2], 6)


def compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a · b."""
    return a @ b


def inverse(T: Float[np.ndarray, "*batch 4 4"]) -> Float[np.ndarray, "*batch 4 4"]:
    """Return T⁻¹."""
    out = np.zeros_like(T)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = Rt
    out[..., :3, 3] = -(Rt @ T[..., :3, 3, None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def retract(T: np.ndarray, xi: np.ndarray) -> np.ndarray:
    """Return T · exp(ξ)."""
    return T @ exp(xi)


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return ξ = log(a⁻¹ · b), so that retract(a, ξ) = b."""
    return log(inverse(a) @ b)


def adjoint(T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "6 6"]:
    """Return Ad with T · exp(ξ) = exp(Ad ξ) · T."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = T[:3, :3]
    out[:3, 3:] = so3.hat(T[:3, 3]) @ T[:3, :3]
    return out


def _q_block(v: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Return Q(v, ω) of the left Jacobian [[V, Q], [0, V]]."""
    V, W = so3.hat(v), so3.hat(w)
    t = float(np.linalg.norm(w))
    if t < 0.2:  # the series, good to 1e-15 there
        t2 = t * t
        a = 1 / 6 - t2 / 120 + t2**2 / 5040 - t2**3 / 362880 + t2**4 / 39916800
        b = 1 / 24 - t2 / 720 + t2**2 / 40320 - t2**3 / 3628800 + t2**4 / 479001600
        c = 1 / 120 - t2 / 2520 + t2**2 / 120960 - t2**3 / 9979200 + t2**4 / 1245404160
    else:
        a = (t - np.sin(t)) / t**3
        b = (t**2 + 2 * np.cos(t) - 2) / (2 * t**4)
        c = (2 * t - 3 * np.sin(t) + t * np.cos(t)) / (2 * t**5)
    WV, VW = W @ V, V @ W
    WVW = WV @ W
    return 0.5 * V + a * (WV + VW + WVW) + b * (W @ WV + VW @ W - 3 * WVW) + c * (WVW @ W + W @ WVW)


def right_jacobian(xi: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6 6"]:
    """Return J_r with exp(ξ + δ) = exp(ξ) · exp(J_r δ) to first order in δ."""
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = so3.right_jacobian(xi[3:])
    out[:3, 3:] = _q_block(-xi[:3], -xi[3:])
    return out


def right_jacobian_inverse(xi: Float[np.ndarray, "6"]) -> Float[np.ndarray, "6 6"]:
    """Return J_r⁻¹: log(exp(ξ) · exp(δ)) = ξ + J_r⁻¹ δ to first order in δ."""
    J = so3.right_jacobian_inverse(xi[3:])
    out = np.zeros((6, 6))
    out[:3, :3] = out[3:, 3:] = J
    out[:3, 3:] = -J @ _q_block(-xi[:3], -xi[3:]) @ J
    return out
