"""What `longreach connect` shows of a robot, a line at a time."""

import sys
import time

import numpy as np

from longreach.errors import ConfigError
from longreach.live.client.client import Client

_EVERY = 0.2  # [s]


def numbers(text: str, count: int | None, option: str) -> np.ndarray:
    """Return the numbers in a text with commas between them; count: how many there must be.

    Raises:
        ConfigError: there are not as many, or something else.
    """
    try:
        found = np.array([float(word) for word in text.split(",")])
    except ValueError:
        found = np.zeros(0)
    if len(found) != (count or len(found) or 1) or not np.isfinite(found).all():
        many = "" if count is None else f"{count} "
        raise ConfigError(f"{option} takes {many}numbers with commas between, not {text!r}.")
    return found


def watched(client: Client, duration: float | None) -> None:
    """Show the newest state, over and over on a terminal, until the time is over [s] or somebody interrupts."""
    end = ("\r", "\n") if sys.stdout.isatty() else ("\n", "")
    until = time.monotonic() + (np.inf if duration is None else duration)
    while time.monotonic() < until:
        print(line(client), end=end[0], flush=True)
        time.sleep(min(_EVERY if sys.stdout.isatty() else 1.0, max(until - time.monotonic(), 0.0)))
    print(end=end[1])


def line(client: Client) -> str:
    """Return the newest state in a line."""
    s = client.state
    x, y, theta = s.q[:3].tolist()
    sigma = 1e3 * float(np.sqrt(max(np.trace(s.covariance[:2, :2]), 0.0)))
    delay = 1e3 * float(np.median(client.delays)) if len(client.delays) else 0.0
    return (
        f"{s.stamp:8.2f} s  base {x:7.3f} {y:7.3f} m {np.degrees(theta):7.2f}° (±{sigma:.0f} mm)  "
        f"{s.goal} {100 * s.progress:3.0f} %  loop {1e3 * s.loop_time:.1f} ms  way {delay:.2f} ms  "
        f"clock {client.offset:+.3f} s  lost {client.lost}  {s.holder and f'held by {s.holder}'}  {s.stop or s.limited}"
        f"{'' if s.minds_obstacles or not client.robot.base.stop else '  obstacles not minded'}"
    ).rstrip()
