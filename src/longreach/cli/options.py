"""Options that several verbs have: secrets of the network, and how long something lasts."""

import math
import os
from pathlib import Path

from longreach.errors import ConfigError

TOKEN, WATCHER_TOKEN = "LONGREACH_TOKEN", "LONGREACH_WATCHER_TOKEN"


def read_token(file: Path | None, variable: str = TOKEN) -> str | None:
    """Return the first line of a file that its owner alone can read, else an environment variable, else None.

    On a command line all of the machine could read it.

    Raises:
        ConfigError: others can read the file, or there is nothing in its first line.
    """
    if file is None:
        return os.environ.get(variable) or None
    if file.stat().st_mode & 0o077:
        raise ConfigError(f"Others can read the token in {file}; run: chmod 600 {file}")
    token = file.read_text(encoding="utf-8", errors="replace").partition("\n")[0].strip()
    if not token:
        raise ConfigError(f"The first line of {file} is empty; write the token there.")
    return token


def check_duration(duration: float | None) -> None:
    """Raise a ConfigError where --duration is no number of seconds; None is for ever."""
    if duration is not None and not 0.0 <= duration < math.inf:
        raise ConfigError(f"--duration is {duration:g}; give a number of seconds, 0 or more, or leave it out.")
