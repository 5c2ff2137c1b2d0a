"""Wheeled bases: body twist from wheel speeds and back.

A base is three constant matrices over its wheels' speeds w [rad/s], in the order of `wheel_names`:
twist = forward_matrix @ w, w = inverse_matrix @ twist, and residual_matrix @ w = 0 while every wheel rolls.
"""

from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, model_validator

Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class _Wheeled(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    wheel_radius: Length = Field(description="Radius of a wheel [m].")


def _frozen(matrix: np.ndarray) -> np.ndarray:
    matrix.flags.writeable = False
    return matrix


def _diagonal(name: str) -> float:
    """+1 for front left and rear right, whose rollers point one way; -1 for the other two."""
    return 1.0 if ("left" in name) == ("front" in name) else -1.0


def _side(name: str) -> float:
    """+1 on the right, where a forward wheel turns the base to the left; -1 on the left."""
    return -1.0 if "left" in name else 1.0


class MecanumBase(_Wheeled):
    """Four mecanum wheels with rollers at 45°; moves in all directions.

    Source: (3.21), there in the order front left, rear left, rear right, front right.
    """

    kind: Literal["mecanum"] = "mecanum"
    half_length: Length = Field(description="Distance of the axles from the centre along x, l_x [m].")
    half_width: Length = Field(description="Distance of the wheels from the centre along y, l_y [m].")
    wheel_names: tuple[str, ...] = Field(
        default=("front_left", "rear_left", "rear_right", "front_right"),
        description="The wheels in the order of a measurement's numbers; each name holds front or rear, left or right.",
    )

    @model_validator(mode="after")
    def _each_wheel_once(self) -> "MecanumBase":
        corners = {(("front" in n) - ("rear" in n), ("left" in n) - ("right" in n)) for n in self.wheel_names}
        if len(self.wheel_names) != 4 or corners != {(1, 1), (1, -1), (-1, 1), (-1, -1)}:
            raise ValueError(
                "wheel_names must name four wheels, each with front or rear and left or right in its name, "
                f"but is {', '.join(self.wheel_names)}"
            )
        return self

    @property
    def lever(self) -> float:
        """k = l_x + l_y [m], the arm at which a wheel turns the base."""
        return self.half_length + self.half_width

    @cached_property
    def inverse_matrix(self) -> Float[np.ndarray, "4 3"]:
        """Wheel speeds [rad/s] from a body twist."""
        rows = [[1.0, -_diagonal(n), _side(n) * self.lever] for n in self.wheel_names]
        return _frozen(np.array(rows) / self.wheel_radius)

    @cached_property
    def forward_matrix(self) -> Float[np.ndarray, "3 4"]:
        """Body twist [m/s, m/s, rad/s] from wheel speeds: least squares where they disagree."""
        columns = [[1.0, -_diagonal(n), _side(n) / self.lever] for n in self.wheel_names]
        return _frozen(0.25 * self.wheel_radius * np.array(columns).T)  # (3.21)

    @cached_property
    def residual_matrix(self) -> Float[np.ndarray, "1 4"]:
        """The fourth direction of the wheels as a speed [m/s]: r/4 (front left - rear left - rear right + front right).

        It is zero while all four wheels roll, so it measures slip in every sample.
        """
        return _frozen(0.25 * self.wheel_radius * np.array([[1.0 if "front" in n else -1.0 for n in self.wheel_names]]))


class DifferentialBase(_Wheeled):
    """Two driven wheels, or two tracks, on one axle; cannot move sideways."""

    kind: Literal["differential"] = "differential"
    track_width: Length = Field(description="Distance between the wheels [m].")
    wheel_names: tuple[str, ...] = Field(
        default=("left", "right"),
        description="The wheels in the order of a measurement's numbers; one name holds left, the other right.",
    )

    @model_validator(mode="after")
    def _left_and_right(self) -> "DifferentialBase":
        sides = {("left" in n) - ("right" in n) for n in self.wheel_names}
        if len(self.wheel_names) != 2 or sides != {1, -1}:
            raise ValueError(f"wheel_names must be a left and a right wheel, but is {', '.join(self.wheel_names)}")
        return self

    @property
    def lever(self) -> float:
        """Half the track width [m], the arm at which a wheel turns the base."""
        return 0.5 * self.track_width

    @cached_property
    def inverse_matrix(self) -> Float[np.ndarray, "2 3"]:
        """Wheel speeds [rad/s] from a body twist; v_y has no effect."""
        rows = [[1.0, 0.0, _side(n) * self.lever] for n in self.wheel_names]
        return _frozen(np.array(rows) / self.wheel_radius)

    @cached_property
    def forward_matrix(self) -> Float[np.ndarray, "3 2"]:
        """Body twist [m/s, m/s, rad/s] from wheel speeds; v_y is 0 by the constraint of the wheels."""
        columns = [[1.0, 0.0, _side(n) / self.lever] for n in self.wheel_names]
        return _frozen(0.5 * self.wheel_radius * np.array(columns).T)

    @cached_property
    def residual_matrix(self) -> Float[np.ndarray, "0 2"]:
        """Two wheels leave nothing over that could tell slip."""
        return _frozen(np.zeros((0, 2)))
