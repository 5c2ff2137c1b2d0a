"""SE(2), poses in the plane as arrays [x, y, θ] (m, m, rad), one or a batch of them: shape (..., 3).

Tangent vectors are ξ = [v_x, v_y, ω], in the body frame: T · exp(ξ) moves T by ξ as seen from itself.
Source: Solà, Deray & Atchuthan 2018, "A micro Lie theory for state estimation in robotics", appendix C.
"""

import numpy as np
from jaxtyping import Float

from longreach.geometry import _kernels

Pose = Float[np.ndarray, "*batch 3"]
Tangent = Float[np.ndarray, "*batch 3"]


def _rows(*arrays: np.ndarray) -> tuple[list[np.ndarray], tuple[int, ...]]:
    shapes = {np.shape(a) for a in arrays}
    if len(shapes) == 1:
        return [np.array(a, dtype=float, order="C").reshape(-1, 3) for a in arrays], shapes.pop()
    shape = np.broadcast_shapes(*shapes)
    return [np.array(np.broadcast_to(a, shape), dtype=float).reshape(-1, 3) for a in arrays], shape


def exp(xi: Tangent) -> Pose:
    """Move from the identity by the twist ξ for one second."""
    if np.ndim(xi) == 1:
        return np.array(_kernels.se2_exp(*xi.tolist()))
    (xi,), shape = _rows(xi)
    out = np.empty_like(xi)
    _kernels.se2_exp_all(xi, out)
    return out.reshape(shape)


def log(pose: Pose) -> Tangent:
    """Return the twist ξ, |ω| ≤ π, with exp(ξ) = pose."""
    if np.ndim(pose) == 1:
        return np.array(_kernels.se2_log(*pose.tolist()))
    (pose,), shape = _rows(pose)
    out = np.empty_like(pose)
    _kernels.se2_log_all(pose, out)
    return out.reshape(shape)


def compose(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a · b; shapes broadcast."""
    if np.ndim(a) == 1 and np.ndim(b) == 1:
        return np.array(_kernels.se2_compose(*a.tolist(), *b.tolist()))
    (a, b), shape = _rows(a, b)
    out = np.empty_like(a)
    _kernels.se2_compose_all(a, b, out)
    return out.reshape(shape)


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return a⁻¹ · b, the pose b as seen from a; shapes broadcast."""
    if np.ndim(a) == 1 and np.ndim(b) == 1:
        return np.array(_kernels.se2_between(*a.tolist(), *b.tolist()))
    (a, b), shape = _rows(a, b)
    out = np.empty_like(a)
    _kernels.se2_between_all(a, b, out)
    return out.reshape(shape)


def inverse(pose: Pose) -> Pose:
    """Return pose⁻¹."""
    return between(pose, np.zeros_like(pose))


def retract(pose: np.ndarray, xi: np.ndarray) -> np.ndarray:
    """Return pose · exp(ξ)."""
    return compose(pose, exp(xi))


def difference(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return ξ = log(a⁻¹ · b), so that retract(a, ξ) = b."""
    return log(between(a, b))


def interpolate(
    a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"], fraction: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3"]:
    """Return a · exp(fraction · log(a⁻¹ b)), the geodesic; fraction 0 gives a and 1 gives b."""
    return retract(a, fraction[..., None] * difference(a, b))


def adjoint(pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return Ad with pose · exp(ξ) = exp(Ad ξ) · pose."""
    out = np.empty((3, 3))
    _kernels.se2_adjoint(pose[0], pose[1], pose[2], out)
    return out


def right_jacobian(xi: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return J_r with exp(ξ + δ) = exp(ξ) · exp(J_r δ) to first order in δ."""
    out = np.empty((3, 3))
    _kernels.se2_right_jacobian(xi[0], xi[1], xi[2], out)
    return out


def right_jacobian_inverse(xi: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Return J_r⁻¹: log(exp(ξ) · exp(δ)) = ξ + J_r⁻¹ δ to first order in δ."""
    out = np.empty((3, 3))
    _kernels.se2_right_jacobian_inverse(xi[0], xi[1], xi[2], out)
    return out


def transform(pose: Float[np.ndarray, "3"], points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Return the points (n, 2) [m] carried from the pose's own frame to the frame that the pose is given in."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]


def from_se3(T: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "3"]:
    """Return the planar part [x, y, yaw] of a rigid motion in space."""
    return np.array([T[0, 3], T[1, 3], np.arctan2(T[1, 0], T[0, 0])])


def to_se3(pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return a planar pose as a rigid motion in space, in the plane z = 0."""
    T, (c, s) = np.eye(4), (np.cos(pose[2]), np.sin(pose[2]))
    T[:2, :2], T[:2, 3] = [[c, -s], [s, c]], pose[:2]
    return T
