"""Roll, pitch and yaw of many rotations at once: R = Rz(yaw) Ry(pitch) Rx(roll), angles ρ (n, 3) [rad]."""

import numpy as np
from jaxtyping import Float

_STEEP = 1e-3  # |cos(pitch)| is taken to be no less than this


def from_angles(rho: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Return the rotations."""
    (sr, sp, sy), (cr, cp, cy) = np.sin(rho).T, np.cos(rho).T
    rows = (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr)
    rows += (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr)
    return np.stack((*rows, -sp, cp * sr, cp * cr), axis=-1).reshape(-1, 3, 3)


def to_angles(R: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the angles, pitch within ±π/2."""
    pitch = np.arctan2(-R[:, 2, 0], np.hypot(R[:, 0, 0], R[:, 1, 0]))
    return np.stack((np.arctan2(R[:, 2, 1], R[:, 2, 2]), pitch, np.arctan2(R[:, 1, 0], R[:, 0, 0])), axis=-1)


def body_rates(rho: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Return W: ω = W dρ/dt, ω in the body's frame."""
    (sr, sp, _), (cr, cp, _) = np.sin(rho).T, np.cos(rho).T
    o, i = np.zeros_like(sr), np.ones_like(sr)
    return np.stack((i, o, -sp, o, cr, sr * cp, o, -sr, cr * cp), axis=-1).reshape(-1, 3, 3)


def angle_rates(rho: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Return E = W⁻¹: dρ/dt = E ω; bounded where the pitch is ±90°."""
    (sr, sp, _), (cr, cp, _) = np.sin(rho).T, np.cos(rho).T
    cp = np.copysign(np.maximum(np.abs(cp), _STEEP), cp)
    o, i = np.zeros_like(sr), np.ones_like(sr)
    return np.stack((i, sr * sp / cp, cr * sp / cp, o, cr, -sr, o, sr / cp, cr / cp), axis=-1).reshape(-1, 3, 3)


def turned(C: Float[np.ndarray, "n 6 6"], A: np.ndarray, B: np.ndarray) -> Float[np.ndarray, "n 6 6"]:
    """Return covariances whose first three values are multiplied by A, and the others by B: (n, 3, 3) or (3, 3)."""
    J = np.zeros_like(C)
    J[:, :3, :3], J[:, 3:, 3:] = A, B
    return J @ C @ np.swapaxes(J, 1, 2)
