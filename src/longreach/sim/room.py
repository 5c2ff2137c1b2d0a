"""A room to drive in: straight walls seen from above, and the distance to them."""

import numpy as np
from jaxtyping import Float

from longreach.sim import _kernels

# Half of the rectangle [m] about the origin in which the centre of a base may be; all walls of `polygonal_room` are at
# least 0.8 m away from it, more than half the diagonal of a base of 0.96 x 0.79 m.
FREE = (2.4, 1.8)

_WALLS = [(-6.1, -4.3), (1.2, -4.3), (1.2, -5.4), (3.0, -5.4), (3.0, -4.3), (6.4, -4.3), (6.4, 2.2), (4.9, 4.6)]
_WALLS += [(-0.8, 4.6), (-0.8, 3.9), (-2.6, 3.9), (-2.6, 4.6), (-6.1, 4.6), (-6.1, 0.9), (-7.3, 0.9), (-7.3, -0.7)]
_WALLS += [(-6.1, -0.7)]


def polygon(corners: list[tuple[float, float]]) -> Float[np.ndarray, "m 4"]:
    """Return the sides (x0, y0, x1, y1) [m] of a closed polygon."""
    points = np.array(corners, dtype=float)
    return np.hstack([points, np.roll(points, -1, axis=0)])


def box(x: float, y: float, length: float, width: float, yaw: float) -> Float[np.ndarray, "4 4"]:
    """Return the sides of a box with its centre at (x, y)."""
    c, s, a, b = np.cos(yaw), np.sin(yaw), 0.5 * length, 0.5 * width
    return polygon([(x + c * u - s * v, y + s * u + c * v) for u, v in ((a, b), (-a, b), (-a, -b), (a, -b))])


def column(x: float, y: float, radius: float) -> Float[np.ndarray, "8 4"]:
    """Return the sides of an eight-sided column."""
    turns = 2 * np.pi * np.arange(8) / 8
    return polygon([(x + radius * np.cos(t), y + radius * np.sin(t)) for t in turns])


def polygonal_room() -> Float[np.ndarray, "m 4"]:
    """Return the walls (x0, y0, x1, y1) [m] of a hall with niches, a slanted corner and things that stand about."""
    things = [
        box(4.3, -2.4, 1.2, 0.7, 0.3),
        box(-4.6, -2.9, 0.8, 1.4, -0.2),
        box(-4.4, 2.7, 1.6, 0.5, 0.6),
        box(0.4, -3.4, 0.6, 0.6, 0.8),
        column(4.2, 1.9, 0.25),
        column(1.7, 3.3, 0.3),
        column(-3.7, 0.2, 0.2),
    ]
    return np.vstack([polygon(_WALLS), *things])


def moved(segments: Float[np.ndarray, "m 4"], x: float, y: float) -> Float[np.ndarray, "m 4"]:
    """Return the segments moved by (x, y)."""
    return segments + np.array([x, y, x, y])


def cast(
    segments: Float[np.ndarray, "m 4"], poses: Float[np.ndarray, "n 3"], angles: Float[np.ndarray, " b"]
) -> Float[np.ndarray, "n b"]:
    """Return how far (n, b) [m] one sees from each pose at each angle from its heading; inf where nothing stands."""
    out = np.empty((len(poses), len(angles)))
    _kernels.cast_all(np.ascontiguousarray(poses), np.ascontiguousarray(angles), segments, out)
    return out
