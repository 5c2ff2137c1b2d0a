"""Simulated time that passes as fast as the time on the wall, so that a simulated robot can be operated."""

import time

from longreach.sim.simulated import Simulated

_BEHIND = 0.1  # further behind the wall than this, the simulation stops catching up [s]; ours


class Paced:
    """Lets a simulation's time pass at the wall's pace: `wait_until` for a loop. Where the machine is too slow it lags.

    What is simulated is computed first and waited for afterwards, so that the wait ends in time.
    """

    def __init__(self, simulated: Simulated) -> None:
        self._simulated, self._ahead = simulated, time.monotonic() - simulated.stamp

    def __call__(self, stamp: float) -> None:
        """Return when it is `stamp` [s]."""
        self._simulated.advance(max(stamp - self._simulated.stamp, 0.0))
        left = self._ahead + self._simulated.stamp - time.monotonic()
        if left > 0.0:
            time.sleep(left)
        elif left < -_BEHIND:
            self._ahead -= left
