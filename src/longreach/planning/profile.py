"""How fast a path is followed: the distance along it as a function of time."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from longreach.errors import PlanningError

# Of s(τ) = 10τ³ - 15τ⁴ + 6τ⁵, the path of least jerk from rest to rest (Flash & Hogan 1985), τ = t/T in [0, 1].
_PEAK_SPEED = 15.0 / 8.0  # of ds/dτ
_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)  # of d²s/dτ²


@dataclass(frozen=True)
class SpeedProfile:
    """A motion along a path of a given length as fast as the limits allow.

    kind: trapezoidal, from rest to rest with the acceleration at its limit or zero; smooth, from rest to rest with the
    least jerk; constant, at the velocity all the way. length [m], velocity [m/s], acceleration [m/s²].

    >>> SpeedProfile(length=2.0, velocity=0.5, acceleration=1.0).duration
    4.5
    """

    length: float
    velocity: float
    acceleration: float = math.inf
    kind: Literal["trapezoidal", "smooth", "constant"] = "trapezoidal"

    def __post_init__(self) -> None:
        if not (0.0 < self.length < math.inf and 0.0 < self.velocity < math.inf and self.acceleration > 0.0):
            raise PlanningError("The length, velocity and acceleration of a speed profile must be positive numbers.")

    @property
    def _ramp(self) -> float:
        """How long it speeds up [s], the velocity limit reached or not."""
        return min(self.velocity / self.acceleration, math.sqrt(self.length / self.acceleration))

    @property
    def duration(self) -> float:
        """How long the path takes [s]."""
        if self.kind == "constant" or (math.isinf(self.acceleration) and self.kind == "trapezoidal"):
            return self.length / self.velocity
        if self.kind == "smooth":
            slowest = math.sqrt(_PEAK_ACCELERATION * self.length / self.acceleration)
            return max(_PEAK_SPEED * self.length / self.velocity, slowest)
        return self.length / (self._ramp * self.acceleration) + self._ramp

    def at(
        self, t: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return distance [m], speed [m/s] and acceleration [m/s²] at the times t (n,) [s]; at rest outside."""
        T = self.duration
        inside = (t >= 0.0) & (t <= T)
        t = np.clip(t, 0.0, T)
        if self.kind == "smooth":
            s, v, a = _least_jerk(t / T)
            s, v, a = self.length * s, self.length / T * v, self.length / T**2 * a
        elif self.kind == "constant" or math.isinf(self.acceleration):
            s, v, a = self.velocity * t, np.full_like(t, self.velocity), np.zeros_like(t)
        else:
            s, v, a = self._trapezoid(t, T)
        return s, np.where(inside, v, 0.0), np.where(inside, a, 0.0)

    def _trapezoid(self, t: np.ndarray, T: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        ramp, limit = self._ramp, self.acceleration
        left = np.minimum(t, T - t)  # the second half mirrors the first
        speed = limit * np.minimum(left, ramp)
        done = 0.5 * speed * np.minimum(left, ramp) + speed * np.maximum(left - ramp, 0.0)
        a = np.where(left < ramp, np.where(t < 0.5 * T, limit, -limit), 0.0)
        return np.where(t < 0.5 * T, done, self.length - done), speed, a

    def sample(self, waypoints: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return stamps (n,) [s], even ones from 0 on, and which part (n,) of the path is behind at each, 0 to 1."""
        if waypoints < 2:
            raise PlanningError(f"A path needs at least 2 waypoints, not {waypoints}.")
        stamps = np.linspace(0.0, self.duration, waypoints)
        part = self.at(stamps)[0] / self.length
        part[-1] = 1.0
        return stamps, part


def _least_jerk(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    s = x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return s, 30.0 * x**2 * (1.0 - x) ** 2, 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x)
