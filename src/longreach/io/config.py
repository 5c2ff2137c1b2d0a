"""Configuration as YAML: read and checked against a model, written with every key that ran."""

from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

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
    key = ".".join(str(part) for part in first["loc"] if part not in ("mecanum", "differential"))
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
    for part in location:
        field = model.model_fields.get(str(part))
        inside = getattr(field, "annotation", None)
        for candidate in (inside, *getattr(inside, "__args__", ())):
            if isinstance(candidate, type) and issubclass(candidate, BaseModel):
                model = candidate
    return list(model.model_fields)


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


def load_description(robot: str | Path) -> RobotDescription:
    """Return the description of a shipped robot by its name, or of the one in a YAML file."""
    path = description_file(robot)
    return read_config(path, RobotDescription)
