"""Stamped poses of the base over time, with covariance, and interpolation on SE(2)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from longreach.errors import LongreachError
from longreach.geometry import se2

# The shortest step of a repaired stretch, as a part of its even step. Measured on the Intel log: with 0.5 the robot's
# speed there stays below 1.7 m/s; with 0.1 it reaches 7 m/s, without it 700 m/s. Larger values move stamps further.
_STEP = 0.5


def _repair(stretch: np.ndarray, before: float, after: float) -> np.ndarray:
    """Return a clock for stamps that are out of order, all of them between the good stamps `before` and `after`.

    It is the least-squares fit to the stamps (isotonic regression: Ayer et al. 1955) whose steps, those to the two good
    stamps included, are at least `_STEP` of even ones. With `step` taken off every row that is the plain regression.
    """
    from scipy.optimize import isotonic_regression  # here, for it takes long to import and few recordings need it

    n = len(stretch)
    low = before if np.isfinite(before) else stretch.min()
    high = after if np.isfinite(after) else stretch.max()
    step = _STEP * ((high - low) or 1.0) / (n + 1)  # all equal and nothing around them: 1 s
    ramp = step * np.arange(n)
    wanted = stretch - low - ramp  # from low on, for stamps since 1970 leave few digits behind the point
    fit = np.clip(isotonic_regression(wanted).x, before + step - low, after - step - ramp[-1] - low)
    return np.where(fit == wanted, stretch, low + fit + ramp)


def monotone_clock(stamps: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return a strictly increasing clock [s] as near as can be to stamps that may run backwards.

    The order of the stamps is the order of motion. A stamp later than all before it and earlier than all after it is
    kept bit for bit; each stretch of others is fitted into the room between the two good stamps around it.
    """
    stamps = np.asarray(stamps, dtype=float)
    if not np.all(np.isfinite(stamps)):
        raise LongreachError("Stamps must be finite numbers of seconds to make a clock of them.")
    clock = stamps.copy()
    if np.all(np.diff(stamps) > 0):
        return clock
    latest_before = np.maximum.accumulate(np.concatenate(([-np.inf], stamps[:-1])))
    earliest_after = np.minimum.accumulate(np.concatenate(([np.inf], stamps[:0:-1])))[::-1]
    astray = (stamps <= latest_before) | (stamps >= earliest_after)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], astray, [False]))))
    for start, stop in edges.reshape(-1, 2).tolist():
        before = stamps[start - 1] if start > 0 else -np.inf
        after = stamps[stop] if stop < len(stamps) else np.inf
        clock[start:stop] = _repair(stamps[start:stop], before, after)
    if not np.all(np.diff(clock) > 0):
        raise LongreachError("The stamps are too close together to be put in order.")
    return clock


@dataclass(frozen=True, eq=False)
class PoseTrajectory:
    """Poses of the base [m, m, rad] in the order of motion.

    stamps: as recorded [s]; they may run backwards where a recording's do. clock: never backwards [s], what time
    differences and interpolation use (default: `monotone_clock(stamps)`). covariance: of ξ = log(mean⁻¹ · truth),
    order x y θ in the body frame. has_heading: False where only positions are known (θ is then 0 and means nothing).
    """

    stamps: Float[np.ndarray, " n"]
    poses: Float[np.ndarray, "n 3"]
    covariance: Float[np.ndarray, "n 3 3"] | None = None
    clock: Float[np.ndarray, " n"] = None  # type: ignore[assignment]
    has_heading: bool = True

    def __post_init__(self) -> None:
        n = len(self.stamps)
        clock = monotone_clock(self.stamps) if self.clock is None else self.clock
        arrays = {"stamps": (self.stamps, (n,)), "poses": (self.poses, (n, 3)), "clock": (clock, (n,))}
        if self.covariance is not None:
            arrays["covariance"] = (self.covariance, (n, 3, 3))
        for name, (value, shape) in arrays.items():
            array = np.array(value, dtype=float)
            if array.shape != shape:
                raise LongreachError(f"A trajectory's {name} has shape {array.shape}, expected {shape}.")
            if not np.all(np.isfinite(array)):
                raise LongreachError(f"A trajectory's {name} must be finite.")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if np.any(np.diff(self.clock) < 0):
            raise LongreachError(
                "A trajectory's clock must not run backwards; leave it out to have the stamps repaired."
            )

    def __len__(self) -> int:
        return len(self.stamps)

    @cached_property
    def _by_stamp(self) -> tuple[np.ndarray, np.ndarray]:
        order = np.argsort(self.stamps, kind="stable")
        return self.stamps[order], order

    def clock_at(self, stamps: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Return the clock [s] at stamps as recorded: of the nearest row, plus what the stamp lies away from it."""
        if len(self) == 0:
            raise LongreachError("An empty trajectory has no clock.")
        known, order = self._by_stamp
        right = np.clip(np.searchsorted(known, stamps), 0, len(known) - 1)
        left = np.maximum(right - 1, 0)
        nearest = order[np.where(np.abs(known[left] - stamps) <= np.abs(known[right] - stamps), left, right)]
        return self.clock[nearest] + (stamps - self.stamps[nearest])

    def at(
        self, clock: Float[np.ndarray, " m"], longest_gap: float = np.inf
    ) -> tuple[Float[np.ndarray, "m 3"], Bool[np.ndarray, " m"]]:
        """Interpolate along the SE(2) geodesic between the two neighbouring rows.

        Arguments: clock [s]; longest_gap [s] between the two rows that may be bridged.
        Returns: poses (m, 3), and (m,) which of them are known: inside the trajectory and in no longer gap. Those that
        are not known hold the nearest row's pose.
        """
        clock = np.asarray(clock, dtype=float)
        if len(self) == 0:
            return np.zeros((len(clock), 3)), np.zeros(len(clock), dtype=bool)
        i = np.clip(np.searchsorted(self.clock, clock, side="right") - 1, 0, len(self) - 1)
        j = np.minimum(i + 1, len(self) - 1)
        gap = self.clock[j] - self.clock[i]
        fraction = np.where(gap > 0, (clock - self.clock[i]) / np.where(gap > 0, gap, 1.0), 0.0)
        inside = (clock >= self.clock[0]) & (clock <= self.clock[-1])
        known = inside & ((gap <= longest_gap) | (fraction == 0.0))
        fraction = np.where(inside, np.clip(fraction, 0.0, 1.0), 0.0)
        return se2.interpolate(self.poses[i], self.poses[j], fraction), known
