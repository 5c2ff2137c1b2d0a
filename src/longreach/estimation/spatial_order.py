"""Which readings can be believed by their stamps, and in what order they are taken."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

_AFTER = 10  # messages that came in next: by their median it is told whether a stamp lies ahead


class Arrival(NamedTuple):
    """By reading, in the order in which they came in: too late for the history, and ahead of the clock."""

    late: Bool[np.ndarray, " n"]
    ahead: Bool[np.ndarray, " n"]


def judge(stamps: Float[np.ndarray, " n"], history: float) -> Arrival:
    """Tell readings that came in more than `history` [s] late, and stamps further ahead than that of what came next.

    A wrong clock stands alone, whatever comes after a pause in the recording does not. A late reading is taken where it
    belongs, as if the filter went back to it; one from the future is left out and holds up nothing.
    """
    n = len(stamps)
    ahead = np.zeros(n, dtype=bool)
    whole = max(n - _AFTER, 0)  # so many have all that come after
    if whole:
        after = np.lib.stride_tricks.sliding_window_view(stamps[1:], _AFTER)
        ahead[:whole] = stamps[:whole] > np.median(after, axis=1) + history
    for i in range(whole, n - 1):
        ahead[i] = stamps[i] > np.median(stamps[i + 1 :]) + history
    if n > 2:  # nothing came after the last
        others = np.sort(stamps[:-1][~ahead[:-1]])
        longest = float(np.diff(others).max(initial=0.0))
        ahead[-1] = stamps[-1] > others[-1] + longest + history
    latest = np.maximum.accumulate(np.where(ahead, -np.inf, stamps))
    return Arrival(~ahead & (latest - stamps > history), ahead)
