"""The keys of robot_localization's parameter files: what kind of value each takes, and which have no effect here."""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from longreach.errors import ConfigError

STATES = ("x", "y", "z", "roll", "pitch", "yaw", "vx", "vy", "vz", "vroll", "vpitch", "vyaw", "ax", "ay", "az")
_SENSOR_NAME = re.compile(r"(odom|pose|twist|imu)\d+")
_SENSOR_KEY = re.compile(r"((odom|pose|twist|imu)\d+)_(\w+)")

Check = Callable[[Any], Any]  # returns the value, or raises ValueError with what is wanted


def _flag(value: Any) -> bool:
    if value is True or value is False or (isinstance(value, int) and value in (0, 1)):
        return bool(value)
    raise ValueError("true or false")


def _number(low: float = -math.inf, *, above: bool = False) -> Check:
    wanted = "a finite number" if low == -math.inf else f"a finite number {'above' if above else 'of at least'} {low:g}"

    def check(value: Any) -> float:
        number = _real(value)
        if not math.isfinite(number) or number < low or (above and number == low):
            raise ValueError(wanted)
        return number

    return check


def _real(value: Any) -> float:
    """Return a number; YAML 1.1 takes 1e-9 for a word."""
    if isinstance(value, bool):
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError):
        return math.nan


def _threshold(value: Any) -> float:
    number = _real(value)
    if not number > 0:
        raise ValueError("a number above 0")
    return number


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError("a name")
    return value


def _anything(value: Any) -> Any:
    return value


def _numbers(*lengths: int) -> Check:
    wanted = f"{' or '.join(map(str, lengths))} finite numbers"

    def check(value: Any) -> list[float]:
        numbers = [_real(v) for v in value] if isinstance(value, list) else []
        if len(numbers) not in lengths or not all(map(math.isfinite, numbers)):
            raise ValueError(f"{wanted}, not {len(numbers)}" if numbers and len(numbers) not in lengths else wanted)
        return numbers

    return check


def _flags(length: int) -> Check:
    def check(value: Any) -> list[bool]:
        try:
            flags = [_flag(v) for v in value] if isinstance(value, list) else []
        except ValueError:
            flags = []
        if len(flags) != length:
            raise ValueError(f"{length} entries, each true or false")
        return flags

    return check


def _choice(*names: str) -> Check:
    def check(value: Any) -> str:
        if value not in names:
            raise ValueError(" or ".join(names))
        return value

    return check


def _texts(value: Any) -> list[str]:
    if not isinstance(value, list):
        raise ValueError("a list of PARENT:CHILD=x,y,z,roll,pitch,yaw")
    return [_text(v) for v in value]


_MATRIX = _numbers(225, 15)
GENERAL: Mapping[str, Check] = {
    "frequency": _number(0.0, above=True),
    "sensor_timeout": _number(0.0),
    "two_d_mode": _flag,
    "map_frame": _text,
    "odom_frame": _text,
    "base_link_frame": _text,
    "world_frame": _text,
    "process_noise_covariance": _MATRIX,
    "initial_estimate_covariance": _MATRIX,
    "initial_state": _numbers(15),
    "dynamic_process_noise_covariance": _flag,
    "gravitational_acceleration": _number(),
    "smooth_lagged_data": _flag,
    "history_length": _number(),
    "predict_to_current_time": _flag,
    "use_control": _flag,
    "stamped_control": _flag,
    "control_timeout": _number(0.0),
    "control_config": _flags(6),
    "acceleration_limits": _numbers(6),
    "acceleration_gains": _numbers(6),
    "deceleration_limits": _numbers(6),
    "deceleration_gains": _numbers(6),
    "alpha": _number(0.0, above=True),
    "kappa": _number(-15.0, above=True),
    "beta": _number(),
    "filter": _choice("ekf", "ukf"),
    "as_robot_localization": _flag,
    "transforms": _texts,
    **dict.fromkeys(("transform_time_offset", "transform_timeout"), _number()),
    **dict.fromkeys(("base_link_frame_output", "debug_out_file", "tf_prefix"), _anything),
    **dict.fromkeys(("publish_tf", "publish_acceleration", "print_diagnostics", "debug", "use_sim_time"), _flag),
    **dict.fromkeys(("permit_corrected_publication", "reset_on_time_jump", "disabled_at_startup"), _flag),
    "qos_overrides": _anything,
}
_ANY_SENSOR: Mapping[str, Check] = {"config": _flags(15), "queue_size": _number(0.0), "nodelay": _flag}
_POSE: Mapping[str, Check] = {"differential": _flag, "relative": _flag, "pose_rejection_threshold": _threshold}
SENSOR: Mapping[str, Mapping[str, Check]] = {
    "odom": {**_ANY_SENSOR, **_POSE, "twist_rejection_threshold": _threshold, "pose_use_child_frame": _flag},
    "pose": {**_ANY_SENSOR, **_POSE, "rejection_threshold": _threshold},
    "twist": {**_ANY_SENSOR, "rejection_threshold": _threshold, "twist_rejection_threshold": _threshold},
    "imu": {
        **_ANY_SENSOR,
        **_POSE,
        "twist_rejection_threshold": _threshold,
        "angular_velocity_rejection_threshold": _threshold,
        "linear_acceleration_rejection_threshold": _threshold,
        "remove_gravitational_acceleration": _flag,
    },
}
_IDLE = {"transform_time_offset", "transform_timeout", "base_link_frame_output", "debug_out_file", "tf_prefix"}
_IDLE |= {"publish_tf", "publish_acceleration", "print_diagnostics", "debug", "use_sim_time", "qos_overrides"}
_IDLE |= {"permit_corrected_publication", "reset_on_time_jump", "disabled_at_startup", "beta"}
_CONTROL = {"stamped_control", "control_timeout", "control_config", "acceleration_limits", "acceleration_gains"}
_CONTROL |= {"deceleration_limits", "deceleration_gains"}


def checked(given: Mapping[Any, Any], where: str) -> tuple[dict[str, Any], list[str]]:
    """Return the values of the keys that there are, each as its kind, and the keys that there are not.

    Raises:
        ConfigError: the sentence names the first key with a wrong value, and what it takes.
    """
    values: dict[str, Any] = {}
    unknown = []
    for key, value in given.items():
        check = _check_of(str(key), given)
        if check is None:
            unknown.append(str(key))
        elif value is not None:
            try:
                values[str(key)] = check(value)
            except ValueError as wanted:
                shown = repr(value) if len(repr(value)) < 60 else f"{repr(value)[:57]} …"
                raise ConfigError(f"{where}: {key} is {shown}; it takes {wanted}.") from wanted
    return values, unknown


def _check_of(key: str, given: Mapping[Any, Any]) -> Check | None:
    if key in GENERAL:
        return GENERAL[key]
    if _SENSOR_NAME.fullmatch(key):
        return _text
    match = _SENSOR_KEY.fullmatch(key)
    return SENSOR[match[2]].get(match[3]) if match and match[1] in given else None


def sensors_in(values: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield name and kind of each sensor."""
    for key in values:
        match = _SENSOR_NAME.fullmatch(key)
        if match:
            yield key, match[1]


def has_no_effect(key: str, values: Mapping[str, Any]) -> bool:
    """Whether a key that was given changes nothing, as the other keys stand."""
    match = _SENSOR_KEY.fullmatch(key)
    if match:
        late = match[3] == "angular_velocity_rejection_threshold" and values.get("as_robot_localization", False)
        return match[3] in ("queue_size", "nodelay") or late
    if key in _CONTROL:
        return not values.get("use_control", False)
    if key in ("alpha", "kappa"):
        return values["filter"] == "ekf" or values.get("as_robot_localization", False)
    return key in _IDLE or (key == "history_length" and not values.get("smooth_lagged_data", False))
