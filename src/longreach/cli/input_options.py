"""Options of how files are read, common to the verbs that read some."""

from collections.abc import Sequence
from enum import StrEnum

import typer

from longreach.errors import ConfigError

TOPIC = typer.Option([], help="Topic of a sensor in place of the description's, as lidar=/scan; may be repeated.")

ASSUME: list[str] = typer.Option(
    [], metavar="NAME=VALUE", help="A key of the description that the recording cannot say, as lidar.mount.yaw=3.14."
)


class Clock(StrEnum):
    """What stamps readings."""

    header = "header"
    record = "record"


CLOCK = typer.Option(Clock.header, help="What stamps readings of a bag: their headers, or the times of recording.")


def named_values(option: str, given: Sequence[str], example: str) -> dict[str, str]:
    """Return name → value of an option as NAME=VALUE that may be repeated.

    Raises:
        ConfigError: one is not of that form, or two have the same name.
    """
    values: dict[str, str] = {}
    for text in given:
        name, _, value = (part.strip() for part in text.partition("="))
        if not name or not value:
            raise ConfigError(f"{option} {text} is not of the form NAME=VALUE, as {example}.")
        if name in values:
            raise ConfigError(f"{option} is given twice for {name}; give it once.")
        values[name] = value
    return values
