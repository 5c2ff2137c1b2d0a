"""Calibration: recordings of ordinary driving in, a description to use from now on out.

Motions between keyframes come from LIDAR odometry in the laser's own frame, or from a reference; what the wheels turned
between the same stamps is what the description's parameters have to explain.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from longreach.app.estimate import sensor_mount
from longreach.app.evaluate import Progress
from longreach.app.results import write_results
from longreach.calibration.extrinsics import SCALE_DEVIATION, sensor_displacement
from longreach.calibration.observability import Calibrated, calibrate_motions, not_shown
from longreach.calibration.wheels import Motions, WheelModel, wheel_model
from longreach.errors import CalibrationError
from longreach.evaluation import style
from longreach.evaluation.glitches import drop_glitches
from longreach.evaluation.tables import metric
from longreach.geometry import se2, se3
from longreach.io.config import to_yaml, validated
from longreach.io.whole_files import whole_folder
from longreach.measurement import Odometry, Recording, WheelTicks
from longreach.odometry.lidar import lidar_odometry
from longreach.odometry.wheel import wheel_odometry
from longreach.robot.description import RobotDescription
from longreach.robot.mobile_manipulator import MobileManipulator, description_of
from longreach.trajectory import PoseTrajectory

_TRUTH_SCALE = 0.001  # deviation of a reference's lengths [1]: motion capture is calibrated to better than that
_TRUTH_SPEED = 3.0  # [m/s]: faster a reference does not move, it jumps
_FAR, _TURNED, _LONGEST = 0.25, 0.25, 2.0  # [m, rad, s] between keyframes of a reference
_GAP = 0.5  # [s] between wheel records, or rows of a reference, across which nothing is taken
_MARKED = 2.0  # deviations beyond which a change is marked
_CAPTIONS = {"residuals": "What the wheels leave unexplained of each motion, before and after. Left out: grey."}


@dataclass(frozen=True)
class Parameter:
    """One number of a description; sigma is None, and value the nominal one, where the recordings do not show it."""

    value: float
    sigma: float | None
    nominal: float
    unit: str
    observable: bool


@dataclass(frozen=True, eq=False)
class Calibration:
    """What recordings show of a robot: `robot` is to be used from now on, `nominal` what it was.

    before, after (n, 3): residual of each motion [m, m, rad] with nominal and with found parameters.
    remarks: what was refused, with the manoeuvre that would show it, a sentence each.
    """

    robot: RobotDescription
    nominal: RobotDescription
    parameters: dict[str, Parameter]
    covariance: Float[np.ndarray, "q q"]
    before: Float[np.ndarray, "n 3"]
    after: Float[np.ndarray, "n 3"]
    used: np.ndarray
    remarks: tuple[str, ...]


def calibrate(
    recordings: Recording | Sequence[Recording],
    robot: RobotDescription | MobileManipulator,
    *,
    truth: PoseTrajectory | None = None,
    use_truth: bool = False,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate wheels and the laser's planar pose from recordings of ordinary driving.

    Arguments: truth: a reference in place of scans, for one recording; use_truth: each recording's own. Then the pose
    of what the reference follows is found in place of the laser's, and is not part of the description.

    Raises CalibrationError where the recordings show nothing, or have no scans and no reference.
    """
    description, tell = description_of(robot), progress or (lambda stage, fraction: None)
    recordings = (recordings,) if isinstance(recordings, Recording) else tuple(recordings)
    by_truth, model = use_truth or truth is not None, wheel_model(description)
    mount = np.zeros(3) if by_truth else se2.from_se3(sensor_mount(recordings[0], description, "lidar"))
    parts = []
    for recording in recordings:
        keyframes = (
            _from_truth(recording, truth if truth is not None else recording.truth)
            if by_truth
            else _from_scans(recording, description, tell)
        )
        parts.append(_motions(recording, description, keyframes))
    tell("calibration", 0.0)
    motions = _joined(parts)
    found = calibrate_motions(model, motions, mount, _TRUTH_SCALE if by_truth else SCALE_DEVIATION)
    names = [name.replace("laser", "truth") if by_truth else name for name in found.names]
    sigma = np.sqrt(np.diag(found.covariance)).tolist()
    rows = zip(
        found.values.tolist(), sigma, found.nominal.tolist(), found.units, found.observable.tolist(), strict=True
    )
    parameters = {
        name: Parameter(value, s if is_shown else None, nominal, unit, is_shown)
        for name, (value, s, nominal, unit, is_shown) in zip(names, rows, strict=True)
    }
    before = _left(model, np.concatenate((found.nominal[:-3], found.fit.values[-3:])), motions)
    after = _left(model, np.concatenate((found.values[:-3], found.fit.values[-3:])), motions)
    remarks = tuple(not_shown(name) for name, p in parameters.items() if not p.observable)
    used = found.fit.used
    changed = calibrated_description(description, model, found, None if by_truth else mount, recordings[0])
    return Calibration(changed, description, parameters, found.covariance, before, after, used, remarks)


def _left(model: WheelModel, q: np.ndarray, motions: Motions) -> np.ndarray:
    return se2.difference(sensor_displacement(model, q, motions)[0], motions.displacement)


def calibrated_description(
    robot: RobotDescription, model: WheelModel, found: Calibrated, mount: np.ndarray | None, recording: Recording
) -> RobotDescription:
    """Return a description with the values found; mount (3,): None where the laser's is left as it is."""
    values = dict(zip(found.names, found.values.tolist(), strict=True))
    changes: dict[str, Any] = robot.model_dump(exclude_unset=True)
    base = robot.base
    if base is None:
        changes["odometry_scale"] = found.values[:3].tolist()
    elif base.kind == "differential":
        radii = [values[f"radius_{side}"] for side in base.wheel_sides]
        changes["base"] |= {
            "wheel_radius": float(np.mean(radii)),
            "wheel_radii": radii,
            "track_width": values["track_width"],
        }
    elif base.kind == "mecanum":
        scale = values["k"] / base.lever  # only the sum of length and width enters
        radii = [values[f"radius_{corner}"] for corner in base.wheel_corners]
        size = {"half_length": base.half_length * scale, "half_width": base.half_width * scale}
        changes["base"] |= {"wheel_radius": float(np.mean(radii)), "wheel_radii": radii, **size}
    if mount is not None and found.observable[-3:].any():
        T = sensor_mount(recording, robot, "lidar")
        roll, pitch = np.arctan2(T[2, 1], T[2, 2]), -np.arcsin(np.clip(T[2, 0], -1.0, 1.0))
        x, y, yaw = found.values[-3:].tolist()
        place = {"x": x, "y": y, "z": float(T[2, 3]), "roll": float(roll), "pitch": float(pitch), "yaw": yaw}
        changes["lidar"] = {**(changes.get("lidar") or {}), "mount": place}
    return validated(RobotDescription, changes, "calibrated")


def _from_scans(recording: Recording, robot: RobotDescription, tell: Progress) -> tuple[np.ndarray, ...]:
    """Return stamps (n, 2) of keyframes, displacements (n, 3) of the laser between them, and covariances (n, 3, 3)."""
    if len(recording.scans) < 2:
        raise CalibrationError(
            f"{recording.name} has {len(recording.scans)} scans; where there is no LIDAR, give a reference with "
            "--truth."
        )
    T = sensor_mount(recording, robot, "lidar")
    c, s = np.cos(se2.from_se3(T)[2]), np.sin(se2.from_se3(T)[2])
    level = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ T[:3, :3]  # its tilt alone
    mount, n = se3.from_rotation_translation(level, np.zeros(3)), len(recording.scans)
    matches = lidar_odometry(recording.scans, mount, None, lambda i: tell("LIDAR odometry", i / n))
    kept = [m.measurement for m in matches if m.keyframe and m.measurement is not None and not len(m.degenerate)]
    stamps = np.array([(m.stamp_reference, m.stamp) for m in kept]).reshape(-1, 2)
    poses, covariances = np.array([m.pose for m in kept]), np.array([m.covariance for m in kept])
    return stamps, poses.reshape(-1, 3), covariances.reshape(-1, 3, 3)


def _from_truth(recording: Recording, truth: PoseTrajectory | None) -> tuple[np.ndarray, ...]:
    """Return the same as `_from_scans` from a reference with headings: of what it follows, wherever that is."""
    if truth is None or len(truth) == 0 or not truth.has_heading:
        raise CalibrationError(f"{recording.name} has no reference with headings; give one with --truth TOPIC or FILE.")
    truth, _ = drop_glitches(truth, _TRUTH_SPEED)
    clock, poses, rows = truth.clock, truth.poses, [0]
    for i in range(1, len(truth)):
        e, dt = se2.between(poses[rows[-1]], poses[i]), clock[i] - clock[rows[-1]]
        if np.hypot(e[0], e[1]) > _FAR or abs(e[2]) > _TURNED or dt > _LONGEST:
            rows.append(i)
    a, b = np.array(rows[:-1], dtype=int), np.array(rows[1:], dtype=int)
    gaps = np.concatenate(([0.0], np.cumsum(np.diff(clock) > _GAP)))
    whole = gaps[a] == gaps[b]
    a, b = a[whole], b[whole]
    moved = se2.between(poses[a], poses[b])
    return np.column_stack((clock[a], clock[b])), moved, np.tile(np.eye(3) * 1e-6, (len(a), 1, 1))


def _motions(recording: Recording, robot: RobotDescription, keyframes: tuple[np.ndarray, ...]) -> Motions:
    """Join displacements with what the wheels turned meanwhile; their noise grows with the way (`WheelNoise`)."""
    stamps, displacement, covariance = keyframes
    records = recording.wheels
    if len(records) < 2:
        raise CalibrationError(
            f"{recording.name} has {len(records)} wheel records; a calibration takes those of a drive."
        )
    clock, total = _turned(recording, robot)
    gaps = np.concatenate(([0.0], np.cumsum(np.diff(clock) > _GAP)))
    inside = (stamps[:, 0] >= clock[0]) & (stamps[:, 1] <= clock[-1])
    whole = np.interp(stamps[:, 0], clock, gaps) == np.interp(stamps[:, 1], clock, gaps)
    stamps, displacement, covariance = (rows[inside & whole] for rows in (stamps, displacement, covariance))
    grid = np.union1d(clock, stamps)
    turns = np.diff(np.column_stack([np.interp(grid, clock, column) for column in total.T]), axis=0)
    noise, way, angle = robot.wheel_noise, np.hypot(*displacement[:, :2].T), np.abs(displacement[:, 2])
    across = noise.along**2 * way + noise.turning**2 * angle + 1e-6
    heading = noise.heading_travel**2 * way + noise.heading_turning**2 * angle + 1e-6
    grown = covariance.copy()
    grown[:, [0, 1, 2], [0, 1, 2]] += np.column_stack((across, across, heading))
    return Motions(turns, np.searchsorted(grid, stamps), displacement, grown)


def _turned(recording: Recording, robot: RobotDescription) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps (m,) [s] of the wheels' records, and what they have turned in all (m, w) [rad], or driven."""
    records = recording.wheels
    clock = np.array([record.stamp for record in records])
    if isinstance(records[0], WheelTicks):
        encoder = robot.encoder
        wrap = wheel_odometry(records, robot).wrap_range or (0.0 if encoder is None else encoder.range)
        ticks = np.array([record.ticks for record in records])  # type: ignore[union-attr]
        turned = np.diff(ticks, axis=0)
        if wrap:
            turned -= wrap * np.rint(turned / wrap)
        steps = turned * (1.0 if encoder is None else encoder.radians_per_tick)
    elif isinstance(records[0], Odometry) and records[0].pose is not None:
        poses = np.array([record.pose for record in records])  # type: ignore[union-attr]
        steps = se2.difference(poses[:-1], poses[1:])
    else:
        field = "twist" if isinstance(records[0], Odometry) else "speeds"
        rates = np.array([getattr(record, field) for record in records])
        steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(clock)[:, None]
    good = np.concatenate(([True], np.isfinite(steps).all(axis=1)))
    total = np.concatenate((np.zeros((1, steps.shape[1])), np.cumsum(np.where(good[1:, None], steps, 0.0), axis=0)))
    return clock[good], total[good]


def _joined(parts: Sequence[Motions]) -> Motions:
    offsets = np.cumsum([0, *(len(part.turns) for part in parts)])
    spans = [part.spans + offset for part, offset in zip(parts, offsets, strict=False)]
    columns = [np.concatenate([getattr(part, name) for part in parts]) for name in ("displacement", "covariance")]
    return Motions(np.concatenate([part.turns for part in parts]), np.concatenate(spans), *columns)


def write_calibration(calibration: Calibration, out: str | Path, progress: Progress | None = None) -> None:
    """Write robot.yaml, calibration.json, its covariance, metrics, figures and a page, whole or not at all."""
    tell = progress or (lambda stage, fraction: None)
    c, parameters = calibration, calibration.parameters
    with whole_folder(Path(out)) as folder:
        (folder / "robot.yaml").write_text(to_yaml(c.robot), encoding="utf-8")
        text = json.dumps({name: asdict(p) for name, p in parameters.items()}, indent=1, allow_nan=False) + "\n"
        (folder / "calibration.json").write_text(text, encoding="utf-8")
        np.savez_compressed(folder / "covariance.npz", names=np.array(list(parameters)), calibration=c.covariance)
        marked = [name for name, p in parameters.items() if is_changed(p)]
        said = f"Changed by more than {_MARKED:g} σ: {', '.join(marked)}." if marked else "Nothing changed by 2 σ."
        introduction = f"Robot {c.robot.name}: {len(c.used)} motions, of which {int((~c.used).sum())} slipped. {said}"
        drawn = {"residuals": lambda: _residual_figure(c)}
        title, config = f"Calibration of {c.robot.name}", to_yaml(c.robot)
        write_results(folder, title, introduction, metrics(c), drawn, config, tell, c.remarks, _CAPTIONS, metrics(c))


def is_changed(parameter: Parameter) -> bool:
    """Whether a value is off its nominal one by more than 2 σ."""
    return parameter.sigma is not None and abs(parameter.value - parameter.nominal) > _MARKED * parameter.sigma


def metrics(c: Calibration) -> dict[str, dict[str, Any]]:
    """Return the residuals of the motions that did not slip, before and after, as of metrics.json."""
    found = {}
    for name, e in (("before", c.before[c.used]), ("after", c.after[c.used])):
        translation = float(np.sqrt((e[:, :2] ** 2).sum(axis=1).mean()))
        found[name] = {"residual_translation": metric(translation, "m")}
        found[name]["residual_rotation"] = metric(float(np.degrees(np.sqrt((e[:, 2] ** 2).mean()))), "deg")
    return found


def _residual_figure(c: Calibration) -> Figure:
    fig = Figure(figsize=(7.0, 5.0), layout="constrained")
    for axes, i, unit in zip(fig.subplots(3, 1, sharex=True), range(3), ("x [m]", "y [m]", "θ [rad]"), strict=True):
        k = np.arange(len(c.used))
        axes.plot(k, c.before[:, i], ".", color=style.ORANGE, markersize=2, label="before")
        axes.plot(k, c.after[:, i], ".", color=style.GREEN, markersize=2, label="after")
        axes.plot(k[~c.used], c.after[~c.used, i], ".", color="0.6", markersize=2)
        limit = 6.0 * float(np.std(c.before[c.used, i])) + 1e-6
        axes.set_ylim(-limit, limit)
        axes.set_ylabel(unit)
    fig.axes[0].legend(loc="upper right")
    fig.axes[-1].set_xlabel("motion")
    return fig
