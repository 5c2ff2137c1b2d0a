"""What the 15-state filter is to compare: readings of one sensor as rows z - H x over one block of the state.

Ours: each masked value is compared in the frame in which the sensor gives it, so that H carries mounting and lever arm.
As robot_localization does it, everything is turned into the base's frame first, and a value of the base is compared
when any masked value of the sensor has a part in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from longreach.estimation.spatial.angles import angle_rates, body_rates, from_angles, to_angles, turned
from longreach.geometry import se3
from longreach.spatial_measurement import AccelerationReading, PoseReading, Reading, SpatialRecording, TwistReading
from longreach.spatial_settings import Mask, SensorSettings, SpatialSettings

_LEAST_VARIANCE = 1e-9  # in place of zero, which messages leave where they know none; as robot_localization
_SEEN = 1e-6  # a smaller part of a masked value in a value of the base is rounding; as robot_localization
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).reshape(3, 9)  # l @ it: the rows l × x, l × y, l × z
_UPRIGHT = np.array([2, 3, 4])  # z, roll, pitch of a block of six, or vz, vroll, vpitch: none in two_d_mode


@dataclass(frozen=True, eq=False)
class Rows:
    """The measurements of one kind of one sensor, m of them, with k rows each.

    block: 0 the pose, 6 the twist, 12 the acceleration. z: what was measured as values of that block (m, 6), of an
    acceleration as the rows' own. H (m, 6, 6) and R (m, 6, 6): k rows of them count; a row of zeros was not measured.
    gate: of the NIS. lever [m]: of the sensor in the base (m, 3). gravity [m/s²]: in what was measured.
    """

    source: str
    block: int
    k: int
    stamps: Float[np.ndarray, " m"]
    z: Float[np.ndarray, "m 6"]
    H: Float[np.ndarray, "m 6 6"]
    R: Float[np.ndarray, "m 6 6"]
    gate: float
    lever: Float[np.ndarray, "m 3"]
    gravity: float
    incomplete: int  # measurements with a value or variance that is no number


class _Measured(NamedTuple):
    """What `Rows` are made of: six rows each, of which the masked ones count, with C their covariance.

    known: which rows of which measurement have a value.
    """

    block: int
    stamps: np.ndarray
    z: np.ndarray
    known: np.ndarray
    mask: Sequence[bool] | np.ndarray
    H: np.ndarray
    C: np.ndarray
    lever: np.ndarray | float = 0.0
    gravity: float = 0.0


def rows_of(readings: Sequence[Reading], recording: SpatialRecording, settings: SpatialSettings) -> list[Rows]:
    """Return the measurements by sensor and part; at one stamp the sensors go in the order of the settings."""
    found = []
    for sensor in settings.sensors:
        own = [reading for reading in readings if reading.source == sensor.name]
        for name, (kind, measured) in _PARTS.items():
            part: Any = [reading for reading in own if isinstance(reading, kind)]
            if part:
                found.append(_masked(measured(sensor, part, recording, settings), sensor, name, settings))
    return [rows for rows in found if rows.k and len(rows.stamps)]


def table_of(rows: Sequence[Rows]) -> tuple[tuple[np.ndarray, ...], Int[np.ndarray, " n"]]:
    """Return all measurements in the order of their stamps as the kernels take them, and whose each is."""
    stamps = np.concatenate([r.stamps for r in rows])
    order = np.argsort(stamps, kind="stable")
    whose = np.repeat(np.arange(len(rows)), [len(r.stamps) for r in rows])[order]
    constant = [np.array([getattr(r, name) for r in rows])[whose] for name in ("block", "k", "gate", "gravity")]
    varying = [np.concatenate([getattr(r, name) for r in rows])[order] for name in ("z", "H", "R", "lever")]
    return (stamps[order], *constant, *varying), whose


def _pose(sensor: SensorSettings, given: list[PoseReading], world: SpatialRecording, s: SpatialSettings) -> _Measured:
    """Return poses as they are, relative to the first, or as twists from one to the next; of an IMU the orientation."""
    mask, is_imu, as_is = sensor.mask[:6], sensor.kind == "imu", s.as_robot_localization
    stamps, C = np.array([r.stamp for r in given]), _covariances(given, mask)
    sensed, known = _whole(np.array([r.pose for r in given]))
    mount = np.array([world.mounts[r.frame if is_imu else r.child] for r in given])
    origin = np.array([np.eye(4) if is_imu else world.origins[r.frame] for r in given])
    if is_imu:
        mount[:, :3, 3] = 0.0
    turn = mount[:, :3, :3] if is_imu else np.broadcast_to(np.eye(3), (len(stamps), 3, 3))  # R_base_sensor
    # Q: by which robot_localization turns masks and covariances, of an IMU by the yaw of its mounting.
    Q = from_angles(to_angles(turn) * np.array([0.0, 0.0, 1.0])) if is_imu else origin[:, :3, :3]
    T = sensed @ se3.inverse(mount)  # of the base in the frame of the message
    if is_imu and as_is:  # robot_localization takes a mounting off angle by angle, then turns by its yaw
        T[:, :3, :3] = from_angles(_each(Q, to_angles(sensed[:, :3, :3]) - to_angles(turn)))
    if sensor.differential:
        return _differences(stamps, T, C, known, Q if as_is else turn, mask, as_is)
    if sensor.relative:
        if not as_is and not is_imu:
            C = turned(C, T[0, :3, :3].T, T[0, :3, :3].T)
        T = se3.inverse(T[0]) @ T
    T = origin @ T
    z = np.concatenate([T[:, :3, 3], to_angles(T[:, :3, :3])], axis=1)
    if as_is:
        return _Measured(0, stamps, z, known, *_in_base(mask, Q, C))
    H = np.zeros_like(C)
    H[:, :3, :3], H[:, 3:, 3:] = np.swapaxes(origin[:, :3, :3], 1, 2), np.eye(3)
    if not sensor.relative:
        seen = to_angles(sensed[:, :3, :3]) if is_imu else to_angles(H[:, :3, :3] @ T[:, :3, :3])
        if all(mask[3:]):  # three angles are an orientation, which has no poles
            C = turned(C, np.eye(3), angle_rates(z[:, 3:]) @ turn @ body_rates(seen))
        else:
            H[:, 3:, 3:] = angle_rates(seen) @ np.swapaxes(turn, 1, 2) @ body_rates(z[:, 3:])
    return _Measured(0, stamps, z, known, mask, H, C)


def _differences(
    stamps: np.ndarray, T: np.ndarray, C: np.ndarray, known: np.ndarray, Q: np.ndarray, mask: Mask, as_is: bool
) -> _Measured:
    """Return the mean twist from each pose to the next, by log(T₁⁻¹ T₂)/dt; its covariance is (C₁ + C₂)/dt².

    As robot_localization does it, angles are divided by dt, and the covariance is (C₁ + C₂) dt. Q turns masks and
    covariances into the base's frame there, and is R_base_sensor here.
    """
    later = np.flatnonzero(np.diff(stamps) > 0) + 1
    dt = np.diff(stamps)[later - 1, None]
    D = se3.inverse(T[later - 1]) @ T[later]
    stamps, known = stamps[later], known[later - 1] & known[later]
    if as_is:
        z = np.concatenate([D[:, :3, 3], to_angles(D[:, :3, :3])], axis=1) / dt
        rows, H, C = _in_base(mask, Q[later], C[later] + C[later - 1])
        return _Measured(6, stamps, z, known, rows, H, C * dt[:, :, None])
    own = np.swapaxes(T[:, :3, :3] @ Q, 1, 2)
    C = turned(C, own, own)  # about the axes of the sensor itself
    H = np.zeros((len(later), 6, 6))
    H[:, :3, :3], H[:, 3:, 3:] = np.eye(3), np.swapaxes(Q[later], 1, 2)
    return _Measured(6, stamps, se3.log(D) / dt, known, mask, H, (C[later] + C[later - 1]) / dt[:, :, None] ** 2)


def _twist(sensor: SensorSettings, given: list[TwistReading], world: SpatialRecording, s: SpatialSettings) -> _Measured:
    """Return twists of the sensor; its linear velocity is that of the point where it sits."""
    mask = sensor.mask[6:12]
    stamps, C = np.array([r.stamp for r in given]), _covariances(given, mask)
    mount, raw = np.array([world.mounts[r.frame] for r in given]), np.array([r.twist for r in given])
    known, turn, lever = np.isfinite(raw), mount[:, :3, :3], mount[:, :3, 3]
    twist = np.where(known, raw, 0.0)
    if s.as_robot_localization:
        z = np.concatenate([_each(turn, twist[:, :3]), _each(turn, twist[:, 3:])], axis=1)
        halves = (known | ~np.array(mask)).reshape(-1, 2, 3).all(axis=2)  # of which all masked values are known
        return _Measured(6, stamps, z, np.repeat(halves, 3, axis=1), *_in_base(mask, turn, C), lever)
    H = np.zeros_like(C)
    H[:, :3, :3] = H[:, 3:, 3:] = np.swapaxes(turn, 1, 2)
    H[:, :3, 3:] = H[:, :3, :3] @ (lever @ _CROSS).reshape(-1, 3, 3)  # ω × l
    z = np.linalg.solve(H, twist[:, :, None])[:, :, 0]
    return _Measured(6, stamps, z, known, mask, H, C, lever)


def _acceleration(
    sensor: SensorSettings, given: list[AccelerationReading], world: SpatialRecording, s: SpatialSettings
) -> _Measured:
    """Return accelerations; gravity is removed by the message's own orientation, else by the filter's."""
    mask = (*sensor.mask[12:], False, False, False)
    stamps, attitude = np.array([r.stamp for r in given]), [r.attitude for r in given]
    C, z, H = np.zeros((len(stamps), 6, 6)), np.zeros((len(stamps), 6)), np.zeros((len(stamps), 6, 6))
    C[:, :3, :3], z[:, :3] = _covariances(given, mask[:3]), [r.acceleration for r in given]
    mount = np.array([world.mounts[r.frame] for r in given])
    turn, lever = mount[:, :3, :3], mount[:, :3, 3]
    by_filter = sensor.remove_gravity and any(R is None for R in attitude)
    if sensor.remove_gravity and not by_filter:
        z[:, :3] -= s.gravity * np.array([R[2] for R in attitude if R is not None])  # R_world_sensorᵀ (0, 0, g)
    if s.as_robot_localization:
        z[:, :3] = _each(turn, z[:, :3])
        mask, H, C = _in_base(mask, turn, C)
    else:
        H[:, :3, :3] = np.swapaxes(turn, 1, 2)
    return _Measured(12, stamps, z, np.isfinite(z), mask, H, C, lever, s.gravity if by_filter else 0.0)


_PARTS = {
    "pose": (PoseReading, _pose),
    "twist": (TwistReading, _twist),
    "acceleration": (AccelerationReading, _acceleration),
}


def _masked(c: _Measured, sensor: SensorSettings, part: str, s: SpatialSettings) -> Rows:
    """Keep the masked rows; those whose value or variance is no number count as not measured."""
    rows, m = np.flatnonzero(c.mask), len(c.stamps)
    k = len(rows)
    kept, R, own = c.H[:, rows], c.C[:, rows][:, :, rows], np.arange(k)
    variance = np.abs(R[:, own, own]) if s.as_robot_localization else R[:, own, own]
    bounded = np.isfinite(variance)
    whole = np.isfinite(R) | ~bounded[:, :, None] | ~bounded[:, None, :]
    good = c.known[:, rows] & bounded & (variance >= 0.0) & np.all(whole, axis=(1, 2))[:, None]
    incomplete = int(np.count_nonzero(~good.all(axis=1)))
    if s.two_d_mode:
        kept[:, :, _UPRIGHT if c.block < 12 else _UPRIGHT[:1]] = 0.0
        good &= np.abs(kept).max(axis=2) > _SEEN
    kept[~good] = 0.0
    R = np.where(good[:, :, None] & good[:, None, :], R, 0.0)
    R[:, own, own] = np.where(good, np.maximum(variance, _LEAST_VARIANCE), 1.0)
    H6, R6 = np.zeros((2, m, 6, 6))
    H6[:, :k], R6[:, :k, :k] = kept, R
    z = c.z if c.block < 12 else np.pad(np.where(good, c.z[:, rows], 0.0), ((0, 0), (0, 6 - k)))
    gate, lever = getattr(sensor, f"{part}_gate") ** 2, np.zeros((m, 3)) + c.lever
    return Rows(f"{sensor.name}_{part}", c.block, k, c.stamps, z, H6, R6, gate, lever, c.gravity, incomplete)


def _covariances(readings: Sequence[Reading], mask: Sequence[bool]) -> np.ndarray:
    """Return the covariances; what is no number there is zero where nobody asks for it."""
    C, asked = np.array([reading.covariance for reading in readings]), np.array(mask)
    return np.where(np.isfinite(C) | (asked[:, None] & asked), C, 0.0)


def _in_base(mask: Sequence[bool], Q: np.ndarray, C: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which values of the base have a part in masked ones, unit rows, and C turned into the base by Q."""
    parts = np.linalg.norm(Q[:, None] * np.reshape(mask, (2, 1, 3)), axis=3).max(axis=0, initial=0.0)
    return parts.ravel() >= _SEEN, np.broadcast_to(np.eye(6), C.shape), turned(C, Q, Q)


def _whole(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return poses without NaN, and which of their six values are known."""
    place, turn = np.isfinite(T[:, :3, 3]), np.asarray(np.isfinite(T[:, :3, :3]).all(axis=(1, 2)))
    T[:, :3, 3] = np.where(place, T[:, :3, 3], 0.0)
    T[~turn, :3, :3] = np.eye(3)
    return T, np.concatenate([place, np.repeat(turn[:, None], 3, axis=1)], axis=1)


def _each(A: np.ndarray, v: np.ndarray) -> np.ndarray:
    return (A @ v[:, :, None])[:, :, 0]
