"""Stamped configurations of a robot over time: what a planner gives and a controller follows."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from longreach.errors import PlanningError


@dataclass(frozen=True, eq=False)
class TaskReport:
    """What became of one task along a trajectory.

    linear, angular (n,): the size of its error in each row [m], [rad]; unmet (n,): where that is too much; reason: a
    sentence about the worst row, or that there is none.
    """

    name: str
    linear: Float[np.ndarray, " n"]
    angular: Float[np.ndarray, " n"]
    unmet: Bool[np.ndarray, " n"]
    reason: str


@dataclass(frozen=True, eq=False)
class ConfigurationTrajectory:
    """Configurations of all joints, base first, checked once; arrays are read-only.

    stamps: increasing (n,) [s]. q: (n, dof) [rad, or m where prismatic]; angles are not wrapped, neighbours are near.
    joint_names: (dof,), or empty where nobody needs them. velocities: q̇ (n, dof) [rad/s, m/s]; where not given, those
    of the parabola through each row and its two neighbours. reports: what became of the tasks it was planned for.

    Raises:
        PlanningError: it is empty, a shape, a number that is not finite, or stamps that do not increase.
    """

    stamps: Float[np.ndarray, " n"]
    q: Float[np.ndarray, "n dof"]
    joint_names: tuple[str, ...] = ()
    velocities: Float[np.ndarray, "n dof"] = None  # type: ignore[assignment]
    reports: tuple[TaskReport, ...] = ()

    def __post_init__(self) -> None:
        if len(self.stamps) == 0:
            raise PlanningError("A trajectory of configurations needs at least one row.")
        shape = (len(self.stamps), self.q.shape[1])
        self._freeze("stamps", self.stamps, shape[:1])
        if np.any(np.diff(self.stamps) <= 0):
            raise PlanningError("The stamps of a trajectory of configurations must increase from row to row.")
        self._freeze("q", self.q, shape)
        velocities = _slopes(self.stamps, self.q) if self.velocities is None else self.velocities
        self._freeze("velocities", velocities, shape)
        if self.joint_names and len(self.joint_names) != shape[1]:
            raise PlanningError(f"There are {len(self.joint_names)} joint names for {shape[1]} joints.")

    def _freeze(self, name: str, value: np.ndarray, shape: tuple[int, ...]) -> None:
        array = np.array(value, dtype=float, order="C")
        if array.shape != shape:
            raise PlanningError(f"A trajectory's {name} has shape {array.shape}, expected {shape}.")
        if not np.all(np.isfinite(array)):
            raise PlanningError(f"A trajectory's {name} must be finite.")
        array.flags.writeable = False
        object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def duration(self) -> float:
        """From the first row to the last [s]."""
        return float(self.stamps[-1] - self.stamps[0])


def _slopes(stamps: np.ndarray, q: np.ndarray) -> np.ndarray:
    if len(stamps) == 1:
        return np.zeros_like(q, dtype=float)
    dt = np.diff(stamps)[:, None]
    chords = np.diff(q, axis=0) / dt
    if len(stamps) == 2:
        return np.repeat(chords, 2, axis=0)
    out = np.empty_like(q, dtype=float)
    out[1:-1] = (chords[:-1] * dt[1:] + chords[1:] * dt[:-1]) / (dt[1:] + dt[:-1])
    out[0], out[-1] = 2.0 * chords[0] - out[1], 2.0 * chords[-1] - out[-2]
    return out
