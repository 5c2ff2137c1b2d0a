"""Configuration as YAML: read and checked against a model, written with every key that ran."""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from longreach.errors import ConfigError
from longreach.robot.description import RobotDescription

Model = TypeVar("Model", bound=BaseModel)


def read_yaml(path: Path) -> Any:
    """Return what a YAML file holds.

    Raises:
        ConfigError: it is not there or is not YAML; the sentence names the line.
    """
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ConfigError(f"{path} is not there.") from error
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} cannot be read as text: {error}.") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark is not None else ""
        raise ConfigError(f"{path}{where}: this is not YAML ({getattr(error, 'problem', None) or error}).") from error


def validated(model: type[Model], values: Any, where: str) -> Model:
    """Return the model with these values, the rest by default; an empty file changes nothing.

    Raises:
        ConfigError: the sentence names the first key that is wrong, its value, and what is allowed.
    """
    if values is None:
        values = {}
    if not isinstance(values, dict):
        raise ConfigError(f"{where}: expected keys and values, found {type(values).__name__} {values!r}.")
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise ConfigError(f"{where}: {_sentence(model, error)}") from error


def _sentence(model: type[BaseModel], error: ValidationError) -> str:
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"] if part not in ("mecanum", "differential", "omni", "ackermann"))
    more = f" ({len(error.errors()) - 1} more keys are wrong.)" if len(error.errors()) > 1 else ""
    if first["type"] == "extra_forbidden":
        known = ", ".join(_keys_at(model, first["loc"][:-1]))
        return f"{key} is not a key here; there are: {known}.{more}"
    if first["type"] == "missing":
        return f"{key} is missing.{more}"
    message = first["msg"].removeprefix("Value error, ")
    if not key:
        return f"{message}.{more}"
    return f"{key} is {first['input']!r}: {message[:1].lower()}{message[1:]}.{more}"


def _keys_at(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the keys of the model that stands at a place inside another."""
    inside: list[type[BaseModel]] = [model]
    for part in location:
        tagged = [m for m in inside if "kind" in m.model_fields and m.model_fields["kind"].default == part]
        fields = [m.model_fields[part] for m in inside if part in m.model_fields]
        inside = tagged or [m for field in fields for m in _models_in(field.annotation)] or inside
    return list(inside[0].model_fields)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """Return the models in an annotation such as `A | B | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]


def read_config(path: Path, model: type[Model]) -> Model:
    """Read a YAML file that changes some of a model's defaults."""
    return validated(model, read_yaml(path), str(path))


def to_yaml(config: BaseModel) -> str:
    """Return every key and value of a configuration as YAML."""
    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False, allow_unicode=True, width=120)


def shipped_descriptions() -> list[str]:
    """Return the names of the robots that come with the package."""
    folder = files("longreach.robot").joinpath("descriptions")
    return sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def description_file(robot: str | Path) -> Path:
    """Return the YAML file of a shipped robot, or the path given.

    Raises:
        ConfigError: there is neither; the sentence names the shipped ones.
    """
    shipped = Path(str(files("longreach.robot").joinpath("descriptions"))) / f"{robot}.yaml"
    if str(robot) in shipped_descriptions():
        return shipped
    path = Path(robot)
    if not path.is_file():
        raise ConfigError(
            f"{robot} is neither a robot that longreach knows ({', '.join(shipped_descriptions())}) nor a YAML file."
        )
    return path


def assuming(description: RobotDescription, assumed: Mapping[str, str] | None) -> RobotDescription:
    """Return a description with some of its keys, such as lidar.mount.yaw, set to other values, as YAML has them.

    Raises:
        ConfigError: there is no such key, or it cannot have the value.
    """
    values = description.model_dump(exclude_unset=True)
    for name, value in (assumed or {}).items():
        *above, key = name.split(".")
        inside = values
        for part in above:
            inside[part] = dict(inside.get(part) or {})
            inside = inside[part]
        inside[key] = yaml.safe_load(value)
    return validated(RobotDescription, values, "--assume") if assumed else description


def load_description(robot: str | Path) -> RobotDescription:
    """Return the description of a shipped robot by its name, or of the one in a YAML file."""
    path = description_file(robot)
    return read_config(path, RobotDescription)
