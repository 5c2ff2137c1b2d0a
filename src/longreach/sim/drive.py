"""A fast, erratic drive in a small space: sums of sinusoids in x, y and θ, with everything that moves known exactly."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.robot.description import RobotDescription
from longreach.sim.room import FREE

_REST = 1.0  # [s] standing before and after
_RAMP = 1.0  # [s] from there to full speed
_WAVES = 4  # sinusoids an axis
_SLOWEST, _FASTEST = 0.03, 0.15  # [Hz]; it turns or reverses every few seconds
_USED = 0.95  # part of the robot's limits


@dataclass(frozen=True, eq=False)
class Drive:
    """x, y [m] and θ [rad] as sums of amplitude · (sin(frequency · τ + phase) - sin(phase)), arrays (3, waves).

    τ is time [s] that stands still for a second before and after the drive. All starts at the identity.
    """

    duration: float
    amplitude: Float[np.ndarray, "3 waves"]
    frequency: Float[np.ndarray, "3 waves"]
    phase: Float[np.ndarray, "3 waves"]


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses and their derivatives (n, 3) in the world's axes [m, rad, s], and the twist in the body's."""

    poses: Float[np.ndarray, "n 3"]
    velocity: Float[np.ndarray, "n 3"]
    acceleration: Float[np.ndarray, "n 3"]

    @property
    def twist(self) -> Float[np.ndarray, "n 3"]:
        """Body twist [m/s, m/s, rad/s]."""
        return in_body_axes(self.poses, self.velocity)

    @property
    def body_acceleration(self) -> Float[np.ndarray, "n 3"]:
        """Acceleration of the base's origin, along the body's axes [m/s², m/s², rad/s²]."""
        return in_body_axes(self.poses, self.acceleration)


def in_body_axes(poses: Float[np.ndarray, "n 3"], vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Turn the planar part of the vectors from the world's axes to those of the body."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = vectors[:, 0], vectors[:, 1]
    return np.stack([c * x + s * y, -s * x + c * y, vectors[:, 2]], axis=1)


def make_drive(robot: RobotDescription, duration: float, rng: np.random.Generator) -> Drive:
    """Draw a drive that stays in `room.FREE` about its middle and goes to the robot's limits where there is space."""
    amplitude = rng.uniform(0.5, 1.0, (3, _WAVES))
    frequency = 2 * np.pi * rng.uniform(_SLOWEST, _FASTEST, (3, _WAVES))
    drive = Drive(duration, amplitude, frequency, rng.uniform(0.0, 2 * np.pi, (3, _WAVES)))
    motion = move(drive, np.arange(0.0, duration, 0.01))
    scales = []
    for values, limits in ((motion.velocity, robot.velocity_limits), (motion.acceleration, robot.acceleration_limits)):
        speed = np.hypot(values[:, 0], values[:, 1]).max()
        planar = min(limits[:2]) / max(speed, 1e-9)
        scales.append([planar, planar, limits[2] / max(np.abs(values[:, 2]).max(), 1e-9)])
    space = 2 * np.array(FREE) / np.maximum(np.ptp(motion.poses[:, :2], axis=0), 1e-9)
    scales.append([*space, np.inf])
    scale = _USED * np.min(scales, axis=0)
    return Drive(duration, amplitude * scale[:, None], frequency, drive.phase)


def middle(drive: Drive) -> tuple[float, float]:
    """Return the middle [m] of the rectangle that the drive takes."""
    poses = move(drive, np.arange(0.0, drive.duration, 0.01)).poses
    x, y = 0.5 * (poses[:, :2].min(axis=0) + poses[:, :2].max(axis=0))
    return float(x), float(y)


def move(drive: Drive, t: Float[np.ndarray, " n"]) -> Motion:
    """Return where the base is at the times t [s], and how it moves."""
    tau, rate, rate_change = _warp(t, drive.duration)
    angle = drive.frequency[:, :, None] * tau + drive.phase[:, :, None]
    a, w = drive.amplitude[:, :, None], drive.frequency[:, :, None]
    poses = np.sum(a * (np.sin(angle) - np.sin(drive.phase)[:, :, None]), axis=1)
    first, second = np.sum(a * w * np.cos(angle), axis=1), -np.sum(a * w**2 * np.sin(angle), axis=1)
    return Motion(poses.T, (first * rate).T, (second * rate**2 + first * rate_change).T)


def _warp(t: np.ndarray, duration: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the drive's own time τ and its first two derivatives: τ' goes from 0 to 1 and back without a jerk."""
    ramp = min(_RAMP, duration / 6)
    rest = min(_REST, duration / 6)
    up = np.clip((t - rest) / ramp, 0.0, 1.0)
    down = np.clip((duration - rest - t) / ramp, 0.0, 1.0)
    even = np.clip(t - rest - ramp, 0.0, duration - 2 * (rest + ramp))
    tau = even + ramp * (0.5 + _area(up) - _area(down))
    return tau, _smooth(up) * _smooth(down), 30 * ((up * (1 - up)) ** 2 - (down * (1 - down)) ** 2) / ramp


def _smooth(u: np.ndarray) -> np.ndarray:
    """From 0 to 1 with two derivatives of zero at both ends."""
    return u**3 * (10 - 15 * u + 6 * u**2)


def _area(u: np.ndarray) -> np.ndarray:
    """Integral of `_smooth`."""
    return u**4 * (2.5 - 3 * u + u**2)
