"""What a robot shall follow: where its tool, its base or both shall be, and when."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from longreach.errors import PlanningError

_ROTATION = 1e-6  # how far RᵀR may be from I: poses are read from text


@dataclass(frozen=True, eq=False)
class Reference:
    """Poses to follow, checked once; arrays are read-only.

    stamps: increasing (n,) [s]. tool: T_world_tool (n, 4, 4), or None where the tool is free. base: [x, y, θ] (n, 3)
    [m, m, rad], or None where the base is free.

    Raises:
        PlanningError: nothing to follow, a shape, a number that is not finite, stamps that do not increase, or a matrix
            that is no rigid motion.
    """

    stamps: Float[np.ndarray, " n"]
    tool: Float[np.ndarray, "n 4 4"] | None = None
    base: Float[np.ndarray, "n 3"] | None = None

    def __post_init__(self) -> None:
        n = len(self.stamps)
        if n == 0:
            raise PlanningError("The reference is empty; give it at least one waypoint.")
        if self.tool is None and self.base is None:
            raise PlanningError("The reference has neither tool poses nor base poses; give it at least one of them.")
        for name, shape in {"stamps": (n,), "tool": (n, 4, 4), "base": (n, 3)}.items():
            value = getattr(self, name)
            if value is None:
                continue
            array = np.array(value, dtype=float)
            if array.shape != shape:
                raise PlanningError(f"The reference's {name} has shape {array.shape}, expected {shape}.")
            if not np.all(np.isfinite(array)):
                row = int(np.flatnonzero(~np.isfinite(array.reshape(n, -1)).all(axis=1))[0])
                raise PlanningError(f"The reference's {name} must be finite; row {row} is not.")
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if np.any(np.diff(self.stamps) <= 0):
            raise PlanningError("The reference's stamps must increase from waypoint to waypoint.")
        if self.tool is not None:
            check_rigid(self.tool, "The reference's tool")

    def __len__(self) -> int:
        return len(self.stamps)


def check_rigid(T: Float[np.ndarray, "n 4 4"], what: str) -> None:
    """Raise a PlanningError that names the first of the matrices that is no rigid motion."""
    R = T[:, :3, :3]
    skewed = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2)) > _ROTATION
    wrong = skewed | (np.linalg.det(R) < 0) | np.any(T[:, 3] != [0.0, 0.0, 0.0, 1.0], axis=1)
    if np.any(wrong):
        row = f" at row {int(np.argmax(wrong))}" if len(T) > 1 else ""
        raise PlanningError(
            f"{what}{row} is no rigid motion: its upper left 3 x 3 must be a rotation and its last row 0 0 0 1."
        )
