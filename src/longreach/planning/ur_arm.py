"""Find out from a chain's numbers alone whether its last six joints are an arm like the UR, solvable in closed form."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.geometry import se3

_ANGLE = 0.03  # [rad] by which axes may miss right angles and parallels; calibrations find some 1e-3
_LENGTH = 0.01  # [m] by which axes that should meet may pass each other; likewise
_LEAST = 1e-3  # [m], a link shorter than that is none


@dataclass(frozen=True, eq=False)
class UrArm:
    """The arm of `_ur_kernels` that is nearest to a chain's last six joints.

    ends (2, 4, 4): `before` and the inverse of `after`; shape (3, 6): signs, offsets [rad], and a2, a3, d4, d5 [m].
    """

    ends: Float[np.ndarray, "2 4 4"]
    shape: Float[np.ndarray, "3 6"]


def ur_arm(fixed: Float[np.ndarray, "m 4 4"], prismatic: np.ndarray) -> UrArm | None:
    """Return the closed form of the last six joints of a chain F[0] · J_0 ⋯ F[k], or None where they are not like that.

    Small deviations, such as a calibration finds, are left out: the closed form is then a start for a search.
    """
    first = len(fixed) - 7
    if first < 0 or np.any(prismatic[first : first + 6]):
        return None
    joints = _at_zero(fixed[first + 1 :])  # in the frame of the first of the six
    z, p = joints[:6, :3, 2], joints[:6, :3, 3]
    if not _like_a_ur(z):
        return None
    n = _across(z[1], z[0])
    axis5 = _across(z[4], n)
    axis6 = _across(z[5], axis5)
    shoulder, miss_shoulder = _meeting(p[0], z[0], p[1], z[1])
    wrist, miss_wrist = _meeting(p[3], z[3], p[4], z[4])
    hand, miss_hand = _meeting(p[4], z[4], p[5], z[5])
    if max(miss_shoulder, miss_wrist, miss_hand) > _LENGTH:
        return None
    upper, fore = _beside(p[2] - shoulder, n), _beside(wrist - p[2], n)
    if min(np.linalg.norm(upper), np.linalg.norm(fore)) < _LEAST:
        return None
    signs = np.sign([1.0, 1.0, z[2] @ n, z[3] @ n, 1.0, 1.0])
    return _with_offsets(joints[6], (z[0], n, axis5, axis6), (shoulder, upper, fore, wrist, hand), signs)


def _at_zero(fixed: np.ndarray) -> np.ndarray:
    """Return the frames (m + 1, 4, 4) between the transforms at q = 0."""
    frames = [np.eye(4)]
    for F in fixed:
        frames.append(frames[-1] @ F)
    return np.array(frames)


def _like_a_ur(z: np.ndarray) -> bool:
    parallel = np.linalg.norm(np.cross(z[1], z[2])), np.linalg.norm(np.cross(z[1], z[3]))
    right = z[0] @ z[1], z[3] @ z[4], z[4] @ z[5]
    return bool(np.max(np.abs([*parallel, *right])) < _ANGLE)


def _beside(v: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the part of v at a right angle to an axis."""
    return v - (v @ axis) * axis


def _across(v: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return the direction at a right angle to an axis that is nearest to v."""
    side = _beside(v, axis)
    return side / np.linalg.norm(side)


def _meeting(p: np.ndarray, z: np.ndarray, other: np.ndarray, z_other: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the point half way between two lines where they are nearest, and their distance there [m]."""
    across = np.cross(z, z_other)
    s, _, d = np.linalg.solve(np.column_stack([z, -z_other, across]), other - p)
    return p + s * z + 0.5 * d * across, float(np.linalg.norm(d * across))


def _with_offsets(
    T: np.ndarray, axes: tuple[np.ndarray, ...], points: tuple[np.ndarray, ...], signs: np.ndarray
) -> UrArm:
    """Return the arm from its axes 1, 2, 5, 6 and the shoulder, two links, wrist and hand at q = 0; T its end."""
    z0, n, axis5, axis6 = axes
    shoulder, upper, fore, wrist, hand = points
    x0 = np.cross(z0, n)
    before = se3.from_rotation_translation(np.column_stack([x0, -n, z0]), shoulder)
    x4 = np.cross(n, axis5)
    x5 = np.cross(axis6, axis5)
    after = se3.inverse(se3.from_rotation_translation(np.column_stack([x5, -axis5, axis6]), hand)) @ T
    turns = [np.arctan2(v @ z0, v @ x0) for v in (upper, fore, x4)]
    q5 = np.arctan2(x5 @ n, x5 @ x4)
    shape = np.zeros((3, 6))
    shape[0] = signs
    shape[1] = [0.0, turns[0], turns[1] - turns[0], turns[2] - turns[1], q5, 0.0]
    d4, d5 = (wrist - shoulder) @ n, (hand - wrist) @ axis5
    shape[2, :4] = [np.linalg.norm(upper), np.linalg.norm(fore), d4, d5]
    return UrArm(np.array([before, se3.inverse(after)]), shape)
