"""A window on a simulation, where there is a screen."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from longreach.errors import ConfigError
from longreach.sim.mujoco_model import engine
from longreach.sim.physics import Simulation


class View:
    """An open window; `show` brings it up to date, `closed` tells whether the user has closed it."""

    def __init__(self, window: Any, simulation: Simulation) -> None:
        self._window, self._simulation = window, simulation

    @property
    def closed(self) -> bool:
        """Whether the user has closed the window."""
        return not self._window.is_running()

    def show(self) -> None:
        """Show what is now."""
        if not self.closed:
            self._window.sync()


@contextmanager
def view(simulation: Simulation) -> Iterator[View]:
    """Open MuJoCo's window on a simulation, whose camera follows the mouse.

    Raises:
        ConfigError: there is no screen, or no window can be opened on it.
    """
    no_screen = not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    if sys.platform == "linux" and no_screen:
        raise ConfigError("There is no screen for a window; leave --view out, or take --video to get a film instead.")
    model, data = simulation.engine_state()
    try:
        window = engine("viewer").launch_passive(model, data, show_left_ui=False, show_right_ui=False)
    except Exception as error:  # whatever the window system raises
        raise ConfigError(f"No window can be opened ({error}); take --video to get a film instead.") from error
    with window:
        yield View(window, simulation)
