"""Stamped poses of the base over time, with covariance, and interpolation on SE(2)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from longreach.errors import LongreachError
from longreach.geometry import se2


def monotone_clock(stamps: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return a strictly increasing clock [s] as near as can be to stamps that may run backwards.

    The order of the stamps is the order of motion. Stamps that increase are kept bit for bit; each run of stamps that
    are out of order or equal is replaced by its isotonic regression (the least-squares nondecreasing fit, pool adjacent
    violators: Ayer et al. 1955), spread evenly inside the room that its neighbours leave.
    """
    stamps = np.asarray(stamps, dtype=float)
    if len(stamps) < 2 or np.all(np.diff(stamps) > 0):
        return stamps.copy()
    level: list[float] = []
    size: list[int] = []
    for stamp in stamps.tolist():
        level.append(stamp)
        size.append(1)
        while len(level) > 1 and level[-2] >= level[-1]:
            n = size[-2] + size[-1]
            level[-2:] = [(level[-2] * size[-2] + level[-1] * size[-1]) / n]
            size[-2:] = [n]
    clock = np.empty_like(stamps)
    k = 0
    for i, n in enumerate(size):
        if n == 1:
            clock[k] = stamps[k]
        else:
            # half the way to either neighbour; a block at an end takes the other side's room, alone it takes 1 s
            before = level[i] - level[i - 1] if i > 0 else (level[i + 1] - level[i] if i + 1 < len(level) else 1.0)
            after = level[i + 1] - level[i] if i + 1 < len(level) else before
            half = 0.5 * min(before, after)
            clock[k : k + n] = level[i] + half * (2 * np.arange(n) + 1 - n) / n
        k += n
    if not np.all(np.diff(clock) > 0):
        raise LongreachError("The stamps are too close together to be put in order.")
    return clock


@dataclass(frozen=True, eq=False)
class PoseTrajectory:
    """Poses of the base [m, m, rad] in the order of motion.

    stamps: as recorded [s]; they may run backwards where a recording's do. clock: strictly increasing [s], what time
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
