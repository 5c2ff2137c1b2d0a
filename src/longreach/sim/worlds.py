"""Worlds to drive in: walls and boxes seen from above, each from a bottom to a top, and how the floor grips.

A laser sees those that reach through its height; everything can be run into.
"""

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
_LABORATORY = "laboratory"  # `room.polygonal_room`, the one that the kinematic simulation drives in

_Point = tuple[float, float]
_Positive = Annotated[float, Field(gt=0)]


@dataclass(frozen=True, eq=False)
class World:
    """Upright rectangles: segments (m, 4) x0, y0, x1, y1 [m] that reach from bottom (m,) to top (m,) [m]."""

    name: str
    segments: Float[np.ndarray, "m 4"]
    bottom: Float[np.ndarray, " m"]
    top: Float[np.ndarray, " m"]
    friction: float = FLOORS["good"]

    def at_height(self, z: float) -> Float[np.ndarray, "k 4"]:
        """Return the segments that a horizontal ray at the height z [m] can meet."""
        return np.ascontiguousarray(self.segments[(self.bottom <= z) & (z <= self.top)])

    def moved(self, x: float, y: float) -> "World":
        """Return the world with everything in it moved by (x, y) [m]."""
        return replace(self, segments=room.moved(self.segments, x, y))

    def with_floor(self, floor: str | float) -> "World":
        """Return the world with another floor: a name of `FLOORS`, or a coefficient of friction.

        Raises:
            ConfigError: no such floor, or a friction that is not above 0.
        """
        return replace(self, friction=friction_of(floor))


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Upright(_Strict):
    bottom: float = Field(default=0.0, ge=0, description="Where it begins [m]; a table's top hangs above a laser.")
    height: float = Field(default=2.5, gt=0, description="How tall it is from there [m]; ours, a room's.")


class Wall(_Upright):
    """Straight walls from corner to corner."""

    corners: Annotated[tuple[_Point, ...], Field(min_length=2)] = Field(description="x, y of each [m].")
    closed: bool = Field(default=False, description="Whether the last corner is joined to the first.")

    def segments(self) -> Float[np.ndarray, "m 4"]:
        """Return x0, y0, x1, y1 of each piece [m]."""
        sides = room.polygon(list(self.corners))
        return sides if self.closed else sides[:-1]


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


class Column(_Upright):
    """An eight-sided column."""

    x: float = Field(description="Of its middle [m].")
    y: float = Field(description="Of its middle [m].")
    radius: _Positive = Field(description="To its corners [m].")

    def segments(self) -> Float[np.ndarray, "m 4"]:
        """Return x0, y0, x1, y1 of each side [m]."""
        return room.column(self.x, self.y, self.radius)


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
        """Return all of it as upright rectangles."""
        things = [*self.walls, *self.boxes, *self.columns]
        pieces = [thing.segments() for thing in things]
        counts = [len(piece) for piece in pieces]
        bottom = np.repeat([thing.bottom for thing in things], counts)
        top = np.repeat([thing.bottom + thing.height for thing in things], counts)
        segments = np.vstack(pieces) if pieces else np.empty((0, 4))
        return World(self.name, segments, bottom.astype(float), top.astype(float), friction_of(self.floor))


def friction_of(floor: str | float) -> float:
    """Return the coefficient of friction of a floor by its name, or the number itself.

    Raises:
        ConfigError: no such floor, or a friction that is not above 0.
    """
    if isinstance(floor, str) and floor in FLOORS:
        return FLOORS[floor]
    if isinstance(floor, str) or not 0.0 < floor < np.inf:
        raise ConfigError(f"A floor is one of {', '.join(FLOORS)}, or a friction above 0, but not {floor!r}.")
    return float(floor)


def shipped_worlds() -> list[str]:
    """Return the names of the worlds that come with the package."""
    folder = files("longreach.sim").joinpath("worlds")
    return sorted([_LABORATORY, *(f.name.removesuffix(".yaml") for f in folder.iterdir() if f.name.endswith(".yaml"))])


def load_world(world: str | Path) -> World:
    """Return a shipped world by its name, or the one in a YAML file.

    Raises:
        ConfigError: there is neither, or the file is wrong; the sentence names the key.
    """
    if str(world) == _LABORATORY:
        walls = room.polygonal_room()
        return World(_LABORATORY, walls, np.zeros(len(walls)), np.full(len(walls), 2.5))
    path = Path(world)
    if str(world) in shipped_worlds():
        path = Path(str(files("longreach.sim"))) / "worlds" / f"{world}.yaml"
    elif not path.is_file():
        raise ConfigError(
            f"{world} is neither a world that longreach knows ({', '.join(shipped_worlds())}) nor a YAML file."
        )
    return validated(WorldDescription, read_yaml(path), str(path)).world()
