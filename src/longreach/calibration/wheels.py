"""What wheels say of a motion, as a function of what is calibrated: radii, the arm at which they turn, or scales.

The twist of a base is linear in its wheels' turns u (w,) [rad], ξ = F(p) u, with parameters p of the base:

    differential  radius_left, radius_right, track_width
    mecanum       a radius a wheel, k = l_x + l_y; from (3.21) with a radius each
    odometry      scales of x, y and heading, where the robot's own driver has made poses of its wheels

Four mecanum wheels that roll keep r₀u₀ - r₁u₁ - r₂u₂ + r₃u₃ = 0 (front left, rear left, rear right, front right), so
the ratios of their radii come from the encoders alone, as far as the rollers do not slip. They do, and not by chance:
a motion forwards, sideways or in a turn adds a share of itself to every row of F, and to that equation. These shares
are estimated too, and not reported: they keep slip from looking like radii that differ.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from longreach.errors import CalibrationError
from longreach.geometry import se2
from longreach.robot.bases import DifferentialBase, MecanumBase
from longreach.robot.description import RobotDescription

# Slip of rollers, of a motion forwards, sideways and turning [1]: simulated physics, good floor.
_SLIP = (0.003, 0.02, 0.011)
_SMALL = 1e-4  # [rad]: below, series to second order are exact to rounding


class Motions(NamedTuple):
    """Motions between keyframes, in their order.

    turns (m, w): of the wheels in each step [rad]; of driver-made odometry its steps ξ (m, 3) [m, m, rad].
    spans (n, 2): of each motion its first step, and the one after its last.
    displacement (n, 3): pose of the sensor at the end seen from the sensor at the start [m, m, rad].
    covariance (n, 3, 3): of log(displacement⁻¹ · truth), known up to a factor; None: the same for all.
    """

    turns: Float[np.ndarray, "m w"]
    spans: np.ndarray
    displacement: Float[np.ndarray, "n 3"]
    covariance: Float[np.ndarray, "n 3 3"] | None = None


class WheelModel(NamedTuple):
    """Parameters of the wheels: names, units, nominal values (p,), and F.

    matrix: p → F (3, w) and its derivatives (p, 3, w). signs (c, w): Σ signs · r · u = 0 of each while wheels roll.
    slip (s, 3 + c, w): what systematic slip of 1 adds to F and to signs · r. slip_deviation (s,): of it, about 0.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    nominal: Float[np.ndarray, " p"]
    matrix: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    signs: Float[np.ndarray, "c w"]
    slip: Float[np.ndarray, "s d w"]
    slip_deviation: Float[np.ndarray, " s"]


def wheel_model(robot: RobotDescription) -> WheelModel:
    """Return the parameters of a robot's wheels; raise CalibrationError where its kind of base has none here."""
    base = robot.base
    if base is None:
        return _scales(robot)
    if isinstance(base, DifferentialBase):
        return _differential(base)
    if isinstance(base, MecanumBase):
        return _mecanum(base)
    raise CalibrationError(
        f"The wheels of {robot.name} are those of a base of the kind {base.kind}; calibrated are differential and "
        "mecanum bases, and odometry that a driver has made."
    )


def _differential(base: DifferentialBase) -> WheelModel:
    left = np.array([side == "left" for side in base.wheel_sides])
    share = np.where(left, 1.0 / left.sum(), 1.0 / (~left).sum())
    side = np.where(left, -1.0, 1.0)

    def matrix(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        b = p[2]
        unit = np.array([0.5 * share, np.zeros(len(share)), side * share / b])
        F = unit * np.where(left, p[0], p[1])
        by_track = np.zeros_like(F)
        by_track[2] = -F[2] / b
        return F, np.array([unit * left, unit * ~left, by_track])

    radii = base.radii
    nominal = np.array([radii[left].mean(), radii[~left].mean(), base.track_width])
    names = ("radius_left", "radius_right", "track_width")
    return WheelModel(names, ("m", "m", "m"), nominal, matrix, *_no_slip(len(share)))


def _mecanum(base: MecanumBase) -> WheelModel:
    rollers = np.array(base.roller_signs)
    side = np.array([-1.0 if "left" in corner else 1.0 for corner in base.wheel_corners])

    def matrix(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r, k = p[:4], p[4]
        unit = 0.25 * np.array([np.ones(4), -rollers, side / k])  # (3.21)
        F = unit * r
        by_arm = np.zeros_like(F)
        by_arm[2] = -F[2] / k
        return F, np.array([*(unit * np.eye(4)[i] for i in range(4)), by_arm])

    nominal = np.array([*base.radii, base.lever])
    names = (*(f"radius_{corner}" for corner in base.wheel_corners), "k")
    signs = np.array([[1.0 if "front" in corner else -1.0 for corner in base.wheel_corners]])
    unit = np.array([[1.0], [1.0], [base.lever], [4.0]])  # all four rows as ways of a wheel [m]
    ways = unit[:3] * matrix(nominal)[0]
    own = [(0, 0), (2, 2)]  # slip of a radius along its own way, and of k: part of these
    pairs = [(row, column) for column in range(3) for row in range(4) if (row, column) not in own]
    slip = np.zeros((len(pairs), 4, 4))
    for part, (row, column) in zip(slip, pairs, strict=True):
        part[row] = ways[column] * (unit[row] if row == 3 else 1.0 / unit[row])
    deviation = np.array([_SLIP[column] for _, column in pairs])
    return WheelModel(names, ("m",) * 5, nominal, matrix, signs, slip, deviation)


def _scales(robot: RobotDescription) -> WheelModel:
    parts = np.array([np.diag(row) for row in np.eye(3)])
    names = ("scale_x", "scale_y", "scale_heading")
    return WheelModel(names, ("1",) * 3, np.array(robot.odometry_scale), lambda p: (np.diag(p), parts), *_no_slip(3))


def _no_slip(w: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.zeros((0, w)), np.zeros((0, 3, w)), np.zeros(0)


def base_motion(
    model: WheelModel, p: Float[np.ndarray, " p"], motions: Motions
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3 p"]]:
    """Return each motion of the base (n, 3), and its derivative with respect to p (n, 3, p) in the body frame.

    p may end in the model's slip (s,). Steps are composed; with poses P along all of them, a motion P_a⁻¹ P_b changes
    by Ad(P_b⁻¹) Σ Ad(P_j) J_r(ξ_j) dξ_j.
    """
    n = len(model.nominal)
    F, dF = model.matrix(p[:n])
    if len(p) > n:
        F, dF = F + np.tensordot(p[n:], model.slip[:, :3], 1), np.concatenate((dF, model.slip[:, :3]))
    xi = motions.turns @ F.T
    P = _path(xi)
    ends = P[motions.spans]
    dxi = np.einsum("pij,mj->mip", dF, motions.turns)
    moved = adjoints(P[1:]) @ (_right_jacobians(xi) @ dxi)
    total = np.concatenate((np.zeros((1, 3, len(p))), np.cumsum(moved, axis=0)))
    change = total[motions.spans[:, 1]] - total[motions.spans[:, 0]]
    return se2.between(ends[:, 0], ends[:, 1]), adjoints(se2.inverse(ends[:, 1])) @ change


def _path(xi: np.ndarray) -> np.ndarray:
    """Compose steps: poses (m + 1, 3) from the identity on."""
    steps = se2.exp(xi)
    P = np.zeros((len(xi) + 1, 3))
    P[1:, 2] = np.cumsum(steps[:, 2])
    c, s = np.cos(P[:-1, 2]), np.sin(P[:-1, 2])
    P[1:, 0] = np.cumsum(c * steps[:, 0] - s * steps[:, 1])
    P[1:, 1] = np.cumsum(s * steps[:, 0] + c * steps[:, 1])
    return P


def adjoints(poses: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Return Ad of each pose, as `se2.adjoint`."""
    A = np.zeros((len(poses), 3, 3))
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    A[:, 0, 0], A[:, 0, 1], A[:, 1, 0], A[:, 1, 1] = c, -s, s, c
    A[:, 0, 2], A[:, 1, 2], A[:, 2, 2] = poses[:, 1], -poses[:, 0], 1.0
    return A


def _right_jacobians(xi: np.ndarray) -> np.ndarray:
    """Return J_r of each ξ, as `se2.right_jacobian`."""
    x, y, t = xi.T
    small = np.abs(t) < _SMALL
    d = np.where(small, 1.0, t)
    sine, cosine = np.where(small, 1.0, np.sin(d) / d), np.where(small, 0.5 * t, (1.0 - np.cos(d)) / d)
    third = np.where(small, t / 6.0, (d - np.sin(d)) / d**2)
    half = np.where(small, 0.5, (1.0 - np.cos(d)) / d**2)
    J = np.zeros((len(xi), 3, 3))
    J[:, 0, 0], J[:, 0, 1], J[:, 1, 0], J[:, 1, 1] = sine, cosine, -cosine, sine
    J[:, 0, 2], J[:, 1, 2], J[:, 2, 2] = x * third - y * half, x * half + y * third, 1.0
    return J
