"""The 15-state filter in space, extended or unscented, over what a robot measured: the main path of a drop-in run.

State: x y z, roll pitch yaw in the world, then velocity, rates and acceleration of the base in its own axes; constant
acceleration. Source: Moore & Stouch 2014, "A generalized extended Kalman filter implementation for the Robot Operating
System", whose states, masks and settings these are. Ours differs where docs/robot_localization.md says so.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from longreach.errors import EstimationError
from longreach.estimation import _spatial_run_kernels as kernels
from longreach.estimation.spatial_angles import body_rates, from_angles
from longreach.estimation.spatial_order import judge
from longreach.estimation.spatial_rows import Rows, acceleration_rows, pose_rows, twist_rows
from longreach.spatial_measurement import AccelerationReading, PoseReading, Reading, SpatialRecording, TwistReading
from longreach.spatial_settings import SpatialSettings

_PARTS = {PoseReading: ("pose", pose_rows), TwistReading: ("twist", twist_rows)}
_PARTS[AccelerationReading] = ("acceleration", acceleration_rows)  # type: ignore[assignment]


@dataclass(frozen=True, eq=False)
class SpatialEstimate:
    """Rows of the estimate, and what became of each measurement.

    stamps (n,) [s]; states (n, 15); state_covariance (n, 6, 6) of position and angles in the world.
    used: source (odom0_twist, …) → how many were used, gated, refused. nis: source → stamps, NIS, rows of each.
    """

    stamps: Float[np.ndarray, " n"]
    states: Float[np.ndarray, "n 15"]
    state_covariance: Float[np.ndarray, "n 6 6"]
    used: Mapping[str, tuple[int, int, int]]
    nis: Mapping[str, tuple[np.ndarray, np.ndarray, int]]
    remarks: tuple[str, ...]

    @property
    def poses(self) -> Float[np.ndarray, "n 4 4"]:
        """T_world_base (n, 4, 4)."""
        T = np.zeros((len(self.stamps), 4, 4))
        T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = from_angles(self.states[:, 3:6]), self.states[:, :3], 1.0
        return T

    @property
    def covariance(self) -> Float[np.ndarray, "n 6 6"]:
        """Of ξ = log(mean⁻¹ · truth), [v; ω] in the base's axes: ξ = (Rᵀ δp, W δρ)."""
        J = np.zeros_like(self.state_covariance)
        J[:, :3, :3] = np.swapaxes(from_angles(self.states[:, 3:6]), 1, 2)
        J[:, 3:, 3:] = body_rates(self.states[:, 3:6])
        return J @ self.state_covariance @ np.swapaxes(J, 1, 2)


def estimate_in_space(recording: SpatialRecording, settings: SpatialSettings) -> SpatialEstimate:
    """Run the filter over a recording; late readings stand where their stamps put them.

    Raises:
        EstimationError: nothing is there that could be fused.
    """
    readings, remarks = _believed(recording.readings, settings)
    rows = rows_of(readings, recording, settings)
    if not rows:
        raise EstimationError("No reading of the recording can be fused; check the masks and frames of the sensors.")
    table, whose = _table(rows)
    ticks = _ticks(table[0], settings.frequency)
    n, m = len(whose), len(ticks)
    status, nis, stamps, states = np.zeros(n, dtype=np.int8), np.full(n, np.nan), np.zeros(m), np.zeros((m, 15))
    covariances = np.zeros((m, 6, 6))
    out = (status, nis, stamps, states, covariances, np.zeros(3), np.zeros(3))
    x, P = settings.initial_state.copy(), settings.initial_covariance.copy()
    model, control = model_of(settings), control_of(recording, settings)
    kernels.run(
        x, P, table, ticks, model, control, settings.sensor_timeout, settings.predict_to_now, out, kernels.work_room()
    )
    fresh = np.concatenate(([True], np.diff(stamps) > 0))
    if not np.all(np.isfinite(states)):
        raise EstimationError("The filter lost itself in numbers that are not finite; check covariances and noise.")
    used, consistency = _by_source(rows, whose, status, nis, table[0])
    return SpatialEstimate(
        stamps[fresh],
        states[fresh],
        covariances[fresh],
        used,
        consistency,
        (*recording.remarks, *remarks, *_said(rows, used)),
    )


def _believed(readings: Sequence[Reading], settings: SpatialSettings) -> tuple[list[Reading], list[str]]:
    """Return the readings in the order of their stamps, without those too late and those from the future."""
    stamps = np.array([reading.stamp for reading in readings])
    late, ahead = judge(stamps, settings.history)
    remarks = []
    if late.any():
        remarks.append(f"{late.sum()} readings came in more than {settings.history:g} s late and were left out.")
    if ahead.any():
        remarks.append(f"{ahead.sum()} readings have stamps ahead of what came in after them and were left out.")
    kept = np.flatnonzero(~late & ~ahead)
    behind = np.maximum.accumulate(stamps[kept]) - stamps[kept]
    if np.any(behind > 0):
        count, most = np.count_nonzero(behind), behind.max()
        remarks.append(f"{count} readings came in out of order, by up to {most:.3f} s, and were put where they belong.")
    return [readings[i] for i in kept[np.argsort(stamps[kept], kind="stable")].tolist()], remarks


def rows_of(readings: Sequence[Reading], recording: SpatialRecording, settings: SpatialSettings) -> list[Rows]:
    """Return the measurements by sensor and part; at one stamp the sensors go in the order of the settings."""
    found = []
    for sensor in settings.sensors:
        own = [reading for reading in readings if reading.source == sensor.name]
        for kind, (name, prepare) in _PARTS.items():
            part: Any = [reading for reading in own if isinstance(reading, kind)]
            if part:
                rows = prepare(sensor, part, recording, settings)
                if rows.k and len(rows.stamps):
                    found.append(replace(rows, source=f"{sensor.name}_{name}"))
    return found


def _table(rows: Sequence[Rows]) -> tuple[tuple[np.ndarray, ...], Int[np.ndarray, " n"]]:
    """Return all measurements in the order of their stamps as the kernel takes them, and whose each is."""
    stamps = np.concatenate([r.stamps for r in rows])
    order = np.argsort(stamps, kind="stable")
    whose = np.repeat(np.arange(len(rows)), [len(r.stamps) for r in rows])[order]
    constant = [np.array([getattr(r, name) for r in rows])[whose] for name in ("block", "k", "gate", "gravity")]
    block, k, gate, gravity = constant
    z, H, R, lever = (np.concatenate([getattr(r, name) for r in rows])[order] for name in ("z", "H", "R", "lever"))
    return (stamps[order], block, k, z, H, R, gate, lever, gravity), whose


def _ticks(stamps: Float[np.ndarray, " n"], frequency: float) -> Float[np.ndarray, " m"]:
    """Return when rows are due: at the frequency from the first measurement on, and at the last."""
    count = int((stamps[-1] - stamps[0]) * frequency)
    if count > 50_000_000:
        raise EstimationError(
            f"At {frequency:g} rows a second, {stamps[-1] - stamps[0]:.0f} s make too many; lower frequency."
        )
    ticks = stamps[0] + np.arange(count + 1) / frequency
    return np.append(ticks[ticks < stamps[-1]], stamps[-1])


def model_of(s: SpatialSettings) -> tuple[Any, ...]:
    """Return the model as the kernels take it; as robot_localization does it, orientation lags a step behind."""
    lead = 0.0 if s.as_robot_localization else 0.5
    flags = (s.dynamic_process_noise, s.two_d_mode)
    return (s.process_noise.copy(), lead, s.as_robot_localization, s.filter == "ukf", s.alpha, s.kappa, *flags)


def control_of(recording: SpatialRecording, s: SpatialSettings) -> tuple[Any, ...]:
    """Return the control input as the kernels take it."""
    c = s.control
    if c is None:
        return np.zeros(0), np.zeros((0, 6)), np.zeros(6, dtype=np.bool_), np.zeros((4, 6)), 0.0
    commands = sorted(recording.commands, key=lambda command: command.stamp)
    limits = np.array([c.limits, c.gains, c.braking_limits, c.braking_gains])
    twists = np.array([command.twist for command in commands]).reshape(-1, 6)
    return np.array([command.stamp for command in commands]), twists, np.array(c.mask), limits, c.timeout


def _by_source(
    rows: Sequence[Rows], whose: np.ndarray, status: np.ndarray, nis: np.ndarray, stamps: np.ndarray
) -> tuple[dict[str, tuple[int, int, int]], dict[str, tuple[np.ndarray, np.ndarray, int]]]:
    used, consistency = {}, {}
    for i, r in enumerate(rows):
        own = whose == i
        counts = [int(np.count_nonzero(status[own] == kind)) for kind in (kernels.USED, kernels.GATED, kernels.REFUSED)]
        used[r.source] = (counts[0], counts[1], counts[2])
        told = own & np.isfinite(nis)
        consistency[r.source] = (stamps[told], nis[told], r.k)
    return used, consistency


def _said(rows: Sequence[Rows], used: Mapping[str, tuple[int, int, int]]) -> list[str]:
    said = []
    for r, (name, (taken, gated, refused)) in zip(rows, used.items(), strict=True):
        total = taken + gated + refused
        if r.incomplete:
            said.append(
                f"{name}: {r.incomplete} of {total} measurements hold values that are no numbers; those were left out."
            )
        if gated:
            said.append(f"{name}: {gated} of {total} measurements were beyond the threshold and left out.")
        if refused:
            said.append(f"{name}: {refused} of {total} measurements were refused, for their covariance is none.")
    return said
