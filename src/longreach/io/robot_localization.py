"""Read the parameter files of robot_localization as users have them, in the layout of ROS 1 or of ROS 2.

What its keys mean: its documentation, "State estimation nodes" (docs.ros.org, robot_localization). Three keys of ours
may stand among them: `filter` (ekf or ukf), `transforms` (a list of PARENT:CHILD=x,y,z,roll,pitch,yaw) and
`as_robot_localization`.
"""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from longreach.errors import ConfigError
from longreach.io import robot_localization_keys as keys
from longreach.io.config import read_yaml
from longreach.spatial_settings import ControlSettings, SensorSettings, SpatialSettings

_SENSOR = re.compile(r"(odom|pose|twist|imu)(\d+)")
_STATES = 15


@dataclass(frozen=True, eq=False)
class ParameterFile:
    """The settings in a file, its node, all keys with their values as they ran, and what there is to say of them."""

    settings: SpatialSettings
    node: str
    values: Mapping[str, Any]
    transforms: tuple[str, ...]
    remarks: tuple[str, ...]


def is_parameter_file(path: Path) -> bool:
    """Whether a YAML file holds parameters for robot_localization: some node in it has a sensor."""
    return any(True for _ in _nodes(read_yaml(path), path.stem))


def read_parameters(path: Path, node: str | None = None, changes: Mapping[str, Any] | None = None) -> ParameterFile:
    """Read the parameters of one node.

    Arguments: node: which, where the file has several. changes: keys and values that go before those of the file.

    Raises:
        ConfigError: there is no such node, or a value is not of the kind that its key takes.
    """
    found = dict(_nodes(read_yaml(path), path.stem))
    if not found:
        raise ConfigError(f"{path} names no sensor (odom0, pose0, twist0 or imu0) for robot_localization to fuse.")
    if node is None and len(found) > 1:
        raise ConfigError(f"{path} has parameters of several nodes; name one by --node: {', '.join(found)}.")
    if node is not None and node not in found:
        raise ConfigError(f"{path} has no node {node} with sensors; there are: {', '.join(found)}.")
    name = node or next(iter(found))
    values, unknown = keys.checked({**found[name], **(changes or {})}, str(path))
    values.setdefault("filter", "ukf" if "ukf" in f"{name} {path.stem}".lower() else "ekf")
    return ParameterFile(
        _settings(values, str(path)),
        name,
        values,
        tuple(values.get("transforms", ())),
        tuple(_remarks(values, unknown)),
    )


def _nodes(content: Any, name: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each node's name and parameters: the file itself, or whatever stands below names and ros__parameters."""
    if not isinstance(content, dict):
        return
    if any(_SENSOR.fullmatch(str(key)) for key in content):
        yield name, content
        return
    for key, below in content.items():
        inner = name if key == "ros__parameters" else str(key).strip("/").replace("**", "any node")
        yield from _nodes(below, inner)


def _settings(values: Mapping[str, Any], where: str) -> SpatialSettings:
    frequency = values.get("frequency", 30.0)
    odom = values.get("odom_frame", "odom")
    late = abs(values.get("history_length", 0.0)) if values.get("smooth_lagged_data", False) else 0.0
    sensors = tuple(_sensor(match[1], match[2], values) for match in map(_SENSOR.fullmatch, values) if match)
    if not any(any(sensor.mask) for sensor in sensors):
        raise ConfigError(f"{where}: no sensor has anything to fuse; set entries of {sensors[0].name}_config to true.")
    defaults = SpatialSettings(sensors)
    return SpatialSettings(
        sensors=sensors,
        filter=values["filter"],
        frequency=frequency,
        sensor_timeout=values.get("sensor_timeout", 1.0 / frequency),
        predict_to_now=values.get("predict_to_current_time", False),
        two_d_mode=values.get("two_d_mode", False),
        map_frame=_frame(values.get("map_frame", "map")),
        odom_frame=_frame(odom),
        base_frame=_frame(values.get("base_link_frame", "base_link")),
        world_frame=_frame(values.get("world_frame", odom)),
        process_noise=_matrix(values, "process_noise_covariance", defaults.process_noise, where),
        initial_covariance=_matrix(values, "initial_estimate_covariance", defaults.initial_covariance, where),
        initial_state=np.array(values.get("initial_state", np.zeros(_STATES)), dtype=float),
        dynamic_process_noise=values.get("dynamic_process_noise_covariance", False),
        gravity=values.get("gravitational_acceleration", defaults.gravity),
        history=late or defaults.history,
        control=_control(values, sensors, where) if values.get("use_control", False) else None,
        alpha=values.get("alpha", defaults.alpha),
        kappa=values.get("kappa", defaults.kappa),
        as_robot_localization=values.get("as_robot_localization", False),
    )


def _frame(name: str) -> str:
    return name.lstrip("/")


def _sensor(kind: Any, number: str, values: Mapping[str, Any]) -> SensorSettings:
    """Gather the keys of one sensor; of its mask only what its messages hold."""
    name = f"{kind}{number}"

    def get(key: str, default: Any) -> Any:
        return values.get(f"{name}_{key}", default)

    one = get("rejection_threshold", math.inf)
    holds = {"odom": range(12), "pose": range(6), "twist": range(6, 12), "imu": (3, 4, 5, *range(9, 15))}[kind]
    mask = get("config", (False,) * _STATES)
    differential = get("differential", False)
    return SensorSettings(
        name=name,
        kind=kind,
        topic=values[name],
        mask=tuple(bool(mask[i]) and i in holds for i in range(_STATES)),
        differential=differential,
        relative=get("relative", False) and not differential,
        pose_gate=get("pose_rejection_threshold", one),
        twist_gate=get("twist_rejection_threshold", get("angular_velocity_rejection_threshold", one))
        if not values.get("as_robot_localization", False)
        else get("twist_rejection_threshold", one),
        acceleration_gate=get("linear_acceleration_rejection_threshold", math.inf),
        remove_gravity=get("remove_gravitational_acceleration", False),
        child_frame=get("pose_use_child_frame", False),
    )


def _matrix(values: Mapping[str, Any], key: str, default: np.ndarray, where: str) -> np.ndarray:
    if key not in values:
        return default
    given = np.array(values[key], dtype=float)
    A = np.diag(given) if given.size == _STATES else given.reshape(_STATES, _STATES)
    if not np.allclose(A, A.T, rtol=1e-6, atol=1e-12) or np.linalg.eigvalsh(A)[0] < -1e-9 * np.abs(A).max():
        raise ConfigError(f"{where}: {key} is no covariance; it must be symmetric and positive semidefinite.")
    return 0.5 * (A + A.T)


def _control(values: Mapping[str, Any], sensors: tuple[SensorSettings, ...], where: str) -> ControlSettings:
    """Gather the keys of the control input; an axis whose acceleration is measured is not driven by it."""
    if "control_config" not in values:
        raise ConfigError(
            f"{where}: use_control is true, but control_config is missing; give 6 entries, true or false."
        )
    measured = [any(sensor.mask[12 + i] for sensor in sensors) for i in range(3)] + [False] * 3
    limits = tuple(values.get("acceleration_limits", (1.0,) * 6))
    gains = tuple(values.get("acceleration_gains", (1.0,) * 6))
    return ControlSettings(
        mask=tuple(bool(on) and not known for on, known in zip(values["control_config"], measured, strict=True)),
        limits=limits,
        gains=gains,
        braking_limits=tuple(values.get("deceleration_limits", limits)),
        braking_gains=tuple(values.get("deceleration_gains", gains)),
        timeout=values.get("control_timeout", 0.2),
        stamped=values.get("stamped_control", False),
    )


def _remarks(values: Mapping[str, Any], unknown: list[str]) -> Iterator[str]:
    of_sensors = [f"{name}_{key}" for name, kind in keys.sensors_in(values) for key in keys.SENSOR[kind]]
    for key in unknown:
        near = get_close_matches(key, [*keys.GENERAL, *of_sensors], 1)
        hint = f"; did you mean {near[0]}?" if near else "."
        yield f"{key} is no key of robot_localization and was left out{hint}"
    idle = [key for key in values if keys.has_no_effect(key, values)]
    if idle:
        yield f"Without effect here: {', '.join(idle)}."
    for name, kind in keys.sensors_in(values):
        mask = values.get(f"{name}_config", (False,) * _STATES)
        sensor = _sensor(kind, name.removeprefix(kind), values)
        lost = [keys.STATES[i] for i in range(_STATES) if mask[i] and not sensor.mask[i]]
        if lost:
            yield f"{name}_config asks for {', '.join(lost)}, which messages of {kind} do not hold."
        if not any(sensor.mask):
            yield f"{name} is not fused: {name}_config has no entry that is true."
        if values.get(f"{name}_differential") and values.get(f"{name}_relative"):
            yield f"{name} is both differential and relative; it is taken differentially."
