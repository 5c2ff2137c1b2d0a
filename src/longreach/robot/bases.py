"""Wheeled bases: body twist from wheel speeds and back.

A base is three constant matrices over its wheels' speeds w [rad/s], in the order of `wheel_names`:
twist = forward_matrix @ w, w = inverse_matrix @ twist, and residual_matrix @ w = 0 while every wheel rolls.
"""

import re
from collections.abc import Iterable
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, model_validator

Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Angle = Annotated[float, Field(allow_inf_nan=False)]
Corner = Literal["front_left", "rear_left", "rear_right", "front_right"]
Side = Literal["left", "right"]
_ENDS = {"front": "front", "rear": "rear", "back": "rear", "hind": "rear", "f": "front", "b": "rear", "h": "rear"}
_TYRE = 0.05  # of a wheel beyond its middle, sideways [m]; ours


class _Wheeled(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    wheel_radius: Length = Field(description="Radius of a wheel [m].")


def _frozen(matrix: np.ndarray) -> np.ndarray:
    matrix.flags.writeable = False
    return matrix


def _place(name: str) -> tuple[str, str]:
    """Return which end (front, rear) and side (left, right) a wheel's name says, each empty where it is not clear.

    Words may stand anywhere in it (BackLeftWheel), short forms apart from the rest (fl_wheel, wheel_r_l, left_f).
    """
    lower = name.lower()
    ends = {end for word, end in _ENDS.items() if len(word) > 1 and word in lower}
    sides = {side for side in ("left", "right") if side in lower}
    apart = re.sub(r"([a-z])([A-Z])|([A-Z])(?=[A-Z][a-z])", r"\1\3_\2", name).lower()
    short = "".join(piece for piece in re.split("[^a-z]+", apart) if len(piece) <= 2 and set(piece) <= set("fbhlr"))
    if not ends and not sides and len(short) == 2:  # an r beside l, or one of two, is the rear
        left = "l" in short
        end = short.replace("l" if left else "r", "", 1)
        return ("rear" if end == "r" else _ENDS.get(end, "")), "left" if left else "right"
    if not sides and short in ("l", "r"):
        sides = {"left" if short == "l" else "right"}
    elif not ends and short in ("f", "b", "h", "r"):
        ends = {"rear" if short == "r" else _ENDS[short]}
    return (ends.pop() if len(ends) == 1 else ""), (sides.pop() if len(sides) == 1 else "")


def _with_places(values: Any, key: str) -> Any:
    """Return the keys of a base, `wheel_names` {place: name, or names} as names and `key`, the place of each."""
    if not isinstance(values, dict):
        return values
    given = values.get("wheel_names")
    if isinstance(given, dict):
        pairs = [(p, n) for p, names in given.items() for n in ([names] if isinstance(names, str) else names or ())]
        values = {**values, "wheel_names": [name for _, name in pairs], key: [place for place, _ in pairs]}
    places = values.get(key)
    if isinstance(places, list | tuple):  # back_left or fl says where it is, too
        read = _sides if key == "sides" else _corners
        values = {**values, key: [new or old for new, old in zip(read(places), places, strict=True)]}
    return values


def _corners(names: Iterable[object]) -> list[str]:
    """Return the corner that each name says, empty where it is not clear."""
    return ["_".join(place) if all(place) else "" for place in (_place(str(name)) for name in names)]


def _sides(names: Iterable[object]) -> list[str]:
    """Return the side that each name says, empty where it is not clear."""
    return [_place(str(name))[1] for name in names]


class MecanumBase(_Wheeled):
    """Four mecanum wheels with rollers at 45°; moves in all directions.

    Source: (3.21), there in the order front left, rear left, rear right, front right.
    """

    kind: Literal["mecanum"] = "mecanum"
    half_length: Length = Field(description="Distance of the axles from the centre along x, l_x [m].")
    half_width: Length = Field(description="Distance of the wheels from the centre along y, l_y [m].")
    wheel_names: tuple[str, ...] = Field(
        default=("front_left", "rear_left", "rear_right", "front_right"),
        description="The wheels in the order of a measurement's numbers; or {front_left: name, …}.",
    )
    corners: tuple[Corner, ...] = Field(
        default=(), description="Where each of them is; empty: their names say it (front_left, back_left, fl, …)."
    )

    @model_validator(mode="before")
    @classmethod
    def _find_corners(cls, values: Any) -> Any:
        return _with_places(values, "corners")

    @model_validator(mode="after")
    def _each_wheel_once(self) -> "MecanumBase":
        corners = set(self.wheel_corners) - {""}
        if not len(self.wheel_names) == len(set(self.wheel_names)) == len(self.wheel_corners) == len(corners) == 4:
            raise ValueError(
                "wheel_names must name four wheels, one at each corner, with front or rear and left or right in its "
                f"name, but is {', '.join(self.wheel_names)}; where names do not say it, give corners: [front_left, "
                "rear_left, …] in the same order"
            )
        return self

    @property
    def wheel_corners(self) -> tuple[str, ...]:
        """The corner of each wheel: as said, or as its name says it."""
        return self.corners or tuple(_corners(self.wheel_names))

    @property
    def lever(self) -> float:
        """k = l_x + l_y [m], the arm at which a wheel turns the base."""
        return self.half_length + self.half_width

    @property
    def half_size(self) -> tuple[float, float]:
        """Half the length and half the width of what stands on the floor [m]."""
        return self.half_length + self.wheel_radius, self.half_width + _TYRE

    @property
    def roller_signs(self) -> tuple[float, ...]:
        """+1 for front left and rear right, whose rollers point one way; -1 for the other two."""
        return tuple(1.0 if corner in ("front_left", "rear_right") else -1.0 for corner in self.wheel_corners)

    @cached_property
    def inverse_matrix(self) -> Float[np.ndarray, "4 3"]:
        """Wheel speeds [rad/s] from a body twist."""
        rows = zip(self.roller_signs, self.wheel_corners, strict=True)
        return _frozen(np.array([[1.0, -sign, _side(c) * self.lever] for sign, c in rows]) / self.wheel_radius)

    @cached_property
    def forward_matrix(self) -> Float[np.ndarray, "3 4"]:
        """Body twist [m/s, m/s, rad/s] from wheel speeds: least squares where they disagree."""
        rows = zip(self.roller_signs, self.wheel_corners, strict=True)
        columns = [[1.0, -sign, _side(c) / self.lever] for sign, c in rows]
        return _frozen(0.25 * self.wheel_radius * np.array(columns).T)  # (3.21)

    @cached_property
    def residual_matrix(self) -> Float[np.ndarray, "1 4"]:
        """The fourth direction of the wheels as a speed [m/s]: r/4 (front left - rear left - rear right + front right).

        It is zero while all four wheels roll, so it measures slip in every sample.
        """
        return _frozen(
            0.25 * self.wheel_radius * np.array([[1.0 if "front" in c else -1.0 for c in self.wheel_corners]])
        )


def _side(place: str) -> float:
    """+1 on the right, where a forward wheel turns the base to the left; -1 on the left."""
    return -1.0 if "left" in place else 1.0


class DifferentialBase(_Wheeled):
    """Two driven wheels on one axle, two tracks, or any number of wheels a side (skid-steered); no motion sideways.

    The wheels of a side are averaged: what they disagree by is slip, which is not taken into account. Skid-steered
    wheels scrub, so `track_width` is then the effective one, often 1.5 to 2 times the measured one.
    """

    kind: Literal["differential"] = "differential"
    track_width: Length = Field(description="Distance between the wheels [m]; of skid-steered ones the effective one.")
    wheel_names: tuple[str, ...] = Field(
        default=("left", "right"),
        description="The wheels in the order of a measurement's numbers; or {left: name or names, right: …}.",
    )
    sides: tuple[Side, ...] = Field(
        default=(), description="The side of each of them; empty: their names say it (left, front_right, rl, …)."
    )

    @model_validator(mode="before")
    @classmethod
    def _find_sides(cls, values: Any) -> Any:
        return _with_places(values, "sides")

    @model_validator(mode="after")
    def _left_and_right(self) -> "DifferentialBase":
        count = len(self.wheel_names)
        sides = self.wheel_sides
        if not (count == len(set(self.wheel_names)) == len(sides) and set(sides) == {"left", "right"}):
            raise ValueError(
                "wheel_names must be a left and a right wheel, or several of each, with left or right in each name, "
                f"but is {', '.join(self.wheel_names)}; where names do not say it, give sides: [left, right, …] in the "
                "same order"
            )
        return self

    @property
    def wheel_sides(self) -> tuple[str, ...]:
        """The side of each wheel: as said, or as its name says it."""
        return self.sides or tuple(_sides(self.wheel_names))

    @property
    def lever(self) -> float:
        """Half the track width [m], the arm at which a wheel turns the base."""
        return 0.5 * self.track_width

    @property
    def half_size(self) -> tuple[float, float]:
        """Half the length and half the width of what stands on the floor [m]: round, around its wheels."""
        return self.lever + _TYRE, self.lever + _TYRE

    @cached_property
    def inverse_matrix(self) -> Float[np.ndarray, "w 3"]:
        """Wheel speeds [rad/s] from a body twist; v_y has no effect."""
        rows = [[1.0, 0.0, _side(side) * self.lever] for side in self.wheel_sides]
        return _frozen(np.array(rows) / self.wheel_radius)

    @cached_property
    def forward_matrix(self) -> Float[np.ndarray, "3 w"]:
        """Body twist [m/s, m/s, rad/s] from wheel speeds, those of a side averaged; v_y is 0 by their constraint."""
        columns = np.array([[1.0, 0.0, _side(side) / self.lever] for side in self.wheel_sides])
        counts = np.array([self.wheel_sides.count(side) for side in self.wheel_sides])
        return _frozen(0.5 * self.wheel_radius * columns.T / counts)

    @cached_property
    def residual_matrix(self) -> Float[np.ndarray, "0 w"]:
        """Two sides leave nothing over that could tell slip."""
        return _frozen(np.zeros((0, len(self.wheel_names))))


class OmniBase(_Wheeled):
    """Three or four omni wheels around the centre, each rolling along the circle; moves in all directions."""

    kind: Literal["omni"] = "omni"
    centre_distance: Length = Field(description="Distance of the wheels from the centre [m].")
    wheel_angles: tuple[Angle, ...] = Field(
        description="Where each wheel is on the circle, from x to the left [rad]; a positive speed turns the base left."
    )
    wheel_names: tuple[str, ...] = Field(description="The wheels in the order of a measurement's numbers.")

    @model_validator(mode="after")
    def _can_move(self) -> "OmniBase":
        count = len(self.wheel_names)
        if not (count == len(set(self.wheel_names)) == len(self.wheel_angles) and count in (3, 4)):
            raise ValueError(f"an omni base has 3 or 4 wheels, each with a name and an angle, but has {count} names")
        if np.linalg.cond(self.inverse_matrix * [1.0, 1.0, 1.0 / self.lever]) > 1e3:
            raise ValueError("wheel_angles must not all be the same or opposite: the base could not move all ways")
        return self

    @property
    def lever(self) -> float:
        """The arm at which a wheel turns the base [m]."""
        return self.centre_distance

    @property
    def half_size(self) -> tuple[float, float]:
        """Half the length and half the width of what stands on the floor [m]: round, around its wheels."""
        return self.lever + _TYRE, self.lever + _TYRE

    @cached_property
    def inverse_matrix(self) -> Float[np.ndarray, "w 3"]:
        """Wheel speeds [rad/s] from a body twist: r w = -v_x sin α + v_y cos α + R ω."""
        rows = [[-np.sin(a), np.cos(a), self.lever] for a in self.wheel_angles]
        return _frozen(np.array(rows) / self.wheel_radius)

    @cached_property
    def forward_matrix(self) -> Float[np.ndarray, "3 w"]:
        """Body twist [m/s, m/s, rad/s] from wheel speeds: least squares where four disagree."""
        return _frozen(np.linalg.pinv(self.inverse_matrix))

    @cached_property
    def residual_matrix(self) -> Float[np.ndarray, "_ w"]:
        """Of four wheels, what no twist explains as a speed [m/s], 0 while all roll; of three, nothing is left over."""
        U, _, _ = np.linalg.svd(self.inverse_matrix)
        return _frozen(0.5 * self.wheel_radius * U[:, 3:].T)


class AckermannBase(_Wheeled):
    """Steered like a car: speeds of rear wheels and one steering angle; base_link is in the middle of the rear axle.

    Its twist is not linear in the numbers: v_x is the wheels' mean (`forward_matrix`), and ω = v_x tan δ / wheelbase.
    """

    kind: Literal["ackermann"] = "ackermann"
    wheelbase: Length = Field(description="Distance of the front axle from the rear one [m].")
    track_width: Length = Field(description="Distance between the rear wheels [m].")
    rear_wheels: tuple[str, ...] = Field(min_length=1, description="The rear wheels, which are averaged.")
    steering: str = Field(description="The joint whose position is the steering angle δ [rad], positive to the left.")

    @property
    def wheel_names(self) -> tuple[str, ...]:
        """The joints in the order of a measurement's numbers: the rear wheels, the steering."""
        return (*self.rear_wheels, self.steering)

    @property
    def lever(self) -> float:
        """Half the track width [m]."""
        return 0.5 * self.track_width

    @property
    def half_size(self) -> tuple[float, float]:
        """Half the length and half the width of what stands on the floor [m]: around both axles, the rear one in it."""
        return self.wheelbase + self.wheel_radius, self.lever + _TYRE

    @cached_property
    def inverse_matrix(self) -> Float[np.ndarray, "w 3"]:
        """Wheel speeds [rad/s] from a body twist; none of the steering."""
        rows = [[1.0, 0.0, (-1) ** i * self.lever] for i in range(len(self.rear_wheels))]
        return _frozen(np.array([*rows, [0.0, 0.0, 0.0]]) / self.wheel_radius)

    @cached_property
    def forward_matrix(self) -> Float[np.ndarray, "3 w"]:
        """The forward speed [m/s] from the rear wheels' speeds; what turns is the steering, which is not in here."""
        matrix = np.zeros((3, len(self.wheel_names)))
        matrix[0, :-1] = self.wheel_radius / len(self.rear_wheels)
        return _frozen(matrix)

    @cached_property
    def residual_matrix(self) -> Float[np.ndarray, "0 w"]:
        """Slip is not observed."""
        return _frozen(np.zeros((0, len(self.wheel_names))))


Base = MecanumBase | DifferentialBase | OmniBase | AckermannBase
