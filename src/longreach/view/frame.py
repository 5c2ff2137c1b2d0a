"""What a page shows: one frame of a robot, and a recorded run as many of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from longreach.robot.mobile_manipulator import MobileManipulator


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame, all in map's frame; what is not known is None.

    q (n,): base first, as estimated [m, m, rad, rad …]. covariance (3, 3) of the base's error ξ, in its own frame.
    wheels, truth (3,): where the wheels alone say the base is, and where it really is. tool_truth (4, 4).
    scan (k, 2): the returns of the newest sweep [m], in the base's frame when it was taken; scan_pose (3,): where that
    was, None where q says it. joints: fingers and wheels by the names of their joints [rad], as far as they are known.
    """

    q: Float[np.ndarray, " n"]
    covariance: Float[np.ndarray, "3 3"] | None = None
    wheels: Float[np.ndarray, "3"] | None = None
    truth: Float[np.ndarray, "3"] | None = None
    tool_truth: Float[np.ndarray, "4 4"] | None = None
    scan: Float[np.ndarray, "k 2"] | None = None
    scan_pose: Float[np.ndarray, "3"] | None = None
    joints: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Curve:
    """A line of a plot: its name, colour, and values (n,) at the run's times."""

    name: str
    colour: str
    values: Float[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class Plot:
    """Curves over time that share an axis, which is named with its unit; lowest and highest what it shows."""

    title: str
    curves: Sequence[Curve]
    lowest: float
    highest: float


@dataclass(frozen=True, eq=False)
class Run:
    """A recorded run on an even grid of times.

    times (n,): since the start [s]. map_points (m, 2): where the scans' returns lie [m], and map_times (m,) since when
    they are known [s], increasing. paths: by name points (k, 3) [m] with their times (k,) [s]; plans: by name (k, 3).
    """

    name: str
    robot: MobileManipulator
    times: Float[np.ndarray, " n"]
    frames: Sequence[Frame]
    map_points: Float[np.ndarray, "m 2"]
    map_times: Float[np.ndarray, " m"]
    paths: Mapping[str, tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k 3"]]]
    plans: Mapping[str, Float[np.ndarray, "j 3"]]
    plots: Sequence[Plot]

    @property
    def duration(self) -> float:
        """How long it took [s]."""
        return float(self.times[-1])

    @property
    def shown(self) -> list[str]:
        """What of the legend's names there is."""
        first = self.frames[0]
        there = {"estimate": True, "wheels": first.wheels is not None, "truth": first.truth is not None}
        there |= {"scan": first.scan is not None, "map": len(self.map_points) > 0}
        there |= dict.fromkeys((*self.paths, *self.plans), True)
        return [name for name, yes in there.items() if yes]

    def index(self, time: float) -> int:
        """Return which frame stands at a time [s]."""
        return int(np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(self.times) - 1))
