"""Has the base met something? What it was commanded, what its wheels turn, and how it moves, over the last second.

Wheels that turn while the base stands push against something; wheels that stand while they are commanded are held.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_EVERY, _WINDOW = 0.1, 10  # between two samples [s], and how many make the time that is looked at
_STREAK = 5  # samples in a row that must say so: a driver's lag of 0.3 s is none
_LEAST, _PART = 0.1, 0.25  # of a way that counts [m], and the part of it below which the other stands; ours


class ContactState(NamedTuple):
    """Samples of time [s] and positions (6,) [m]: x, y as commanded, by the wheels, as estimated; streaks of both."""

    samples: tuple[tuple[float, Float[np.ndarray, "6"]], ...] = ()
    pushing: int = 0
    held: int = 0

    @property
    def reason(self) -> str:
        """What the base has met, as a sentence; empty where it has met nothing."""
        if self.pushing >= _STREAK:
            return "The base pushes against something: its wheels turn, but it does not move."
        if self.held >= _STREAK:
            return "The base is held by something: its wheels do not turn as they are commanded."
        return ""


NOTHING = ContactState()


def step(
    state: ContactState,
    now: float,
    commanded: Float[np.ndarray, "3"],
    wheels: Float[np.ndarray, "3"],
    estimated: Float[np.ndarray, "3"],
) -> ContactState:
    """Take where the base is at `now` [s] as it was commanded, by its wheels alone, and as estimated; poses (3,)."""
    if state.samples and now - state.samples[-1][0] < _EVERY - 1e-6:
        return state
    sample = (now, np.concatenate([commanded[:2], wheels[:2], estimated[:2]]))
    samples = (*state.samples[-_WINDOW:], sample)
    if len(samples) <= _WINDOW:
        return ContactState(samples)
    away = sample[1] - samples[0][1]
    asked, turned, moved = np.hypot(away[::2], away[1::2]).tolist()
    pushing = state.pushing + 1 if turned > _LEAST and moved < _PART * turned else 0
    held = state.held + 1 if asked > _LEAST and turned < _PART * asked else 0
    return ContactState(samples, pushing, held)
