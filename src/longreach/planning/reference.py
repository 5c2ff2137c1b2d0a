"""References to follow: curves in space, orientations along them, and the thesis' dual trajectory.

A curve gives positions (n, 3) [m] at parts u (n,) of it, 0 at its start and 1 at its end; an orientation gives
rotations (n, 3, 3). With `SpeedProfile.sample` for u they become the poses of a `Reference`:

>>> from longreach.planning.profile import SpeedProfile
>>> stamps, u = SpeedProfile(length=2.0, velocity=0.5, acceleration=1.0).sample(200)
>>> line = straight_line(np.array([0.5, 0.0, 1.0]), np.array([2.5, 0.0, 1.0]))
>>> len(Reference(stamps, tool=tool_poses(line, np.eye(3), u)))
200
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from longreach.errors import PlanningError
from longreach.geometry import se2, so3
from longreach.planning.profile import SpeedProfile
from longreach.reference import Reference

Curve = Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, "n 3"]]
Orientation = Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, "n 3 3"]]

_SAMPLES = 4001  # of a curve, to measure its length; errs by 1e-6 of it where it turns once
_UP = np.array([0.0, 0.0, 1.0])


def straight_line(start: Float[np.ndarray, "3"], end: Float[np.ndarray, "3"]) -> Curve:
    """Return the line from start to end [m]."""
    return lambda u: start + u[:, None] * (end - start)


def circle(
    start: Float[np.ndarray, "3"],
    centre: Float[np.ndarray, "3"],
    normal: Float[np.ndarray, "3"] = _UP,
    angle: float = 2.0 * np.pi,
) -> Curve:
    """Return the arc that turns `start` by `angle` [rad] about the axis `normal` through `centre` [m]."""
    axis = _direction(normal, "normal of a circle")
    return lambda u: centre + so3.exp(angle * u[:, None] * axis) @ (start - centre)


def sinusoid(
    start: Float[np.ndarray, "3"],
    end: Float[np.ndarray, "3"],
    amplitude: float,
    periods: float = 1.0,
    side: Float[np.ndarray, "3"] | None = None,
) -> Curve:
    """Return the line from start to end [m] plus amplitude · sin(2π · periods · u) to the side (left, where None)."""
    to_side = np.cross(_UP, end - start) if side is None else side
    to_side = _direction(to_side, "side of a sinusoid")
    line = straight_line(start, end)
    return lambda u: line(u) + amplitude * np.sin(2.0 * np.pi * periods * u)[:, None] * to_side


def waypoint_spline(waypoints: Float[np.ndarray, "k 3"]) -> Curve:
    """Return the cubic spline through the waypoints (k, 3) [m], with a continuous second derivative.

    Its parameter is the length of the chords, so that waypoints may lie near and far.
    """
    from scipy.interpolate import CubicSpline  # here, for it takes long to import

    chords = np.linalg.norm(np.diff(waypoints, axis=0), axis=1)
    if len(waypoints) < 2 or not np.all(chords > 0):
        raise PlanningError("A spline needs at least two waypoints, no two of them in a row the same.")
    knots = np.concatenate(([0.0], np.cumsum(chords)))
    return CubicSpline(knots / knots[-1], waypoints)


def length(curve: Curve) -> float:
    """Return how long a curve is [m]."""
    return float(_distances(curve, np.linspace(0.0, 1.0, _SAMPLES))[-1])


def at_even_speed(curve: Curve) -> Curve:
    """Return the same curve with u in proportion to the distance along it, as a speed profile takes it."""
    from scipy.interpolate import CubicSpline

    u = np.linspace(0.0, 1.0, _SAMPLES)
    s = _distances(curve, u)
    if not np.all(np.diff(s) > 0):
        raise PlanningError("A curve that stands still cannot be followed at an even speed.")
    part = CubicSpline(s / s[-1], u)
    return lambda along: curve(np.clip(part(along), 0.0, 1.0))


def _distances(curve: Curve, u: np.ndarray) -> np.ndarray:
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(curve(u), axis=0), axis=1))))


def _direction(vector: np.ndarray, what: str) -> np.ndarray:
    norm = float(np.linalg.norm(vector))
    if not norm > 1e-9:
        raise PlanningError(f"The {what} has no direction; give it one.")
    return vector / norm


def slerp(R_start: Float[np.ndarray, "3 3"], R_end: Float[np.ndarray, "3 3"]) -> Orientation:
    """Return the orientation that turns at an even rate the short way from R_start to R_end."""
    w = so3.difference(R_start, R_end)
    return lambda u: so3.retract(R_start, u[:, None] * w)


def tool_poses(
    curve: Curve, orientation: Float[np.ndarray, "3 3"] | Orientation, u: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 4 4"]:
    """Return poses (n, 4, 4) along a curve; one rotation (3, 3) means a constant orientation."""
    T = np.zeros((len(u), 4, 4))
    T[:, :3, :3] = orientation if isinstance(orientation, np.ndarray) else orientation(u)
    T[:, :3, 3], T[:, 3, 3] = curve(u), 1.0
    return T


def base_poses(curve: Curve, u: Float[np.ndarray, " n"], heading: float | None = 0.0) -> Float[np.ndarray, "n 3"]:
    """Return [x, y, θ] (n, 3) along a curve seen from above; heading [rad], or None: along the curve, not wrapped."""
    x_y = curve(u)[:, :2]
    if heading is not None:
        return np.column_stack([x_y, np.full(len(u), heading)])
    ahead, behind = np.minimum(u + 1e-6, 1.0), np.maximum(u - 1e-6, 0.0)
    d = (curve(ahead) - curve(behind))[:, :2]
    return np.column_stack([x_y, np.unwrap(np.arctan2(d[:, 1], d[:, 0]))])


def dual_trajectory(
    T_start: Float[np.ndarray, "4 4"],
    base_start: Float[np.ndarray, "3"] | None = None,
    length: float = 2.0,
    amplitude: float = 0.2,
    periods: float = 1.0,
    waypoints: int = 200,
    duration: float = 20.0,
) -> Reference:
    """Return the thesis' dual trajectory (6.2): the tool on a straight line, the base on a sinusoid beside it.

    The tool keeps the orientation of T_start and the base its heading; both go `length` [m] ahead as the base looks, at
    a constant speed, and the base swings to its left by `amplitude` [m] first.
    The thesis gives no duration; 20 s is a tenth of a metre a second.
    """
    start = np.zeros(3) if base_start is None else base_start
    ahead = np.array([np.cos(start[2]), np.sin(start[2]), 0.0]) * length
    profile = SpeedProfile(length=abs(length), velocity=abs(length) / duration, kind="constant")
    stamps, u = profile.sample(waypoints)
    tool = straight_line(T_start[:3, 3], T_start[:3, 3] + ahead)
    local = sinusoid(np.zeros(3), np.array([length, 0.0, 0.0]), amplitude, periods)
    base = se2.compose(start, base_poses(local, u))
    return Reference(stamps, tool=tool_poses(tool, T_start[:3, :3], u), base=base)
