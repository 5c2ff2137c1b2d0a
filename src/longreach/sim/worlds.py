"""Worlds to drive in: walls and boxes seen from above, each from a bottom to a top, and how the floor grips.

A laser sees those that reach through its height; everything can be run into.
"""

from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float, Int
from pydantic import BaseModel, ConfigDict, Field, model_validator

from longreach.errors import ConfigError
from longreach.geometry import se2
from longreach.io.config import read_yaml, validated
from longreach.sim import room

# Friction of the rollers on the floor [1]; ours: polyurethane on clean concrete about 0.8, on wet tiles a third of it.
FLOORS = {"good": 0.8, "worn": 0.5, "wet": 0.3, "slippery": 0.12}
_WALL = 0.02  # half of a wall's thickness [m]; ours

_Point = tuple[float, float]
_Pose = tuple[float, float, float]
_Positive = Annotated[float, Field(gt=0)]


@dataclass(frozen=True, eq=False)
class Ways:
    """Straight ways that are free for a base: points (n, 2) [m], and the pairs (k, 2) of them that are joined.

    slack (n,): how far from each point a drive may pass [m].
    """

    points: Float[np.ndarray, "n 2"]
    slack: Float[np.ndarray, " n"]
    pairs: Int[np.ndarray, "k 2"]


@dataclass(frozen=True, eq=False)
class Alike:
    """Rectangles around poses (n, 3) that look the same to a laser; area: length and width of each [m]."""

    poses: Float[np.ndarray, "n 3"]
    area: _Point

    def twins(self, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "m 3"]:
        """Return the poses from which all looks as from this one, which is not among them."""
        local = se2.between(self.poses, pose)
        inside = (np.abs(local[:, 0]) <= 0.5 * self.area[0]) & (np.abs(local[:, 1]) <= 0.5 * self.area[1])
        if not inside.any():
            return np.empty((0, 3))
        here = int(np.argmax(inside))
        return se2.compose(np.delete(self.poses, here, axis=0), local[here])


@dataclass(frozen=True, eq=False)
class World:
    """What can be seen, as upright rectangles, and what can be run into, as upright solids.

    segments (m, 4): x0, y0, x1, y1 [m]; they reach from bottom (m,) to top (m,) [m]. solids (k, 7): x, y, yaw, half
    length, half width, bottom, top [m, rad]; a half width of 0 is a cylinder of that radius. Not given, they are thin
    walls along the segments. friction: of the rollers on the floor [1]. ways: where a base can drive; alike: places
    that a laser cannot tell apart.
    """

    name: str
    segments: Float[np.ndarray, "m 4"]
    bottom: Float[np.ndarray, " m"]
    top: Float[np.ndarray, " m"]
    friction: float = FLOORS["good"]
    solids: Float[np.ndarray, "k 7"] = None  # type: ignore[assignment]
    ways: Ways | None = None
    alike: tuple[Alike, ...] = ()

    def __post_init__(self) -> None:
        if self.solids is None:
            object.__setattr__(self, "solids", np.column_stack([_thin(self.segments), self.bottom, self.top]))

    def at_height(self, z: float) -> Float[np.ndarray, "k 4"]:
        """Return the segments that a horizontal ray at the height z [m] can meet."""
        return np.ascontiguousarray(self.segments[(self.bottom <= z) & (z <= self.top)])

    def moved(self, x: float, y: float) -> "World":
        """Return the world with everything in it moved by (x, y) [m]."""
        return replace(
            self,
            segments=room.moved(self.segments, x, y),
            solids=self.solids + np.array([x, y, *[0.0] * 5]),
            ways=self.ways and replace(self.ways, points=self.ways.points + np.array([x, y])),
            alike=tuple(replace(a, poses=a.poses + np.array([x, y, 0.0])) for a in self.alike),
        )

    def twin_poses(self, pose: Float[np.ndarray, "3"]) -> Float[np.ndarray, "m 3"]:
        """Return the other poses (m, 3) from which a laser sees the same; none where a place is unique."""
        return np.vstack([np.empty((0, 3)), *(alike.twins(pose) for alike in self.alike)])

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


class Gap(_Strict):
    """A way through a wall."""

    x: float = Field(description="Of its middle [m].")
    y: float = Field(description="Of its middle [m].")
    width: _Positive = Field(description="Between its sides [m].")


class Wall(_Upright):
    """Straight walls from corner to corner."""

    corners: Annotated[tuple[_Point, ...], Field(min_length=2)] = Field(description="x, y of each [m].")
    closed: bool = Field(default=False, description="Whether the last corner is joined to the first.")
    gaps: tuple[Gap, ...] = Field(default=(), description="Ways through it, each within one straight piece.")
    thickness: float = Field(default=0.0, ge=0, description="About the line between the corners [m].")

    @model_validator(mode="after")
    def _check_gaps(self) -> "Wall":
        for gap in self.gaps:
            if not any(_within(gap, side) for side in self._sides()):
                raise ValueError(f"the gap at {gap.x:g}, {gap.y:g} does not lie within one straight piece of its wall")
        return self

    def _sides(self) -> Float[np.ndarray, "m 4"]:
        sides = room.polygon(list(self.corners))
        return sides if self.closed else sides[:-1]

    def _pieces(self) -> Float[np.ndarray, "m 4"]:
        return np.array([piece for side in self._sides() for piece in _cut(side, self.gaps, 0.5 * self.thickness)])

    def segments(self) -> Float[np.ndarray, "m 4"]:
        """Return x0, y0, x1, y1 of each piece [m], or of its sides where the wall is thick."""
        if self.thickness == 0.0:
            return self._pieces()
        return np.vstack([room.box(x, y, 2 * a, 2 * b, yaw) for x, y, yaw, a, b in self.solids().tolist()])

    def solids(self) -> Float[np.ndarray, "m 5"]:
        """Return x, y, yaw, half length, half width of each piece."""
        solids = _thin(self._pieces())
        solids[:, 4] = max(0.5 * self.thickness, _WALL)
        return solids


def _along(gap: Gap, side: Float[np.ndarray, "4"]) -> tuple[float, float, float]:
    """Return how far along a side the gap's middle is, how far off the side, and the side's length [m]."""
    way, off = side[2:] - side[:2], np.array([gap.x, gap.y]) - side[:2]
    length = float(np.hypot(*way))
    return float(off @ way) / length, abs(float(way[0] * off[1] - way[1] * off[0])) / length, length


def _within(gap: Gap, side: Float[np.ndarray, "4"]) -> bool:
    along, off, length = _along(gap, side)
    return off < _WALL and 0.5 * gap.width < along < length - 0.5 * gap.width


def _cut(side: Float[np.ndarray, "4"], gaps: tuple[Gap, ...], beyond: float) -> list[Float[np.ndarray, "4"]]:
    """Return what is left of a side beside its gaps, and reaching beyond its corners [m]."""
    way = side[2:] - side[:2]
    way = way / np.hypot(*way)
    start, end = side[:2] - beyond * way, side[2:] + beyond * way
    middles = sorted((_along(gap, side)[0], gap.width) for gap in gaps if _within(gap, side))
    points = [start]
    for along, width in middles:
        points += [side[:2] + (along + half * width) * way for half in (-0.5, 0.5)]
    return [np.concatenate(pair) for pair in zip(points[::2], [*points[1::2], end], strict=True)]


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


class _Things(_Strict):
    walls: tuple[Wall, ...] = Field(default=(), description="Walls along corners.")
    boxes: tuple[Box, ...] = Field(default=(), description="Furniture, shelves, crates.")
    columns: tuple[Column, ...] = Field(default=(), description="Round things, near enough.")

    def rows(self) -> tuple[Float[np.ndarray, "m 6"], Float[np.ndarray, "k 7"]]:
        """Return segments, and solids, of all, with bottom and top [m] behind each."""
        things = [*self.walls, *self.boxes, *self.columns]
        segments = np.vstack([np.empty((0, 6)), *(thing.reaching(thing.segments()) for thing in things)])
        return segments, np.vstack([np.empty((0, 7)), *(thing.reaching(thing.solids()) for thing in things)])


class Copies(_Things):
    """Things that stand in the same way in several places."""

    at: tuple[_Pose, ...] = Field(description="x, y [m] and turn [rad] of each place; the things are given in it.")

    def rows(self) -> tuple[Float[np.ndarray, "m 6"], Float[np.ndarray, "k 7"]]:
        """Return segments, and solids, of all copies."""
        segments, solids = super().rows()
        frames = np.array(self.at, dtype=float).reshape(-1, 1, 3)
        seen, met = (np.tile(rows, (len(frames), 1, 1)) for rows in (segments, solids))
        seen[:, :, :2], seen[:, :, 2:4] = (_carried(frames, rows) for rows in (segments[:, :2], segments[:, 2:4]))
        met[:, :, :2], met[:, :, 2] = _carried(frames, solids[:, :2]), solids[:, 2] + frames[:, :, 2]
        return seen.reshape(-1, 6), met.reshape(-1, 7)


def _carried(frames: Float[np.ndarray, "n 1 3"], points: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "n m 2"]:
    c, s = np.cos(frames[..., 2]), np.sin(frames[..., 2])
    x, y = points[:, 0], points[:, 1]
    return np.stack([frames[..., 0] + c * x - s * y, frames[..., 1] + s * x + c * y], axis=-1)


class AlikeDescription(_Strict):
    """Places that a laser cannot tell apart."""

    at: tuple[_Pose, ...] = Field(description="x, y [m] and turn [rad] of each place's middle.")
    area: tuple[_Positive, _Positive] = Field(description="Its length and width there [m].")


class WorldDescription(_Things):
    """A world as YAML; the robot starts at its origin, which should be free."""

    name: str = Field(description="What it is called.")
    floor: Literal["good", "worn", "wet", "slippery"] | _Positive = Field(
        default="good", description="How it grips: a name, or the rollers' coefficient of friction [1]."
    )
    copies: tuple[Copies, ...] = Field(default=(), description="Things that stand in several places.")
    stations: dict[str, _Pose] = Field(
        default={}, description="Points of ways: x, y, and how far from there a drive may pass [m]."
    )
    ways: tuple[tuple[str, ...], ...] = Field(default=(), description="Chains of stations with free ways between them.")
    alike: tuple[AlikeDescription, ...] = Field(default=(), description="Places that a laser cannot tell apart.")

    @model_validator(mode="after")
    def _check_ways(self) -> "WorldDescription":
        if lost := sorted({name for way in self.ways for name in way} - set(self.stations)):
            raise ValueError(f"ways pass {', '.join(lost)}, which stations do not have")
        return self

    def world(self) -> World:
        """Return all of it to be seen and run into."""
        rows = [self.rows(), *(copy.rows() for copy in self.copies)]
        segments, solids = (np.vstack(part) for part in zip(*rows, strict=True))
        bottom, top = segments[:, 4].copy(), segments[:, 5].copy()
        alike = tuple(Alike(np.array(a.at, dtype=float), a.area) for a in self.alike)
        friction, ways = friction_of(self.floor), self._ways() if self.ways else None
        return World(self.name, segments[:, :4].copy(), bottom, top, friction, solids, ways, alike)

    def _ways(self) -> Ways:
        points, number = np.array(list(self.stations.values())), {name: i for i, name in enumerate(self.stations)}
        pairs = [(number[a], number[b]) for way in self.ways for a, b in pairwise(way)]
        return Ways(points[:, :2], points[:, 2], np.array(pairs, dtype=int))


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
