"""One joint between two links, wherever it was described: the common ground of DH tables and URDF."""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from longreach.errors import ModelError
from longreach.geometry import so3

Kind = Literal["fixed", "revolute", "continuous", "prismatic", "planar", "floating"]
_IDENTITY = np.eye(4)
_IDENTITY.flags.writeable = False


@dataclass(frozen=True)
class Limits:
    """What one joint can do [rad or m, and per s, per s²; N·m or N]; inf: not known."""

    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    acceleration: float = math.inf
    effort: float = math.inf

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ModelError(
                f"A joint's lower limit {self.lower:g} is not below its upper limit {self.upper:g}; exchange them."
            )
        if not (self.velocity > 0 and self.acceleration > 0 and self.effort >= 0):
            raise ModelError(
                f"A joint's velocity {self.velocity:g} and acceleration {self.acceleration:g} must be above 0, "
                f"and its effort {self.effort:g} not below."
            )


@dataclass(frozen=True, eq=False)
class Joint:
    """A child link that stands in its parent link at `origin` and moves along or about `axis`, seen from there.

    mimic: the joint that it follows. fault: why it can be no part of a chain, a sentence, or nothing.
    """

    name: str
    kind: Kind
    parent: str
    child: str
    origin: Float[np.ndarray, "4 4"] = field(default_factory=lambda: _IDENTITY)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    limits: Limits = Limits()
    mimic: str | None = None
    fault: str = ""

    @property
    def moves(self) -> bool:
        """Whether a number of q belongs to it; one with a fault may move."""
        return self.kind != "fixed" or bool(self.fault)

    @property
    def driven(self) -> bool:
        """Whether it turns or slides, as a motor can make it."""
        return self.kind in ("revolute", "continuous", "prismatic") and not self.fault

    def at(self, position: float) -> Float[np.ndarray, "4 4"]:
        """Return T_parent_child at a position [rad or m]."""
        T, axis = np.array(self.origin), np.array(self.axis)
        if self.kind in ("revolute", "continuous"):
            T[:3, :3] = T[:3, :3] @ so3.exp(axis * position)
        elif self.kind == "prismatic":
            T[:3, 3] += T[:3, :3] @ axis * position
        return T
