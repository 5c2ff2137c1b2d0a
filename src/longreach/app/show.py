"""What is shown of a simulated run while it goes on: a film, a window, or both."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float

from longreach.errors import ConfigError
from longreach.sim.physics import Simulation
from longreach.sim.simulated import Simulated
from longreach.sim.video import Film
from longreach.sim.viewer import View, view

_GOAL, _DRAWN = (0.55, 0.55, 0.6), (0.84, 0.37, 0.0)


@dataclass
class Show:
    """Call it at every tick. goal: the tool's path as planned, points (n, 3) [m]; beside it what the tool has drawn."""

    film: Film | None
    window: bool
    goal: Float[np.ndarray, "n 3"] | None
    stack: ExitStack
    drawn: list[np.ndarray] = field(default_factory=list)
    opened: View | None = None

    def __call__(self, simulated: Simulated) -> None:
        """Take a picture if it is time for one, and bring the window up to date."""
        film = self.film
        if film is not None and simulated.stamp >= film.due - 1e-9:
            self.drawn.append(simulated.truth().tool[:3, 3])
            trails = [] if self.goal is None else [(_GOAL, self.goal)]
            film.watch(simulated, [*trails, (_DRAWN, np.array(self.drawn))])
        if self.window:
            if not isinstance(simulated, Simulation):
                raise ConfigError("Only a simulation with physics has a window.")
            self.opened = self.opened or self.stack.enter_context(view(simulated))
            self.opened.show()

    def write(self, folder: Path) -> None:
        """Write the film, if there is one, as drive.gif."""
        if self.film is not None:
            self.film.write(folder / "drive.gif")


@contextmanager
def show(video: bool, window: bool, goal: Float[np.ndarray, "n 3"] | None = None) -> Iterator[Show]:
    """Return what shows a run; a window closes at the end."""
    with ExitStack() as stack:
        yield Show(Film() if video else None, window, goal, stack)
