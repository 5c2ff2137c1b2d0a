"""Problems as configuration: terms chosen at run time by a file, checked key by key.

>>> problem_of({"costs": [{"kind": "manipulability"}], "constraints": [{"kind": "tool_pose"}]}).constraints[0].name
'tool pose'
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from longreach.errors import ConfigError
from longreach.planning.links import AccelerationLimit, Link, Smoothness, StepLimit, VelocityLimit
from longreach.planning.obstacles import Box, Capsule, Disc, LinkCapsule, Obstacle
from longreach.planning.problem import Problem
from longreach.planning.tasks_range import FieldOfView
from longreach.planning.terms import Constraint, Cost, Manipulability, NearSeed
from longreach.planning.terms_clearance import Clearance, base_capsule
from longreach.planning.terms_pose import BaseDisc, BaseHeading, TaskConstraint, ToolPose

Point = tuple[float, float, float]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class ManipulabilityConfig(_Strict):
    """√(κ/M) (4.33), or another objective."""

    kind: Literal["manipulability"]
    objective: Literal["sqrt_kappa_over_m", "neg_log_m", "neg_m", "kappa"] = "sqrt_kappa_over_m"
    part: Literal["full", "arm"] = "full"
    length: float = Field(default=1.0, gt=0)  # [m] that makes linear and angular rows comparable
    weight: float = Field(default=1.0, ge=0)

    def term(self) -> Cost:
        """Return the cost."""
        return Manipulability(self.objective, self.part, self.length, weight=self.weight)


class NearSeedConfig(_Strict):
    """Squared distance from a configuration, each joint with its weight (4.25)."""

    kind: Literal["near_seed"]
    seed: tuple[float, ...]
    joint_weights: tuple[float, ...]
    weight: float = Field(default=1.0, ge=0)

    def term(self) -> Cost:
        """Return the cost."""
        return NearSeed(np.array([self.seed]), np.array(self.joint_weights), weight=self.weight)


class ToolPoseConfig(_Strict):
    """The tool on its reference."""

    kind: Literal["tool_pose"]

    def term(self) -> Constraint:
        """Return the constraint."""
        return ToolPose()


class BaseDiscConfig(_Strict):
    """The base within a radius [m] of its reference."""

    kind: Literal["base_disc"]
    radius: float = Field(default=0.01, gt=0)  # section 6.3

    def term(self) -> Constraint:
        """Return the constraint."""
        return BaseDisc(self.radius)


class BaseHeadingConfig(_Strict):
    """The base's heading within a band [rad] either way."""

    kind: Literal["base_heading"]
    band: float = Field(default=0.1, gt=0, le=np.pi)  # section 6.3

    def term(self) -> Constraint:
        """Return the constraint."""
        return BaseHeading(self.band)


class FieldOfViewConfig(_Strict):
    """A frame's z axis within an angle [rad] of a target [m]."""

    kind: Literal["field_of_view"]
    target: Point
    half_angle: float = Field(gt=0, lt=np.pi)
    frame: str | None = None

    def term(self) -> Constraint:
        """Return the constraint."""
        return TaskConstraint(FieldOfView(np.array(self.target), self.half_angle, self.frame))


class ObstacleConfig(_Strict):
    """Disc: centre and radius; capsule: a, b and radius; box: centre, size and turn about z [m, rad]."""

    shape: Literal["disc", "capsule", "box"]
    centre: tuple[float, ...] = (0.0, 0.0, 0.0)
    radius: float = Field(default=0.0, ge=0)
    a: Point = (0.0, 0.0, 0.0)
    b: Point = (0.0, 0.0, 0.0)
    size: Point = (1.0, 1.0, 1.0)
    turn: float = 0.0

    def obstacle(self) -> Obstacle:
        """Return the obstacle."""
        if self.shape == "disc":
            return Disc(np.array(self.centre[:2]), self.radius)
        if self.shape == "capsule":
            return Capsule(np.array(self.a), np.array(self.b), self.radius)
        T = np.eye(4)
        c, s = np.cos(self.turn), np.sin(self.turn)
        T[:2, :2], T[:3, 3] = [[c, -s], [s, c]], self.centre
        return Box(T, np.array(self.size))


class CapsuleConfig(_Strict):
    """A capsule a to b of some radius [m] that a frame of the robot carries."""

    frame: str
    a: Point = (0.0, 0.0, 0.0)
    b: Point = (0.0, 0.0, 0.0)
    radius: float = Field(ge=0)

    def capsule(self) -> LinkCapsule:
        """Return the capsule."""
        return LinkCapsule(self.frame, Capsule(np.array(self.a), np.array(self.b), self.radius))


class ClearanceConfig(_Strict):
    """The base, a disc, and capsules of the robot at least `margin` [m] from obstacles."""

    kind: Literal["clearance"]
    obstacles: tuple[ObstacleConfig, ...] = Field(min_length=1)
    base_radius: float | None = Field(default=None, gt=0)
    capsules: tuple[CapsuleConfig, ...] = ()
    margin: float = Field(default=0.0, ge=0)

    def term(self) -> Constraint:
        """Return the constraint."""
        base = () if self.base_radius is None else (base_capsule(self.base_radius),)
        capsules = (*base, *(part.capsule() for part in self.capsules))
        return Clearance(capsules, tuple(part.obstacle() for part in self.obstacles), margin=self.margin)


class SmoothnessConfig(_Strict):
    """The weight of squared steps, in parts of the start's mean where relative."""

    kind: Literal["smoothness"]
    weight: float = Field(default=6.6e-4, ge=0)
    order: Literal[1, 2] = 1
    relative: bool = True

    def term(self) -> Link:
        """Return the link."""
        return Smoothness(self.weight, self.order, self.relative)


class StepConfig(_Strict):
    """The largest step of a joint [m, rad] between waypoints."""

    kind: Literal["step"]
    step: float = Field(default=0.02, gt=0)
    room: float = Field(default=1.5, ge=0)

    def term(self) -> Link:
        """Return the link."""
        return StepLimit(self.step, self.room)


class VelocityConfig(_Strict):
    """Joints no faster than the part of the robot's limits."""

    kind: Literal["joint_velocity", "joint_acceleration"]
    part: float = Field(default=1.0, gt=0)

    def term(self) -> Link:
        """Return the link."""
        return VelocityLimit(self.part) if self.kind == "joint_velocity" else AccelerationLimit(self.part)


Constraints = ToolPoseConfig | BaseDiscConfig | BaseHeadingConfig | FieldOfViewConfig | ClearanceConfig
Links = SmoothnessConfig | StepConfig | VelocityConfig


class ProblemConfig(_Strict):
    """The terms of a problem, each by its kind."""

    costs: tuple[Annotated[ManipulabilityConfig | NearSeedConfig, Field(discriminator="kind")], ...] = ()
    constraints: tuple[Annotated[Constraints, Field(discriminator="kind")], ...] = ()
    links: tuple[Annotated[Links, Field(discriminator="kind")], ...] = ()
    limits: bool = True  # whether the robot's joint limits are kept


def problem_of(tree: Mapping[str, Any]) -> Problem:
    """Return the problem that a configuration, as read from YAML, describes.

    Raises:
        ConfigError: a key or a value that cannot be; the sentence names it.
    """
    if not isinstance(tree, Mapping):
        raise ConfigError(f"A problem is a mapping of costs, constraints and links, not a {type(tree).__name__}.")
    try:
        config = ProblemConfig.model_validate(dict(tree))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"The problem's {place} cannot be: {first['msg']}.") from None
    return Problem(
        tuple(part.term() for part in config.costs),
        tuple(part.term() for part in config.constraints),
        tuple(part.term() for part in config.links),
        config.limits,
    )
