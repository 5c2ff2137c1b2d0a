"""What the 15-state filter is to compare: readings of one sensor as rows z - H x over one block of the state.

Ours: each masked value is compared in the frame in which the sensor gives it, so that H carries mounting and lever arm.
As robot_localization does it, everything is turned into the base's frame first, and a value of the base is compared
when any masked value of the sensor has a part in it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.estimation.spatial_angles import angle_rates, body_rates, from_angles, to_angles
from longreach.geometry import se3
from longreach.spatial_measurement import AccelerationReading, PoseReading, Reading, SpatialRecording, TwistReading
from longreach.spatial_settings import SensorSettings, SpatialSettings

_LEAST_VARIANCE = 1e-9  # in place of zero, which messages leave where they know none; as robot_localization
_SEEN = 1e-6  # a smaller part of a masked value in a value of the base is rounding; as robot_localization
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


def pose_rows(
    sensor: SensorSettings, readings: Sequence[PoseReading], world: SpatialRecording, s: SpatialSettings
) -> Rows:
    """Return poses as they are, relative to the first, or as twists from one to the next; of an IMU the orientation."""
    mask = sensor.mask[:6]
    stamps, C = np.array([r.stamp for r in readings]), _covariances(readings, mask)
    T, known = _whole(np.array([r.pose for r in readings]))
    is_imu, as_is = sensor.kind == "imu", s.as_robot_localization
    mount = np.array([world.mounts[r.frame if is_imu else r.child] for r in readings])
    origin = np.array([np.eye(4) if is_imu else world.origins[r.frame] for r in readings])
    turn = mount[:, :3, :3] if is_imu else np.broadcast_to(np.eye(3), (len(T), 3, 3))  # R_base_sensor
    sensed = T  # of the sensor, or of the base in the frame of the message
    T = T @ se3.inverse(_turned(turn) if is_imu else mount)
    if is_imu and as_is:
        T = _turned(_unmounted(sensed[:, :3, :3], turn))
    Q = _yaw_of(turn) if is_imu else origin[:, :3, :3]  # by which robot_localization turns masks and covariances
    if sensor.differential:
        return _differences(sensor, stamps, T, C, known, turn, Q, s)
    if sensor.relative:
        C = _rotated(C, np.broadcast_to(T[0, :3, :3].T, (len(T), 3, 3))) if not as_is and not is_imu else C
        T = se3.inverse(T[0]) @ T
    T = origin @ T
    z = np.concatenate([T[:, :3, 3], to_angles(T[:, :3, :3])], axis=1)
    if as_is:
        return _finish(sensor, 0, stamps, z, np.where(known, z, np.nan), *_in_base(mask, Q, C), sensor.pose_gate, s)
    H = np.zeros((len(T), 6, 6))
    H[:, :3, :3] = np.swapaxes(origin[:, :3, :3], 1, 2)
    H[:, 3:, 3:] = np.eye(3)
    if not sensor.relative:
        seen = to_angles(sensed[:, :3, :3]) if is_imu else to_angles(H[:, :3, :3] @ T[:, :3, :3])
        if all(mask[3:]):  # three angles are an orientation, which has no poles
            J = np.zeros_like(C)
            J[:, :3, :3], J[:, 3:, 3:] = np.eye(3), angle_rates(z[:, 3:]) @ turn @ body_rates(seen)
            C = J @ C @ np.swapaxes(J, 1, 2)
        else:
            H[:, 3:, 3:] = angle_rates(seen) @ np.swapaxes(turn, 1, 2) @ body_rates(z[:, 3:])
    return _finish(sensor, 0, stamps, z, np.where(known, z, np.nan), mask, H, C, sensor.pose_gate, s)


def twist_rows(
    sensor: SensorSettings, readings: Sequence[TwistReading], world: SpatialRecording, s: SpatialSettings
) -> Rows:
    """Return twists of the sensor; its linear velocity is that of the point where it sits."""
    mask = sensor.mask[6:12]
    stamps, C = np.array([r.stamp for r in readings]), _covariances(readings, mask)
    mount = np.array([world.mounts[r.frame] for r in readings])
    raw = np.array([r.twist for r in readings])
    twist, turn, lever = np.where(np.isfinite(raw), raw, 0.0), mount[:, :3, :3], mount[:, :3, 3]
    if s.as_robot_localization:
        z = np.concatenate([_each(turn, twist[:, :3]), _each(turn, twist[:, 3:])], axis=1)
        given = np.where(_all_known(raw, mask), z, np.nan)
        return _finish(sensor, 6, stamps, z, given, *_in_base(mask, turn, C), sensor.twist_gate, s, lever)
    H = np.zeros((len(raw), 6, 6))
    H[:, :3, :3] = H[:, 3:, 3:] = np.swapaxes(turn, 1, 2)
    H[:, :3, 3:] = -H[:, :3, :3] @ _cross(lever)
    z = np.linalg.solve(H, twist[:, :, None])[:, :, 0]
    return _finish(sensor, 6, stamps, z, raw, mask, H, C, sensor.twist_gate, s)


def acceleration_rows(
    sensor: SensorSettings, readings: Sequence[AccelerationReading], world: SpatialRecording, s: SpatialSettings
) -> Rows:
    """Return accelerations; gravity is removed by the message's own orientation, else by the filter's."""
    stamps = np.array([r.stamp for r in readings])
    C = np.zeros((len(stamps), 6, 6))
    C[:, :3, :3] = _covariances(readings, sensor.mask[12:])
    mount = np.array([world.mounts[r.frame] for r in readings])
    turn, lever = mount[:, :3, :3], mount[:, :3, 3]
    raw = np.zeros((len(stamps), 6))
    raw[:, :3] = [r.acceleration for r in readings]
    attitude = [r.attitude for r in readings]
    by_filter = sensor.remove_gravity and any(R is None for R in attitude)
    if sensor.remove_gravity and not by_filter:
        raw[:, :3] -= s.gravity * np.array([R[2] for R in attitude if R is not None])  # R_world_sensorᵀ (0, 0, g)
    gravity = s.gravity if by_filter else 0.0
    mask = (*sensor.mask[12:], False, False, False)
    if s.as_robot_localization:
        z = np.zeros_like(raw)
        z[:, :3] = _each(turn, raw[:, :3])
        rows = _in_base(mask, turn, C)
        return _finish(sensor, 12, stamps, z, z, *rows, sensor.acceleration_gate, s, lever, gravity)
    H = np.zeros((len(raw), 6, 6))
    H[:, :3, :3] = np.swapaxes(turn, 1, 2)
    return _finish(sensor, 12, stamps, raw, raw, mask, H, C, sensor.acceleration_gate, s, lever, gravity)


def _differences(
    sensor: SensorSettings,
    stamps: np.ndarray,
    T: np.ndarray,
    C: np.ndarray,
    known: np.ndarray,
    turn: np.ndarray,
    Q: np.ndarray,
    s: SpatialSettings,
) -> Rows:
    """Return the mean twist from each pose to the next, by log(T₁⁻¹ T₂)/dt; its covariance is (C₁ + C₂)/dt².

    As robot_localization does it, angles are divided by dt, and the covariance is (C₁ + C₂) dt.
    """
    later = np.flatnonzero(np.diff(stamps) > 0) + 1
    dt = np.diff(stamps)[later - 1, None]
    D = se3.inverse(T[later - 1]) @ T[later]
    known = known[later - 1] & known[later]
    mask = sensor.mask[:6]
    gate = sensor.pose_gate
    if s.as_robot_localization:
        z = np.concatenate([D[:, :3, 3], to_angles(D[:, :3, :3])], axis=1) / dt
        rows, H, C = _in_base(mask, Q[later], C[later] + C[later - 1])
        return _finish(sensor, 6, stamps[later], z, np.where(known, z, np.nan), rows, H, C * dt[:, :, None], gate, s)
    z = se3.log(D) / dt
    C = _rotated(C, np.swapaxes(T[:, :3, :3] @ turn, 1, 2))  # about the axes of the sensor itself
    H = np.zeros((len(later), 6, 6))
    H[:, :3, :3], H[:, 3:, 3:] = np.eye(3), np.swapaxes(turn[later], 1, 2)
    C = (C[later] + C[later - 1]) / dt[:, :, None] ** 2
    return _finish(sensor, 6, stamps[later], z, np.where(known, z, np.nan), mask, H, C, gate, s)


def _finish(
    sensor: SensorSettings,
    block: int,
    stamps: np.ndarray,
    z: np.ndarray,
    given: np.ndarray,
    mask: Sequence[bool] | np.ndarray,
    H: np.ndarray,
    C: np.ndarray,
    gate: float,
    s: SpatialSettings,
    lever: np.ndarray | None = None,
    gravity: float = 0.0,
) -> Rows:
    """Keep the masked rows; those whose value or variance is no number count as not measured."""
    rows, m = np.flatnonzero(mask), len(stamps)
    k = len(rows)
    R, own = C[:, rows][:, :, rows], np.arange(k)
    variance = np.abs(R[:, own, own]) if s.as_robot_localization else R[:, own, own]
    good = np.isfinite(given[:, rows]) & np.isfinite(variance) & (variance >= 0.0)
    bounded = np.isfinite(variance)
    whole = np.isfinite(R) | ~bounded[:, :, None] | ~bounded[:, None, :]
    good &= np.asarray(whole.all(axis=(1, 2)))[:, None]
    incomplete = int(np.count_nonzero(~good.all(axis=1)))
    kept = H[:, rows].copy()
    if s.two_d_mode:
        flat = _UPRIGHT if block < 12 else np.array([2])
        kept[:, :, flat] = 0.0
        good &= np.abs(kept).max(axis=2) > _SEEN
    kept[~good] = 0.0
    R = np.where(good[:, :, None] & good[:, None, :], R, 0.0)
    R[:, own, own] = np.where(good, np.maximum(variance, _LEAST_VARIANCE), 1.0)
    out = np.zeros((3, m, 6, 6))
    out[0, :, :k], out[1, :, :k, :k] = kept, R
    values = np.zeros((m, 6))
    if block == 12:
        values[:, :k] = np.where(good, z[:, rows], 0.0)
    else:
        values[:] = z
    lever = np.zeros((m, 3)) if lever is None else lever
    return Rows(sensor.name, block, k, stamps, values, out[0], out[1], gate**2, lever, gravity, incomplete)


def _covariances(readings: Sequence[Reading], mask: Sequence[bool]) -> np.ndarray:
    """Return the covariances; what is no number there is zero where nobody asks for it."""
    C, asked = np.array([reading.covariance for reading in readings]), np.array(mask)
    return np.where(np.isfinite(C) | (asked[:, None] & asked), C, 0.0)


def _in_base(mask: Sequence[bool], Q: np.ndarray, C: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return which values of the base have a part in masked ones, unit rows, and C turned into the base by Q."""
    parts = [
        np.linalg.norm(Q * np.array(mask[i : i + 3], dtype=float), axis=2).max(axis=0, initial=0.0) for i in (0, 3)
    ]
    return np.concatenate(parts) >= _SEEN, np.broadcast_to(np.eye(6), C.shape), _rotated(C, Q)


def _whole(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return poses without NaN, and which of their six values are known."""
    place, turn = np.isfinite(T[:, :3, 3]), np.asarray(np.isfinite(T[:, :3, :3]).all(axis=(1, 2)))
    T = T.copy()
    T[:, :3, 3] = np.where(place, T[:, :3, 3], 0.0)
    T[~turn, :3, :3] = np.eye(3)
    return T, np.concatenate([place, np.repeat(turn[:, None], 3, axis=1)], axis=1)


def _unmounted(R: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Take a mounting off an orientation as robot_localization does: angle by angle, then turned by its yaw."""
    offset = to_angles(turn)
    return from_angles(_each(_yaw_of(turn), to_angles(R) - offset))


def _yaw_of(R: np.ndarray) -> np.ndarray:
    return from_angles(to_angles(R) * np.array([0.0, 0.0, 1.0]))


def _turned(R: np.ndarray) -> np.ndarray:
    T = np.zeros((len(R), 4, 4))
    T[:, :3, :3], T[:, 3, 3] = R, 1.0
    return T


def _rotated(C: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Return C (m, 6, 6) with both halves turned by Q."""
    J = np.zeros_like(C)
    J[:, :3, :3] = J[:, 3:, 3:] = Q
    return J @ C @ np.swapaxes(J, 1, 2)


def _each(A: np.ndarray, v: np.ndarray) -> np.ndarray:
    return (A @ v[:, :, None])[:, :, 0]


def _cross(v: np.ndarray) -> np.ndarray:
    """Return [v]× of each row."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return out - np.swapaxes(out, 1, 2)


def _all_known(raw: np.ndarray, mask: Sequence[bool]) -> np.ndarray:
    """Whether the masked values of each half (m, 6) are all known."""
    lost = ~np.isfinite(raw) & np.array(mask)
    return ~np.repeat(np.stack([lost[:, :3].any(1), lost[:, 3:].any(1)], axis=1), 3, axis=1)
