"""How a process that talks with a robot answers in time, whatever else is in it."""

import gc
import sys

_SWITCH = 5e-4  # for how long a thread computes before another has its turn [s]; Python's own is ten times as long


def apply_realtime_settings() -> None:
    """Let garbage collection pass over all that is there now, and threads take turns more often.

    To look at all that numba and the like have loaded takes half a second, in which no other thread runs.
    """
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(_SWITCH)
