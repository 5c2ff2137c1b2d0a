"""Worlds to drive in: walls and boxes seen from above, each from a bottom to a top, and how the floor grips.

A laser sees those that reach through its height; everything can be run into.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field

from longreach.errors import ConfigError
from longreach.io.config import read_yaml, validated
from longreach.sim import room

# Friction of the rollers on the floor [1]; ours: polyurethane on clean concrete about 0.8, on wet tiles a third of it.
FLOORS = {"good": 0.8, "worn": 0.5, "wet": 0.3, "slippery": 0.12}
_WALL = 0.02  # half of a wall's thickness [m]; ours

_Point = tuple[float, float]
_Positive = Annotated[float, Field(gt=0)]


@dataclass(frozen=True, eq=False)
class World:
    """What can be seen, as upright rectangles, and what can be run into, as upright solids.

    segments (m, 4): x0, y0, x1, y1 [m]; they reach from bottom (m,) to top (m,) [m]. solids (k, 7): x, y, yaw, half
    length, half width, bottom, top [m, rad]; a half width of 0 is a cylinder of that radius. Not given, they are thin
    walls along the segments. friction: of the rollers on the floor [1].
    """

    name: str
    segments: Float[np.ndarray, "m 4"]
    bottom: Float[np.ndarray, " m"]
    top: Float[np.ndarray, " m"]
    friction: float = FLOORS["good"]
    solids: Float[np.ndarray, "k 7"] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.solids is None:
            object.__setattr__(self, "solids", np.column_stack([_thin(self.segments), self.bottom, self.top]))

    def at_height(self, z: float) -> Float[np.ndarray, "k 4"]:
        """Return the segments that a horizontal ray at the height z [m] can meet."""
        return np.ascontiguousarray(self.segments[(self.bottom <= z) & (z <= self.top)])

    def moved(self, x: float, y: float) -> "World":
        """Return the world with everything in it moved by (x, y) [m]."""
        return replace(
            self, segments=room.moved(self.segments, x, y), solids=self.solids + np.array([x, y, *[0.0] * 5])
        )

    def with_floor(self, floor: str | float) -> "World":
        """Return the world with another floor: a name of `FLOORS`, or a coefficient of friction.

        Raises:
            ConfigError: no such floor, or a friction that is not above 0.
        """
        return replace(self, friction=friction_of(floor))


def _thin(segments: Float[np.ndarray, "m 4"]) -> Float[np.ndarray, "m 5"]:
    """Return thin walls along segments: x, y, yaw, half length, half width."""
    x0, y0, x1, y1 = segments.T
    half = 0.5 * np.hypot(x1 - x0, y1 - y0)
    middle = [0.5 * (x0 + x1), 0.5 * (y0 + y1), np.arctan2(y1 - y0, x1 - x0)]
    return np.column_stack([*middle, half, np.full(len(half), _WALL)])


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Upright(_Strict):
    bottom: float = Field(default=0.0, ge=0, description="Where it begins [m]; a table's top hangs above a laser.")
    height: float = Field(default=2.5, gt=0, description="How tall it is from there [m]; ours, a room's.")

    def reaching(self, rows: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k2"]:
        """Return the rows with bottom and top [m] behind each."""
        return np.column_stack([rows, np.tile([self.bottom, self.bottom + self.height], (len(rows), 1))])


class Wall(_Upright):
    """Straight walls from corner to corner."""

    corners: Annotated[tuple[_Point, ...], Field(min_length=2)] = Field(description="x, y of each [m].")
    closed: bool = Field(default=False, description="Whether the last corner is joined to the first.")

    def segments(self) -> Float[np.ndarray, "m 4"]:
        """Return x0, y0, x1, y1 of each piece [m]."""
        sides = room.polygon(list(self.corners))
        return sides if self.closed else sides[:-1]

    def solids(self) -> Float[np.ndarray, "m 5"]:
        """Return x, y, yaw, half length, half width of each piece."""
        return _thin(self.segments())


class Box(_Upright):
    """Something with four upright sides."""

    x: float = Field(description="Of its middle [m].")
    y: float = Field(description="Of its middle [m].")
    length: _Positive = Field(description="Along its own x [m].")
    width: _Positive = Field(description="Along its own y [m].")
    yaw: float = Field(default=0.0, description="Its turn [rad].")

    def segments(self) -> Float[np.ndarray, "m 4"]:
        """Return x0, y0, x1, y1 of each side [m]."""
        return room.box(self.x, self.y, self.length, self.width, self.yaw)

    def solids(self) -> Float[np.ndarray, "1 5"]:
        """Return its x, y, yaw, half length, half width."""
        return np.array([[self.x, self.y, self.yaw, 0.5 * self.length, 0.5 * self.width]])


class Column(_Upright):
    """An eight-sided column."""

    x: float = Field(description="Of its middle [m].")
    y: float = Field(description="Of its middle [m].")
    radius: _Positive = Field(description="To its corners [m].")

    def segments(self) -> Float[np.ndarray, "m 4"]:
        """Return x0, y0, x1, y1 of each side [m]."""
        return room.column(self.x, self.y, self.radius)

    def solids(self) -> Float[np.ndarray, "1 5"]:
        """Return its x, y, yaw, radius, 0: to run into, it is round."""
        return np.array([[self.x, self.y, 0.0, self.radius, 0.0]])


class WorldDescription(_Strict):
    """A world as YAML; the robot starts at its origin, which should be free."""

    name: str = Field(description="What it is called.")
    floor: Literal["good", "worn", "wet", "slippery"] | _Positive = Field(
        default="good", description="How it grips: a name, or the rollers' coefficient of friction [1]."
    )
    walls: tuple[Wall, ...] = Field(default=(), description="Walls along corners.")
    boxes: tuple[Box, ...] = Field(default=(), description="Furniture, shelves, crates.")
    columns: tuple[Column, ...] = Field(default=(), description="Round things, near enough.")

    def world(self) -> World:
        """Return all of it to be seen and run into."""
        things = [*self.walls, *self.boxes, *self.columns]
        segments = np.vstack([np.empty((0, 6)), *(thing.reaching(thing.segments()) for thing in things)])
        solids = np.vstack([np.empty((0, 7)), *(thing.reaching(thing.solids()) for thing in things)])
        bottom, top = segments[:, 4].copy(), segments[:, 5].copy()
        return World(self.name, segments[:, :4].copy(), bottom, top, friction_of(self.floor), solids)


def friction_of(floor: str | float) -> float:
    """Return the coefficient of friction of a floor by its name, or the number itself, as a text too.

    Raises:
        ConfigError: no such floor, or a friction that is not above 0.
    """
    with suppress(ValueError):
        friction = FLOORS.get(str(floor)) or float(floor)
        if 0.0 < friction < np.inf:
            return friction
    raise ConfigError(f"A floor is one of {', '.join(FLOORS)}, or a friction above 0, but not {floor!r}.")


def shipped_worlds() -> list[str]:
    """Return the names of the worlds that come with the package."""
    folder = files("longreach.sim").joinpath("worlds")
    return sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def load_world(world: str | Path) -> World:
    """Return a shipped world by its name, or the one in a YAML file.

    Raises:
        ConfigError: there is neither, or the file is wrong; the sentence names the key.
    """
    path = Path(world)
    if str(world) in shipped_worlds():
        path = Path(str(files("longreach.sim"))) / "worlds" / f"{world}.yaml"
    elif not path.is_file():
        raise ConfigError(
            f"{world} is neither a world that longreach knows ({', '.join(shipped_worlds())}) nor a YAML file."
        )
    return validated(WorldDescription, read_yaml(path), str(path)).world()
