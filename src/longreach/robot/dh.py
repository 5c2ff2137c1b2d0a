"""Standard Denavit-Hartenberg tables, the nominal ones or those a calibration found."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from longreach.errors import ModelError
from longreach.geometry import se3, so3
from longreach.robot.joint import Joint, Limits

_Size = Annotated[float, Field(gt=0)]


class DhRow(BaseModel):
    """One row of (3.7): Rz(θ) Tz(d) Tx(a) Rx(α); the joint's q is added to θ (revolute) or d (prismatic)."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    d: float = Field(default=0.0, description="Along the old z [m].")
    theta: float = Field(default=0.0, description="About the old z [rad].")
    a: float = Field(default=0.0, description="Along the new x [m].")
    alpha: float = Field(default=0.0, description="About the new x [rad].")
    joint: Literal["revolute", "prismatic", "fixed"] = Field(default="revolute", description="What q does here.")
    name: str | None = Field(default=None, description="The joint's name; None: joint_ and the row's number from 1.")
    frame: str | None = Field(default=None, description="Name of the frame at the row's end; None: link_ likewise.")
    lower: float | None = Field(default=None, description="Least q [rad or m]; None: no limit.")
    upper: float | None = Field(default=None, description="Largest q [rad or m]; None: no limit.")
    velocity: _Size | None = Field(default=None, description="Top speed [rad/s or m/s]; None: not known.")
    acceleration: _Size | None = Field(default=None, description="Hardest acceleration [rad/s² or m/s²]; likewise.")
    effort: _Size | None = Field(default=None, description="Largest torque or force [N·m or N]; likewise.")

    def limits(self) -> Limits:
        """Return what the joint can do."""
        given = {name: getattr(self, name) for name in ("lower", "upper", "velocity", "acceleration", "effort")}
        return Limits(**{name: value for name, value in given.items() if value is not None})


def _screw(angle: float, length: float, axis: int) -> np.ndarray:
    """Return the turn about and the shift along the x (0) or z (2) axis."""
    roll, yaw = (angle, 0.0) if axis == 0 else (0.0, angle)
    p = np.zeros(3)
    p[axis] = length
    return se3.from_rotation_translation(so3.from_roll_pitch_yaw(roll, 0.0, yaw), p)


def joints_of(rows: Sequence[DhRow], root: str) -> list[Joint]:
    """Return the joints of a table whose first row starts at the link `root`.

    A row makes two: the moving one (if it moves) with what of θ and d comes before it, and a fixed one with the rest.
    """
    if not rows:
        raise ModelError("A DH table needs at least one row.")
    joints, parent = [], root
    for number, row in enumerate(rows, start=1):
        name, end = row.name or f"joint_{number}", row.frame or f"link_{number}"
        rest = _screw(row.alpha, row.a, axis=0)
        if row.joint == "fixed":
            rest = _screw(row.theta, row.d, axis=2) @ rest
        else:
            turns = row.joint == "revolute"  # z is the joint's own axis: what it does not move may stand on either side
            before = _screw(row.theta, 0.0, axis=2) if turns else _screw(0.0, row.d, axis=2)
            rest = (_screw(0.0, row.d, axis=2) if turns else _screw(row.theta, 0.0, axis=2)) @ rest
            moving = f"{name.removesuffix('_joint')}_link"
            joints.append(Joint(name, row.joint, parent, moving, before, limits=row.limits()))
            parent = moving
        joints.append(Joint(f"{name}_fixed", "fixed", parent, end, rest))
        parent = end
    return joints


def rows_of(numbers: Sequence[Sequence[Any]]) -> list[DhRow]:
    """Return rows from plain (d, θ, a, α) or (d, θ, a, α, "revolute" | "prismatic" | "fixed").

    >>> rows_of([(0.1273, 0, 0, np.pi / 2), (0, 0, -0.612, 0, "prismatic")])[1].joint
    'prismatic'
    """
    keys = ("d", "theta", "a", "alpha", "joint")
    return [DhRow.model_validate(dict(zip(keys, row, strict=False))) for row in numbers]
