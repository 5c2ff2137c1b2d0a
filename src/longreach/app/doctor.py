"""The doctor: what can be checked of a recording before anything is fused.

What a check can put right by itself it does, what it cannot it leaves out; either way it says so in a sentence: what
was found and, behind a semicolon, what was done.
It looks at no more than a sample of each sensor, so that it costs next to nothing beside reading.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Float

from longreach.geometry import so3
from longreach.measurement import Imu, LaserScan, Odometry, Recording, Wheels
from longreach.robot.description import RobotDescription

_GRAVITY = 9.80665  # [m/s²]
_READINGS, _SCANS = 1000, 100  # of a sensor that are looked at
_FEWEST = 20  # readings from which a sensor is judged
_ABOUT = 0.12  # share by which an accelerometer may be off gravity; MEMS scales are good to 3 %, the rest is driving
_UPRIGHT = 12.0  # [deg] that a mean of accelerations may lean: 2 m/s² of driving, kept up
_FASTEST_TURN = 20.0  # [rad/s] that no base turns with, and slow turns in degrees exceed
_FARTHEST = 150.0  # [m] beyond which the median of no planar scanner's ranges is
_OWN = 1.0  # [m] within which a scanner sees the robot itself
_GAP, _GAPS = 1.0, 10.0  # [s] and periods without a reading that are worth a remark

_T = TypeVar("_T")


class _Seen(NamedTuple):
    """What is left of a sensor's readings, and what there is to say."""

    readings: tuple
    remarks: list[str]


def examine(
    recording: Recording, robot: RobotDescription, T_base_imu: Float[np.ndarray, "4 4"]
) -> tuple[Recording, tuple[str, ...]]:
    """Return the recording with what could be put right, and what was found, a sentence each."""
    imu, said_of_imu = _imu(recording.imu, T_base_imu[:3, :3])
    scans, said_of_scans = _scans(recording.scans)
    wheels, said_of_wheels = _wheels(recording.wheels, robot)
    remarks = [*said_of_wheels, *said_of_scans, *said_of_imu]
    sensors = {"wheels": recording.wheels, "lidar": recording.scans, "imu": recording.imu}
    remarks += _gaps(sensors)
    if remarks:
        recording = recording.replace(imu=imu, scans=scans, wheels=wheels)
    return recording, tuple(remarks)


def _sample(readings: Sequence[_T], most: int) -> list[_T]:
    return [readings[i] for i in np.unique(np.linspace(0, len(readings) - 1, most).astype(int)).tolist()]


def _imu(readings: tuple[Imu, ...], R: np.ndarray) -> _Seen:
    """Check an IMU: that there is a gyro, in radians, and an accelerometer that feels gravity upwards.

    R (3, 3): the IMU's axes in the base.
    """
    if len(readings) < _FEWEST:
        return _Seen(readings, [])
    sample = _sample(readings, _READINGS)
    w = np.array([one.angular_velocity for one in sample])
    said = list[str]()
    if not w.any():
        return _Seen((), ["The IMU's angular velocity is always 0, so there is no gyro; the IMU was left out."])
    unit, fastest = 1.0, float(np.quantile(np.abs(w @ R[2]), 0.99))
    if fastest > _FASTEST_TURN:
        unit = np.pi / 180.0
        said.append(f"The gyro turns with {fastest:.0f} rad/s, which no base does; it was taken as degrees a second.")
    felt = np.array([one.acceleration for one in sample if one.acceleration is not None]).reshape(-1, 3)
    felt = felt[np.isfinite(felt).all(axis=1)]
    turned, scale, why = _gravity(felt, R)
    if why:
        said.append(why)
    if not said:
        return _Seen(readings, said)
    turn = unit * R.T @ turned @ R

    def mended(one: Imu) -> Imu:
        a = None if one.acceleration is None or scale is None else scale * one.acceleration
        return replace(one, angular_velocity=turn @ one.angular_velocity, acceleration=a)

    return _Seen(tuple(mended(one) for one in readings), said)


def _gravity(felt: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, float | None, str]:
    """Judge accelerations (n, 3) by gravity, which is up in the base in a specific force.

    Returns: how the IMU has to be turned in the base (3, 3), the factor of its accelerations, None where they are of no
    use, and the sentence.
    """
    none, out = np.eye(3), "its accelerations were left out"
    if len(felt) < _FEWEST:
        return none, 1.0, ""
    mean = np.mean(felt, axis=0)
    size = float(np.median(np.linalg.norm(felt, axis=1)))
    if size < 0.05:
        return none, None, f"The IMU's acceleration is {size:.2g} m/s² and not gravity: it has no accelerometer; {out}."
    if not np.ptp(felt, axis=0).any():
        return none, None, f"The IMU's acceleration is the same number in all readings: it is not measured; {out}."
    if np.linalg.norm(mean) < 0.5 * size:
        return none, None, f"The IMU's accelerations have no gravity in them, only motion; {out}."
    scale = next((one for one in (1.0, _GRAVITY, 1e-3 * _GRAVITY) if abs(one * size / _GRAVITY - 1) < _ABOUT), None)
    if scale is None:
        return none, None, f"The IMU's acceleration is {size:.2f} m/s² where gravity is {_GRAVITY:.2f}; {out}."
    units = {1.0: "", _GRAVITY: "g", 1e-3 * _GRAVITY: "thousandths of g"}[scale]
    say = f"The IMU's acceleration is {size:.2f}; it was taken in {units}." if units else ""
    up = R @ mean / max(float(np.linalg.norm(mean)), 1e-9)
    lean = float(np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0))))
    if lean < _UPRIGHT:
        return none, scale, say
    if lean > 180.0 - _UPRIGHT:
        say = "The IMU feels gravity downwards: its mount does not say that it is upside down, or its sign is wrong"
        return none, None, f"{say}; {out}."
    axis = np.cross(up, [0.0, 0.0, 1.0])
    turn = so3.exp(axis / np.linalg.norm(axis) * np.radians(lean))
    say = f"Gravity leans by {lean:.0f}° in the base by the IMU's mount, so that is wrong; its turns were taken about "
    return turn, None, say + f"gravity, and {out}."


def _scans(scans: tuple[LaserScan, ...]) -> _Seen:
    """Check a scanner: units of its angles and ranges, what it sees of the robot itself, the time of its sweep."""
    if len(scans) < 2:
        return _Seen(scans, [])
    said, sample = list[str](), _sample(scans, _SCANS)
    ranges = np.concatenate([one.ranges[np.isfinite(one.ranges) & (one.ranges > 0)] for one in sample])
    changes: dict[str, float] = {}
    if len(ranges) and (middle := float(np.median(ranges))) > _FARTHEST:
        changes["unit"] = 1e-3
        said.append(f"Half of the ranges are beyond {middle:.0f} m; they were taken as millimetres.")
    spans = [abs(one.angle_increment) * (len(one.ranges) - 1) for one in sample]
    span = float(np.median(spans))
    if span > 2.1 * np.pi:
        if span > 370.0:
            say = f"The scans span {np.degrees(span):.0f}° by their angle_increment, which no scanner does; "
            return _Seen((), [say + "the LIDAR was left out."])
        changes["angle"] = np.pi / 180.0
        said.append(f"The scans' angles span {span:.0f} rad; they were taken as degrees.")
    blocked = _blocked(sample, changes.get("unit", 1.0))
    if blocked is not None:
        n, at = int(blocked.sum()), np.flatnonzero(blocked)
        say = f"{n} of {len(blocked)} beams, between number {at[0]} and {at[-1]}, always see the same, nearer than "
        said.append(say + f"{_OWN:g} m: the robot itself; they were left out.")
    scans, repeated = _without_repeats(scans)
    if repeated:
        said.append(
            f"{repeated} scans repeat the one before to the last digit, as if the scanner hung; they were left out."
        )
    kinds = len({(len(one.ranges), round(one.angle_min, 4), round(one.angle_increment, 6)) for one in sample})
    if kinds > 3:
        said.append("The beams of the scans differ from scan to scan.")
    said += _sweep(scans, sample)
    if not changes and blocked is None:
        return _Seen(scans, said)
    unit, angle = changes.get("unit", 1.0), changes.get("angle", 1.0)

    def mended(one: LaserScan) -> LaserScan:
        ranges = unit * one.ranges
        if blocked is not None and len(blocked) == len(ranges):
            ranges = np.where(blocked, 0.0, ranges)
        limits = {}
        if unit != 1.0 and one.range_max > _FARTHEST:  # that is in millimetres as well
            limits = {"range_min": unit * one.range_min, "range_max": unit * one.range_max}
        first, step = angle * one.angle_min, angle * one.angle_increment
        return replace(one, ranges=ranges, angle_min=first, angle_increment=step, **limits)

    return _Seen(tuple(mended(one) for one in scans), said)


def _without_repeats(scans: tuple[LaserScan, ...]) -> tuple[tuple[LaserScan, ...], int]:
    """Leave out scans with the ranges of the one before, of which noise leaves none, where there are some in a row."""
    same = [False, *(_is_same(a.ranges, b.ranges) for a, b in pairwise(scans))]
    again = [one and (same[i - 1] or (i + 1 < len(same) and same[i + 1])) for i, one in enumerate(same)]
    return tuple(scan for scan, out in zip(scans, again, strict=True) if not out), sum(again)


def _is_same(a: np.ndarray, b: np.ndarray) -> bool:
    n = len(a)
    alike = n == len(b) and a[n // 2] == b[n // 2] and a[n // 3] == b[n // 3]
    return bool(alike and np.array_equal(a, b, equal_nan=True))


def _blocked(sample: list[LaserScan], unit: float) -> np.ndarray | None:
    """Return which beams see the robot itself: near, and never changing where most others change."""
    usual = max({len(one.ranges) for one in sample}, key=lambda n: sum(len(one.ranges) == n for one in sample))
    alike = [one for one in sample if len(one.ranges) == usual]
    if len(alike) < _SCANS // 2 or len(alike) < 0.9 * len(sample):
        return None
    ranges = unit * np.array([one.returns if unit == 1.0 else one.ranges for one in alike])
    seen = (ranges > 0).mean(axis=0)
    low, high = np.quantile(ranges, [0.05, 0.95], axis=0)
    still = (seen > 0.95) & (high < _OWN) & (high - low < 0.03)
    moves = np.median((high - low)[seen > 0.5]) > 0.2 if (seen > 0.5).any() else False
    return still if moves and still.any() else None


def _sweep(scans: tuple[LaserScan, ...], sample: list[LaserScan]) -> list[str]:
    """Say where the time of a sweep does not fit the time between scans."""
    if len(scans) < 2:
        return []
    period = float(np.median(np.diff([one.stamp for one in scans[:1000]])))
    sweep = float(np.median([one.time_increment * len(one.ranges) for one in sample]))
    if period > 0.0 and (sweep > 1.5 * period or sweep < 0.0):
        say = f"A sweep would last {sweep:.3g} s by its time_increment, but scans come every {period:.3g} s; "
        return [say + "it was not used."]
    return []


def _wheels(wheels: tuple[Wheels, ...], robot: RobotDescription) -> _Seen:
    """Check wheels: that they turn at all, and that a twist is in the base's axes."""
    if len(wheels) < _FEWEST:
        return _Seen(wheels, [])
    first = wheels[0]
    field = "ticks" if hasattr(first, "ticks") else "speeds" if hasattr(first, "speeds") else "pose"
    if isinstance(first, Odometry) and first.pose is None:
        return _twists(wheels, robot)
    values = np.array([getattr(one, field) for one in _sample(wheels, _READINGS) if getattr(one, field) is not None])
    if len(values) and np.isfinite(values).any() and not np.nanmax(np.ptp(values, axis=0)) > 0.0:
        return _Seen(wheels, ["The wheels' readings never change: they stood still all the time, or are not measured."])
    return _Seen(wheels, [])


def _twists(wheels: tuple[Wheels, ...], robot: RobotDescription) -> _Seen:
    """Turn twists into the base's axes where they are in those of odom: a base that cannot go sideways does."""
    rows = [one for one in wheels if isinstance(one, Odometry) and one.twist is not None]
    v = np.array([one.twist for one in rows])
    speed = np.hypot(v[:, 0], v[:, 1]) if len(v) else np.zeros(0)
    if robot.holonomic or len(v) < _FEWEST or speed.max() == 0.0 or np.abs(v[:, 1]).max() < 0.2 * speed.max():
        return _Seen(wheels, [])
    stamps = np.array([one.stamp for one in rows])
    theta = np.concatenate([[0.0], np.cumsum(np.diff(stamps) * 0.5 * (v[1:, 2] + v[:-1, 2]))])
    c, s = np.cos(theta), np.sin(theta)
    body = np.column_stack([c * v[:, 0] + s * v[:, 1], -s * v[:, 0] + c * v[:, 1], v[:, 2]])
    if np.sum(body[:, 1] ** 2) > 0.1 * np.sum(v[:, 1] ** 2):
        return _Seen(wheels, ["The wheels' twist goes sideways, which the robot cannot do; check its frame."])
    say = "The wheels' twist is in the axes of the odometry's frame; it was turned into those of the base."
    return _Seen(tuple(replace(one, twist=twist) for one, twist in zip(rows, body, strict=True)), [say])


def _gaps(sensors: dict[str, Sequence]) -> list[str]:
    """Say where a sensor was silent for long, and which are not of the same time."""
    remarks = []
    spans = {}
    for name, readings in sensors.items():
        if len(readings) < 2:
            continue
        stamps = np.array([one.stamp for one in readings])
        steps = np.diff(stamps)
        spans[name] = float(stamps.min()), float(stamps.max())
        usual = float(np.median(steps))
        silent = steps > max(_GAP, _GAPS * usual)
        if silent.any():
            at = int(np.argmax(steps))
            remarks.append(
                f"{name}: {int(silent.sum())} gaps without a reading, the longest of {steps[at]:.2f} s from "
                f"{stamps[at] - stamps[0]:.1f} s on."
            )
    for name, (start, end) in spans.items():
        others = [other for other, (a, b) in spans.items() if other != name and (a > end or b < start)]
        if others:
            remarks.append(f"{name} has readings of another time than {' and '.join(others)}; check its clock.")
    return remarks
