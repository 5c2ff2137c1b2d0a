"""A mecanum wheel for MuJoCo: passive ellipsoid rollers on hinges at 45° around a hub.

An ellipsoid of these semi-axes rolls on so evenly that the axle's height changes by a third of a millimetre from one
roller to the next; a capsule is bumpy.
"""

import math
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from jaxtyping import Float

ROLLERS = 10
THICKNESS, HALF_LENGTH = 0.016, 0.046  # semi-axes of a roller [m], for a wheel of 0.0759 m
_RADIUS = 0.0759  # of the wheel that they were measured for [m]
_DAMPING = 1e-4  # of a roller's bearing [N m s]; ours: at 1 m/s it brakes the base with a few newtons


def numbers(values: object) -> str:
    """Return numbers as an attribute of MJCF."""
    return " ".join(f"{value:.12g}" for value in np.ravel(np.asarray(values, dtype=float)))


def roller_axis(sign: float) -> Float[np.ndarray, "3"]:
    """Return the axis of the roller that touches the floor, seen from the base; sign as in `MecanumBase.roller_signs`.

    No force acts across it: (v_x - l_y ω - r w) + c (v_y + l_x ω) = 0 with the axis (1, c, 0)/√2 is a row of (3.21)
    where c = -1 for front left and rear right, +1 for the other two.
    """
    return np.array([1.0, -sign, 0.0]) / math.sqrt(2.0)


def add_rollers(hub: Element, name: str, sign: float, radius: float, friction: float, mass: float) -> None:
    """Hang rollers of `mass` [kg] each on a wheel's body, whose y is the axle; together they reach to `radius` [m]."""
    scale = radius / _RADIUS
    thickness, half_length = scale * THICKNESS, scale * HALF_LENGTH
    slim, long = 0.2 * mass * (thickness**2 + half_length**2), 0.4 * mass * thickness**2
    bottom = np.array([0.0, 0.0, thickness - radius])
    for i in range(ROLLERS):
        c, s = math.cos(2 * math.pi * i / ROLLERS), math.sin(2 * math.pi * i / ROLLERS)
        turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        axis = numbers(turn @ roller_axis(sign))
        body = SubElement(hub, "body", name=f"{name}_roller_{i}", pos=numbers(turn @ bottom), zaxis=axis)
        SubElement(body, "joint", name=f"{name}_roller_{i}", axis="0 0 1", damping=numbers(scale**4 * _DAMPING))
        SubElement(body, "inertial", pos="0 0 0", mass=numbers(mass), diaginertia=numbers([slim, slim, long]))
        size = numbers([thickness, thickness, half_length])
        floor = numbers([friction, 0.0, 0.0])
        SubElement(
            body, "geom", {"class": "roller"}, type="ellipsoid", size=size, friction=floor, name=f"{name}_tread_{i}"
        )
