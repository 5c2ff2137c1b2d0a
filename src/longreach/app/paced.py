"""Simulated time that passes as fast as the time on the wall, so that a simulated robot can be operated."""

import time

from longreach.control import ticker
from longreach.sim.simulated import Simulated

_BEHIND = 0.1  # further behind the wall than this, the simulation stops catching up [s]; ours


class Paced:
    """Lets a simulation's time pass at the wall's pace: `wait_until` for a loop. Where the machine is too slow it lags.

    What is simulated is computed first and waited for afterwards, so that the wait ends in time.

    lateness: of each return after its time on the wall, which the simulation's own clock does not see; behind: by how
    much that clock has fallen behind the wall's [s].
    """

    def __init__(self, simulated: Simulated) -> None:
        self._simulated, self._ahead = simulated, time.monotonic() - simulated.stamp
        self.lateness, self.late, self.behind = ticker.no_durations(), 0, 0.0

    def __call__(self, stamp: float) -> None:
        """Return when it is `stamp` [s]."""
        self._simulated.advance(max(stamp - self._simulated.stamp, 0.0))
        due = self._ahead + self._simulated.stamp
        time.sleep(max(due - time.monotonic(), 0.0))
        late = max(time.monotonic() - due, 0.0)
        self.lateness = ticker.counted(self.lateness, late)
        self.late += late > ticker.TOLERANCE
        if late > _BEHIND:
            self._ahead += late
            self.behind += late
